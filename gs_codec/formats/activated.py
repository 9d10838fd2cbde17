"""Activated values, as in glTF and USD: opacities 0-1 and linear scales."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.formats.packed_values import Clipped

#: Maximum log-scale whose scale is a finite float32.
_LARGEST = 88.0

#: Minimum log-scale whose scale is above 0 in float32.
_SMALLEST = -103.28


def logits_of(share: NDArray[np.float32]) -> NDArray[np.float32]:
    """Logits of opacities: infinite at 0 and 1, and beyond."""
    inside = np.clip(share.astype(np.float64), 0, 1)
    with np.errstate(divide="ignore"):
        return np.log(inside / (1 - inside)).astype(np.float32)


def log_scales_of(scales: NDArray[np.float32]) -> NDArray[np.float32]:
    """Logarithms of scales: -infinity for a scale of 0, NaN for negative ones."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.log(scales.astype(np.float64)).astype(np.float32)


def linear_scales(
    log_scale: NDArray[np.floating], name: str, clipped: Clipped
) -> NDArray[np.floating]:
    """Scales of log-scales; `InvalidInput`, with the `name` of a format, if one is too large.

    Scales that round to 0 in float32 are clipped to the smallest above 0.
    """
    largest = log_scale.max(initial=0)
    if largest > _LARGEST:
        raise InvalidInput(f"log-scale {largest}, {name} holds up to {_LARGEST}")
    return np.exp(clipped.limited("scales", log_scale, _SMALLEST, _LARGEST))

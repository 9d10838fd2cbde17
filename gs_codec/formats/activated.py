"""Values after activation, as glTF and USD hold them: opacities 0-1 and linear scales."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput

#: Largest log-scale whose scale is a finite float32, and the smallest above 0.
_LARGEST, _SMALLEST = 88.0, -103.0

#: Opacities are kept this far from 0 and 1, which have no logit.
_END = 2.0**-25


def logits_of(share: NDArray[np.float32]) -> NDArray[np.float32]:
    """Logits of opacities."""
    inside = np.clip(share.astype(np.float64), _END, 1 - _END)
    return np.log(inside / (1 - inside)).astype(np.float32)


def log_scales_of(scales: NDArray[np.float32]) -> NDArray[np.float32]:
    """Logarithms of scales; a scale of 0 becomes tiny, and of one below 0 NaN."""
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(scales.astype(np.float64))
    return np.maximum(logs, _SMALLEST).astype(np.float32)


def linear_scales(log_scale: NDArray[np.float32], name: str) -> NDArray[np.float64]:
    """Scales of logarithms; `InvalidInput`, with the `name` of a format, if one is too large."""
    largest = log_scale.max(initial=_SMALLEST)
    if largest > _LARGEST:
        raise InvalidInput(f"log-scale {largest}, {name} holds up to {_LARGEST}")
    return np.exp(log_scale.astype(np.float64))

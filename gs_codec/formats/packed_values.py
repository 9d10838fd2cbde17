"""Values that several formats share: opacities and colours of a byte, packed quaternions."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gs_codec.scene import SH_C0

log = logging.getLogger(__name__)

#: Gaussians computed at once.
_AT_ONCE = 1 << 16

#: Opacities of 0 and 255 have no logit and are moved by this many steps.
_END = 0.25


def planes_of(channels: int, count: int, values: Callable[[slice], NDArray]) -> NDArray[np.float32]:
    """Compute planes ``(channels, N)`` for a part of the Gaussians at a time.

    The temporary arrays of `values`, often larger than the result, then stay small.
    """
    planes = np.empty((channels, count), np.float32)
    for start in range(0, count, _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        planes[:, some] = values(some)
    return planes


def opacities_of(path: str | Path, alpha: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Logits ``(1, N)`` of opacities ``(N,)`` in units of 1/255; 0 and 1 are made finite."""
    ends = int(np.count_nonzero((alpha == 0) | (alpha == 255)))
    if ends:
        # Only INFO: the change is less than a step of the format.
        log.info(
            "%s: opacity of 0 or 1 in %d Gaussians, which has no logit: moved by %.2g",
            *(path, ends, _END / 255),
        )
    share = np.clip(np.arange(256.0), _END, 255 - _END) / 255
    return np.log(share / (1 - share)).astype(np.float32)[alpha][None]


def sh_of_colours(colours: NDArray) -> NDArray[np.float32]:
    """Degree-0 SH coefficients of colours, 0-1."""
    with np.errstate(over="ignore"):  # the bounds of a chunk may be too large for float32
        return ((colours - 0.5) / SH_C0).astype(np.float32)


def largest_restored(
    three: NDArray[np.floating], largest: NDArray[np.integer]
) -> NDArray[np.float32]:
    """Unit quaternions ``(4, N)`` from the three components ``(3, N)`` other than the largest.

    If the three are too long for a unit quaternion, the fourth is zero.
    """
    rest = np.sqrt(np.maximum(0.0, 1.0 - (three * three).sum(axis=0)))
    rows = np.arange(4)[:, None]
    column = np.clip(rows - (rows > largest), 0, 2)
    return np.where(rows == largest, rest, np.take_along_axis(three, column, axis=0)).astype(
        np.float32
    )

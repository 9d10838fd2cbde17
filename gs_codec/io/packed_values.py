"""Values that formats of few bits share: opacities and colours of a byte, quaternions of three."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gs_codec.scene import SH_C0

log = logging.getLogger(__name__)

#: Gaussians whose values are worked out at once.
_AT_ONCE = 1 << 16

#: Of an opacity of 0 or 255, which has no logit: so far from it, a quarter of a step.
_END = 0.25


def planes_of(channels: int, count: int, values: Callable[[slice], NDArray]) -> NDArray[np.float32]:
    """Planes ``(channels, N)`` of values, worked out for some of the Gaussians at a time.

    What formulas need beside their result, often more, is never there for the whole scene.
    """
    planes = np.empty((channels, count), np.float32)
    for start in range(0, count, _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        planes[:, some] = values(some)
    return planes


def opacities_of(path: str | Path, alpha: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Logits ``(1, N)`` of opacities in 255ths ``(N,)``; those of 0 and 1 are made finite."""
    ends = int(np.count_nonzero((alpha == 0) | (alpha == 255)))
    if ends:
        # No loss: less than a step of the format.
        log.info(
            "%s: opacity of 0 or 1 in %d Gaussians, which has no logit: moved by %.2g",
            *(path, ends, _END / 255),
        )
    share = np.clip(np.arange(256.0), _END, 255 - _END) / 255
    return np.log(share / (1 - share)).astype(np.float32)[alpha][None]


def bytes_of_opacities(logits: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The inverse of `opacities_of`, rounded."""
    with np.errstate(over="ignore"):
        return np.rint(255 / (1 + np.exp(-logits.astype(np.float64)))).astype(np.uint8)


def sh_of_colours(colours: NDArray) -> NDArray[np.float32]:
    """Degree-0 SH coefficients of colours, 0-1."""
    with np.errstate(over="ignore"):  # between bounds that are
        return ((colours - 0.5) / SH_C0).astype(np.float32)


def largest_restored(
    three: NDArray[np.floating], largest: NDArray[np.integer]
) -> NDArray[np.float32]:
    """Unit quaternions ``(4, N)`` of all components but the largest ``(3, N)``, in their order.

    Where the three are too long for a unit quaternion, the fourth is zero.
    """
    rest = np.sqrt(np.maximum(0.0, 1.0 - (three * three).sum(axis=0)))
    rows = np.arange(4)[:, None]
    place = np.clip(rows - (rows > largest), 0, 2)
    return np.where(rows == largest, rest, np.take_along_axis(three, place, axis=0)).astype(
        np.float32
    )

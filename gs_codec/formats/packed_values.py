"""Encodings that several formats share: bytes, packed quaternions, values after activation.

Their writers also share processing part by part, and sentences on what is lost.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from gs_codec.errors import InvalidInput
from gs_codec.runtime.arrays import empty
from gs_codec.runtime.wording import counted
from gs_codec.scene import GROUPS, SH_C0, Scene

log = logging.getLogger(__name__)

#: Number of Gaussians computed at once.
_AT_ONCE = 1 << 16

#: Opacities of 0 and 255 have no logit, and are moved by this many steps.
_END = 0.25


def planes_of(
    channels: int,
    count: int,
    values: Callable[[slice], NDArray],
    dtype: DTypeLike = np.float32,
) -> NDArray[Any]:
    """Compute planes ``(channels, N)`` for a part of the Gaussians at a time.

    The temporary arrays of `values`, often larger than the result, then stay small.
    """
    planes = empty((channels, count), dtype)
    for some in spans(count):
        planes[:, some] = values(some)
    return planes


def spans(count: int) -> Iterator[slice]:
    """Spans of Gaussians to compute at once."""
    for start in range(0, count, _AT_ONCE):
        yield slice(start, min(start + _AT_ONCE, count))


def opacities_of(path: str | Path, alpha: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Logits ``(1, N)`` of opacities ``(N,)`` in units of 1/255; 0 and 1 are made finite."""
    ends = int(np.count_nonzero((alpha == 0) | (alpha == 255)))
    if ends:
        # INFO only: the change is less than a step of the format.
        log.info(
            "%s: opacity 0 or 1 has no logit, moved by %.2g in %s",
            *(path, _END / 255, counted(ends, "Gaussian")),
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


def largest_omitted(rot: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Invert `largest_restored`: three components ``(3, N)``, and the index of the largest.

    Quaternions ``(4, N)`` may have any norm; norm 0 is replaced by the first unit vector.
    """
    wide = unit_quaternions(rot)
    largest = np.argmax(np.abs(wide), axis=0)
    wide *= np.copysign(1.0, np.take_along_axis(wide, largest[None], 0)[0])
    rows = np.arange(3)[:, None]
    return np.take_along_axis(wide, rows + (rows >= largest), axis=0), largest


def unit_quaternions(rot: NDArray[np.float32]) -> NDArray[np.float64]:
    """Quaternions ``(4, N)`` of length 1; one of norm 0 becomes the first unit vector."""
    wide = rot.astype(np.float64)
    wide[0, ~wide.any(axis=0)] = 1.0
    # Norms of tiny or huge components would underflow or overflow.
    wide /= np.abs(wide).max(axis=0)
    return wide / np.sqrt((wide * wide).sum(axis=0))


#: Maximum octaves by which rounding is coarser than the format's own.
_COARSEST = 20.0


def multiples(
    levels: NDArray[np.floating], steps: NDArray[np.floating], rounded: np.ufunc = np.rint
) -> NDArray[np.float64]:
    """Levels rounded to integers, or to multiples of the largest power of two below a step."""
    factor = np.exp2(np.floor(np.log2(np.clip(steps, 1.0, 2.0**_COARSEST))))
    return rounded(levels.astype(np.float64) / factor) * factor


def sigmoid(logits: NDArray[np.float64]) -> NDArray[np.float64]:
    """Opacities, 0-1, of logits."""
    with np.errstate(over="ignore"):
        return 1 / (1 + np.exp(-logits))


@dataclass
class Clipped:
    """Number of Gaussians with values out of a format's range, by attribute."""

    counts: dict[str, int] = field(default_factory=dict)

    def limited(
        self, what: str, values: NDArray[np.floating], low: float, high: float
    ) -> NDArray[np.floating]:
        """Clip values ``(channels, n)`` to an interval, and count the Gaussians that change."""
        limited = np.clip(values, low, high)
        changed = int(np.count_nonzero((limited != values).any(axis=0)))
        self.counts[what] = self.counts.get(what, 0) + changed
        return limited

    @classmethod
    def sum(cls, parts: Sequence[Clipped]) -> Clipped:
        """The numbers of several parts together."""
        counts = Counter[str]()
        for part in parts:
            counts.update(part.counts)
        return cls(counts)

    def sentences(self) -> list[str]:
        """Sentences on what was clipped."""
        return [
            f"{what} of {counted(count, 'Gaussian')} clipped to the format's range"
            for what, count in self.counts.items()
            if count
        ]


def check_finite(scene: Scene, suffix: str) -> None:
    """Reject values that are not finite."""
    planes = chain.from_iterable(getattr(scene, group) for group in GROUPS)
    if not all(np.isfinite(plane).all() for plane in planes):
        raise InvalidInput(f"values that are not finite, which {suffix} cannot store")


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

"""Uniform quantisers of one channel (paper, Section 4.3) and their inverse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gs_codec.runtime.kernels import kernel

#: Default range of SH-AC after rectification: Laplace scales on either side of the median, per bit
#: of depth. The paper gives the number only in its supplement. Clipped tails are visible, and
#: entropy coding makes rare levels cheap: a wide range with one more bit of depth takes no more
#: space than a narrow one, and renders are closer to the original (LAB_NOTEBOOK.md).
LAPLACE_SCALES_PER_BIT = 3.0


@dataclass(frozen=True)
class ConstantQuantiser:
    """A constant channel, of depth 0."""

    kind: ClassVar[str] = "constant"
    value: float
    depth: ClassVar[int] = 0
    step: ClassVar[float] = 0.0

    @property
    def origin(self) -> float:
        """Value of symbol 0."""
        return self.value


@dataclass(frozen=True)
class RangeQuantiser:
    """``2**depth`` levels from `low` to `high`, both included (min-max quantisation)."""

    kind: ClassVar[str] = "range"
    depth: int
    low: float
    high: float

    @property
    def step(self) -> float:
        """Distance between neighbouring levels."""
        return (self.high - self.low) / ((1 << self.depth) - 1)

    @property
    def origin(self) -> float:
        """Value of symbol 0."""
        return self.low


@dataclass(frozen=True)
class CentredQuantiser:
    """``2**depth`` levels; symbol ``2**(depth - 1)`` is `centre`.

    The error is at most half a step for values within `half_range` of the centre; values beyond it
    are rectified to the first or last level.
    """

    kind: ClassVar[str] = "centred"
    depth: int
    centre: float
    half_range: float

    @property
    def step(self) -> float:
        """Distance between neighbouring levels."""
        return 2.0 * self.half_range / ((1 << self.depth) - 1)

    @property
    def origin(self) -> float:
        """Value of symbol 0."""
        return self.centre - (1 << (self.depth - 1)) * self.step


Quantiser = ConstantQuantiser | RangeQuantiser | CentredQuantiser


@kernel
def _range_of(values):
    """Minimum and maximum, float64; 0 if there are no values."""
    if values.size == 0:
        return 0.0, 0.0
    low = high = values[0]
    for value in values:
        low = min(low, value)
        high = max(high, value)
    return np.float64(low), np.float64(high)


@kernel
def _quantise(values, order, origin, step, symbols, histogram):
    """Quantise ``values[order]``, count a histogram, and return how many values were clamped."""
    last = np.float64(histogram.size - 1)
    inverse = 1.0 / step
    clamped = 0
    for i in range(order.size):
        level = np.floor((np.float64(values[order[i]]) - origin) * inverse + 0.5)
        clamped += level < 0.0 or level > last
        symbol = np.uint16(min(max(level, 0.0), last))
        symbols[i] = symbol
        histogram[symbol] += 1
    return clamped


def fit_range(values: NDArray[np.float32], depth: int) -> ConstantQuantiser | RangeQuantiser:
    """Min-max quantiser of a finite channel ``(N,)``; constant if all values are equal."""
    low, high = _range_of(values)
    return ConstantQuantiser(low) if low == high else RangeQuantiser(depth, low, high)


def fit_centred(
    values: NDArray[np.float32], depth: int, scales: float | None = None
) -> tuple[ConstantQuantiser | CentredQuantiser, float]:
    """Quantiser of an SH-AC channel ``(N,)`` after rectification to its Laplace range.

    The half range is `scales` (by default `LAPLACE_SCALES_PER_BIT` times `depth`) times the mean
    absolute deviation of the values that differ from the median, but at most the largest deviation.
    Values equal to the median are left out of the mean: trained scenes have many exact zeros, which
    would narrow the range of the others.

    Returns
    -------
    quantiser : ConstantQuantiser or CentredQuantiser
    scale : float
        Mean absolute deviation of all values from the median, in steps: the Laplace
        distribution's parameter (paper, Section 4.3).
    """
    low, high = _range_of(values)
    if low == high:
        return ConstantQuantiser(low), 0.0
    middle = (values.size - 1) // 2
    centre = float(np.partition(values, middle)[middle])
    deviation, off_centre = _deviation(values, centre)
    reach = max(high - centre, centre - low)
    if scales is None:
        scales = LAPLACE_SCALES_PER_BIT * depth
    half_range = float(np.float32(min(scales * deviation / off_centre, reach)))
    if half_range == 0.0:
        half_range = float(np.finfo(np.float32).smallest_subnormal)
    quantiser = CentredQuantiser(depth, centre, half_range)
    return quantiser, deviation / values.size / quantiser.step


@kernel
def _deviation(values, centre):
    """Sum of absolute deviations from `centre`, and number of values that differ from it."""
    total = 0.0
    count = 0
    for value in values:
        deviation = abs(np.float64(value) - centre)
        total += deviation
        count += deviation != 0.0
    return total, count


def quantise(
    values: NDArray[np.float32], quantiser: Quantiser, order: NDArray[np.int64]
) -> tuple[NDArray[np.uint16], NDArray[np.int64], int]:
    """Symbols ``(N,)`` of ``values[order]``, for depths up to 16; ties go to the upper level.

    Returns
    -------
    symbols : ndarray, shape (N,), uint16
    histogram : ndarray, shape (2**depth,), int64
    clamped : int
        Number of values more than half a step beyond the first or last level.
    """
    symbols = np.zeros(order.size, np.uint16)
    histogram = np.zeros(1 << quantiser.depth, np.int64)
    if quantiser.depth == 0:
        histogram[0] = order.size
        return symbols, histogram, 0
    clamped = _quantise(values, order, quantiser.origin, quantiser.step, symbols, histogram)
    return symbols, histogram, clamped


def quantise_positions(
    positions: NDArray[np.float32], quantisers: Sequence[Quantiser]
) -> NDArray[np.uint32]:
    """Quantise positions ``(3, N)`` to cells ``(3, N)``, in the order given; depths up to 21."""
    cells = np.zeros(positions.shape, np.uint32)
    for plane, quantiser, row in zip(positions, quantisers, cells, strict=True):
        if quantiser.depth:
            offsets = np.subtract(plane, quantiser.origin, dtype=np.float64)
            levels = np.floor(offsets / quantiser.step + 0.5)
            row[:] = np.clip(levels, 0, (1 << quantiser.depth) - 1)
    return cells


def dequantise(symbols: NDArray[np.integer], quantiser: Quantiser) -> NDArray[np.float32]:
    """Values ``(N,)`` of symbols: ``origin + symbol * step``, in float64, then float32.

    Product and sum are rounded separately, so every machine gives the same floats. A level beyond
    the float32 range is clamped to it.
    """
    levels = symbols * np.float64(quantiser.step)
    levels += quantiser.origin
    largest = np.finfo(np.float32).max
    return np.clip(levels, -largest, largest, out=levels).astype(np.float32)

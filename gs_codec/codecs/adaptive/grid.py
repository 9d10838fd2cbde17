"""Choose the grid of positions, and which Gaussians are too far away for it.

A grid has at most 21 bits per axis. If that is enough to span all centres with the wanted step
size, it spans them. If not, there are two ways: a coarser grid, or a grid that leaves some
Gaussians outside. These are *far*, and their centres are stored as float32. The way with the lower
estimated cost in bits is chosen; the cost of a coarser grid is the number of bits that would reduce
other errors by the same amount.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.lattice import (
    MOST_AXIS_BITS,
    MOST_FAR_BITS,
    PositionGrid,
    outside,
)
from gs_codec.codecs.adaptive.step_sizes import finest_step

#: Lowest and highest x, y, z of all centres, each ``(3,)``.
Bounds = tuple[NDArray[np.float32], NDArray[np.float32]]

#: Log2 of the smallest side of a cell.
_FINEST = -120

#: Log2 of the largest side of a cell.
_COARSEST = 127

#: Extra bits of a far centre, compared with a centre on the grid.
_FAR_BITS = 70.0

#: Cost, in bits per Gaussian, of doubling the squared error of positions. Positions cause 3 of 59
#: parts of the error. Scaling the whole error by a factor f changes each of about 20 non-zero
#: values by log2(f) / 2 bits: 0.5 * 20 / ln(2) * 3 / 59.
_ERROR_BITS = 0.7

#: Minimum saving, in bits per Gaussian, because older readers refuse files with far Gaussians. It
#: forgoes at most 0.15 dB in views.
_LEAST_SAVED = 0.5

#: Target size of the sample for comparing grids; the actual size is less than twice this.
_SAMPLE = 10_000

#: Bits of a float32's mantissa.
_MANTISSA = 24

#: Minimum magnitude of a coordinate, so that logarithms are finite.
_TINY = np.float32(1e-44)

_LARGEST = float(np.finfo(np.float32).max)


def choose_grid(
    bounds: Bounds | None,
    positions: NDArray[np.float32],
    wanted: NDArray[np.float64],
    may_have_far: bool = True,
) -> tuple[PositionGrid, float]:
    """Choose the position grid; return it and log2 of the side of its cells.

    Parameters
    ----------
    bounds : tuple of two ndarray, shape (3,), or None
        Lowest and highest x, y, z of all centres; None if there are none.
    positions : ndarray, shape (3, n)
        A sample of the centres.
    wanted : ndarray, shape (n,)
        Log2 of the wanted position step sizes of the sample.
    may_have_far : bool
        Whether the grid may leave out far Gaussians.
    """
    if bounds is None:
        return PositionGrid((0.0, 0.0, 0.0), 1.0, (0, 0, 0)), 0.0
    low, high = (corner.astype(np.float64) for corner in bounds)
    widest = math.frexp(max(float((high - low).max()), 1e-30))[1]
    lowest, highest = max(widest - MOST_AXIS_BITS, _FINEST), min(widest, _COARSEST)
    unit = finest_step(wanted, lowest, highest)
    if may_have_far and finest_step(wanted, _FINEST, highest) < unit:
        some = slice(None, None, max(1, len(wanted) // _SAMPLE))
        found = _with_far(low, high, positions[:, some], wanted[some], unit)
        if found is not None:
            return found
    return _whole(low, high, unit), unit


def _whole(low: NDArray[np.float64], high: NDArray[np.float64], unit: float) -> PositionGrid:
    """The grid that spans all centres."""
    step = _side(unit)
    bits = _bits(high - low, step)
    return PositionGrid(_corner(_origin(low, high, step)), step, (bits[0], bits[1], bits[2]))


def _origin(
    low: NDArray[np.float64], high: NDArray[np.float64], step: float
) -> NDArray[np.float64]:
    """Lowest corner of a grid that spans all centres ``(3,)``."""
    # A flat axis has one cell, whose middle is the coordinate.
    return low - 0.5 * step * (high == low)


def _side(unit: float) -> float:
    return float(np.float32(2.0**unit))


def _bits(extent: NDArray[np.float64], step: float) -> list[int]:
    """Bits of cell indices over an extent ``(3,)``."""
    return [max(math.frexp(size / step)[1], 0) for size in extent]


def _corner(origin: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = np.clip(origin, -_LARGEST, _LARGEST).astype(np.float32).astype(float)
    return float(x), float(y), float(z)


def _with_far(
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    positions: NDArray[np.float32],
    wanted: NDArray[np.float64],
    coarsest: float,
) -> tuple[PositionGrid, float] | None:
    """The best grid with far Gaussians; None if a grid over all centres is better."""
    # Steps below the last bit of a coordinate gain nothing.
    largest = np.maximum(np.abs(positions).max(axis=0), _TINY)
    wanted = np.maximum(wanted, np.frexp(largest)[1] - _MANTISSA)
    unit = finest_step(wanted, _FINEST, coarsest)
    octaves = np.maximum(wanted, unit)

    def lost(unit: float) -> float:
        return _ERROR_BITS * float(np.mean(np.exp2(2 * np.maximum(unit - octaves, 0)) - 1))

    best, least = None, lost(coarsest) - _LEAST_SAVED
    while max(_bits(high - low, _side(unit))) > MOST_AXIS_BITS and lost(unit) < least:
        grid = _around_most(low, high, positions, _side(unit))
        share = float(np.mean(outside(positions, grid))) if grid.has_far else 0.0
        if lost(unit) + _FAR_BITS * share < least:
            best, least = (grid, unit), lost(unit) + _FAR_BITS * share
        unit += 1
    return best


def _around_most(
    low: NDArray[np.float64], high: NDArray[np.float64], positions: NDArray[np.float32], step: float
) -> PositionGrid:
    """The grid with this cell size that contains the most of these centres."""
    needed = _bits(high - low, step)
    bits = [min(number, MOST_AXIS_BITS) for number in needed]
    if sum(bits) > MOST_FAR_BITS:
        quartiles = np.quantile(positions.astype(np.float64), [0.25, 0.75], axis=1)
        bits[int(np.argmin(quartiles[1] - quartiles[0]))] -= 1
    whole = _origin(low, high, step)
    cut = [axis for axis in range(3) if needed[axis] > bits[axis]]
    most, found = -1, _corner(whole)
    for first in range(len(cut)):
        # With several clusters, the order of the axes matters.
        origin, inside = whole.copy(), positions
        for axis in cut[first:] + cut[:first]:
            origin[axis], chosen = _window(inside[axis], step * 2.0 ** bits[axis])
            inside = inside[:, chosen]
        if inside.shape[1] > most:
            most, found = inside.shape[1], _corner(origin)
    grid = PositionGrid(found, step, (bits[0], bits[1], bits[2]), has_far=True)
    corners = np.stack([low, high], axis=1).astype(np.float32)
    return replace(grid, has_far=bool(outside(corners, grid).any()))


def _window(row: NDArray[np.float32], width: float) -> tuple[float, NDArray[np.bool_]]:
    """The start of the interval of this width with most coordinates, and a mask of those inside."""
    values = np.sort(row.astype(np.float64))
    counts = np.searchsorted(values, values + width) - np.arange(len(values))
    first = int(np.argmax(counts))
    ends = values[first], values[first + counts[first] - 1]
    # Centre the interval on them.
    return 0.5 * (ends[0] + ends[1] - width), (row >= ends[0]) & (row <= ends[1])

"""Choose the grid of positions, and which Gaussians are too far away for it.

A grid has at most 21 bits an axis. It spans all centres if it may then be as fine as positions
should be. If not, it is coarser, or some Gaussians are *far*: they lie outside of it, and their
centres are stored as they are. Whichever is estimated to take fewer bits is chosen, coarser steps
counted by the bits that make up for their error elsewhere.
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

#: Log2 of the finest and the coarsest side of a cell.
_FINEST, _COARSEST = -120, 127

#: Bits that a far centre takes beyond one on the grid.
_FAR_BITS = 70.0

#: Bits a Gaussian that make up for a squared error of positions twice that of the wanted steps:
#: positions cause 3 of 59 parts of all error, and a factor on all error takes half its logarithm
#: for each of about 20 values of a Gaussian that are not 0: 0.5 * 20 / ln(2) * 3 / 59.
_ERROR_BITS = 0.7

#: Bits a Gaussian that far ones have to save, as older readers do not read files with them. In
#: views, what is not saved is 0.15 dB.
_LEAST_SAVED = 0.5

#: Grids with far Gaussians are compared by at most twice this many of them.
_SAMPLE = 10_000

#: Bits of the mantissa of a float32; a coordinate that is not 0, for its logarithm.
_MANTISSA, _TINY = 24, np.float32(1e-44)

_LARGEST = float(np.finfo(np.float32).max)


def choose_grid(
    bounds: Bounds | None,
    positions: NDArray[np.float32],
    wanted: NDArray[np.float64],
    may_have_far: bool = True,
) -> tuple[PositionGrid, float]:
    """The grid of positions, and log2 of the side of its cells.

    Parameters
    ----------
    bounds : tuple of two ndarray, shape (3,), or None
        Of all centres; None if there are none.
    positions : ndarray, shape (3, n)
        Some of the centres.
    wanted : ndarray, shape (n,)
        Log2 of the step sizes that their positions should have.
    may_have_far : bool
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
    """Where cells that span all centres begin ``(3,)``."""
    # A flat axis has one cell, whose middle is the coordinate.
    return low - 0.5 * step * (high == low)


def _side(unit: float) -> float:
    return float(np.float32(2.0**unit))


def _bits(extent: NDArray[np.float64], step: float) -> list[int]:
    """Bits of cells that span an extent ``(3,)``."""
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
    """The best grid with far Gaussians; None if one that spans all is better."""
    # Steps finer than the last bit of a coordinate gain nothing.
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
    """The grid with cells of a side that has the most of some centres inside."""
    needed = _bits(high - low, step)
    bits = [min(number, MOST_AXIS_BITS) for number in needed]
    if sum(bits) > MOST_FAR_BITS:
        quartiles = np.quantile(positions.astype(np.float64), [0.25, 0.75], axis=1)
        bits[int(np.argmin(quartiles[1] - quartiles[0]))] -= 1
    whole = _origin(low, high, step)
    cut = [axis for axis in range(3) if needed[axis] > bits[axis]]
    most, found = -1, _corner(whole)
    for first in range(len(cut)):
        # Which axis comes first matters if there are several clusters.
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
    """Where a window begins that has the most of some coordinates, and which these are."""
    values = np.sort(row.astype(np.float64))
    counts = np.searchsorted(values, values + width) - np.arange(len(values))
    first = int(np.argmax(counts))
    ends = values[first], values[first + counts[first] - 1]
    # They are in its middle.
    return 0.5 * (ends[0] + ends[1] - width), (row >= ends[0]) & (row <= ends[1])

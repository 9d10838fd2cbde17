"""Group vectors into cells, as coarse as the step sizes of the vectors allow.

Squared errors are in units of the vector's step size. A bit has the same value as for a uniform
quantiser with that step, so rounding by tables of any size is as fine as the steps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.runtime.arrays import current, empty
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.threads import run_all

#: Value of a bit: the error of a uniform quantiser is 1/12, and a quarter of that with one more
#: bit.
WORTH = math.log(4.0) / 12

#: Approximate bits of a 0 in a row.
_ZERO_BITS = 0.6

#: Approximate bits of a 1 or -1.
_FIRST_BITS = 2.5

#: Approximate extra bits for each further octave of magnitude.
_OCTAVE_BITS = 1.5

#: Maximum number of times that the means of the halves of a cell are updated.
_MOVES = 5

#: Number of vectors of a larger cell that are enough to find its halves.
_ENOUGH = 1 << 12

#: When there are this many times as many cells as before, the vectors of each are moved together,
#: so that they share pages of memory, ...
_APART = 4

#: ... as long as cells have more vectors than this on average.
_FEW = 1 << 14

#: Number of vectors per task.
_CHUNK = 1 << 13


@dataclass(frozen=True)
class Cells:
    """Vectors grouped into cells, by repeatedly splitting one initial cell.

    Attributes
    ----------
    order : ndarray, shape (N,), int32
        Indices of the vectors, cell by cell.
    stops : ndarray, shape (cells,), int64
        End of each cell in `order`.
    """

    order: NDArray[np.int32]
    stops: NDArray[np.int64]

    def labels(self) -> NDArray[np.int32]:
        """The cell of each vector."""
        labels = empty(self.order.shape, np.int32)
        labels[self.order] = np.repeat(np.arange(len(self.stops), dtype=np.int32), self.sizes())
        return labels

    def sizes(self) -> NDArray[np.int64]:
        """Number of vectors of each cell."""
        return np.diff(self.stops, prepend=0)


class _Splits(NamedTuple):
    """Cells, the best split of each, and its gain."""

    starts: NDArray[np.int64]
    stops: NDArray[np.int64]
    middles: NDArray[np.int64]
    gains: NDArray[np.float64]


def split_cells(vectors: NDArray[np.float32], weights: NDArray[np.float64], most: int) -> Cells:
    """Split vectors into cells as long as this reduces the error by more than the bits cost.

    Parameters
    ----------
    vectors : ndarray, shape (N, D), float32
    weights : ndarray, shape (N,), float64
        The inverse square of each step size.
    most : int
        Maximum number of cells.
    """
    order, names, apart = _ascending(len(vectors)), _ascending(len(vectors)), 1
    cells = _split_each(vectors, weights, order, np.zeros(1, np.int64), np.array([len(vectors)]))
    while True:
        room = most - len(cells.starts)
        # The best half first, because their parts may gain more than other cells.
        chosen = np.argsort(-cells.gains, kind="stable")[: -(-room // 2)]
        chosen = np.sort(chosen[cells.gains[chosen] > 0])
        if not len(chosen):
            return Cells(_gathered(names, order), cells.stops)
        if _APART * apart <= len(cells.starts) < len(vectors) / _FEW:
            vectors, weights, names = (_gathered(x, order) for x in (vectors, weights, names))
            order, apart = _ascending(len(order)), len(cells.starts)
        ends = cells.starts[chosen], cells.middles[chosen], cells.stops[chosen]
        starts, stops = np.stack(ends[:2], 1).ravel(), np.stack(ends[1:], 1).ravel()
        parts = _split_each(vectors, weights, order, starts, stops)
        kept = np.ones(len(cells.starts), bool)
        kept[chosen] = False
        sequence = np.argsort(np.concatenate([cells.starts[kept], starts]))
        columns = [
            np.concatenate([old[kept], new])[sequence]
            for old, new in zip(cells, parts, strict=True)
        ]
        cells = _Splits(*columns)


def _ascending(count: int) -> NDArray[np.int32]:
    numbers = empty((count,), np.int32)
    numbers[:] = np.arange(count, dtype=np.int32)
    return numbers


def _gathered(rows: NDArray, order: NDArray[np.int32]) -> NDArray:
    """Rows in another order."""
    gathered = empty(rows.shape, rows.dtype)

    def work(start: int) -> None:
        some = slice(start, start + _CHUNK)
        gathered[some] = rows[order[some]]

    run_all(work, range(0, len(rows), _CHUNK))
    return gathered


def _split_each(
    vectors: NDArray[np.float32],
    weights: NDArray[np.float64],
    order: NDArray[np.int32],
    starts: NDArray[np.int64],
    stops: NDArray[np.int64],
) -> _Splits:
    """Find the two parts of each cell, and sort the vectors of each in `order` by them."""
    current().release()  # the samples of large cells map all vectors
    middles, gains = starts.copy(), np.zeros(len(starts))
    # About the same number of vectors in each batch.
    batches = np.cumsum(stops - starts) // _CHUNK
    cuts = [*np.flatnonzero(np.diff(batches, prepend=-1)), len(starts)]

    def run(batch: int) -> None:
        some = slice(cuts[batch], cuts[batch + 1])
        of_batch = starts[some], stops[some], middles[some], gains[some]
        _split(vectors, weights, order, *of_batch)

    run_all(run, range(len(cuts) - 1))
    return _Splits(starts, stops, middles, gains)


@kernel
def _split(vectors, weights, order, starts, stops, middles, gains):
    size = 0
    for cell in range(len(starts)):
        size = max(size, stops[cell] - starts[cell])
    side, upper = np.empty(size, np.uint8), np.empty(size, order.dtype)
    depth = vectors.shape[1]
    whole, halves = np.empty(depth + 1), np.empty((2, depth + 1))
    most = min(size, 2 * _ENOUGH)
    few, their_weights = np.empty((most, depth), vectors.dtype), np.empty(most)
    for cell in range(len(starts)):
        members = order[starts[cell] : stops[cell]]
        count = len(members)
        stride = max(count // _ENOUGH, 1)
        some = upper[: -(-count // stride)]
        # Copies, because each of a few vectors of a large cell is in another page of memory.
        for j in range(len(some)):
            i = members[j * stride]
            for d in range(depth):
                few[j, d] = vectors[i, d]
            their_weights[j] = weights[i]
            some[j] = j
        if not _start_halves(few, their_weights, some, side):
            continue
        for _ in range(_MOVES):
            ones = _sum_halves(few, their_weights, some, side, halves)
            if ones in (0, len(some)) or not _move_halves(few, some, halves, side):
                break
        if stride > 1:
            _move_halves(vectors, members, halves, side)
        ones = _sum_halves(vectors, weights, members, side, halves)
        if ones in (0, count):
            continue
        for d in range(depth + 1):
            whole[d] = halves[0, d] + halves[1, d]
        gain = _cost_of(whole) - _cost_of(halves[0]) - _cost_of(halves[1])
        share = ones / count
        bits = -ones * np.log2(share) - (count - ones) * np.log2(1 - share)
        gains[cell] = gain - WORTH * bits
        middles[cell] = starts[cell] + _sort_halves(members, side, upper)


@kernel
def _sort_halves(members, side, upper):
    """Sort vectors by their half; return the size of the first. `upper` is temporary."""
    low = high = 0
    for j in range(len(members)):
        if side[j]:
            upper[high] = members[j]
            high += 1
        else:
            members[low] = members[j]
            low += 1
    for j in range(high):
        members[low + j] = upper[j]
    return low


@kernel
def _start_halves(vectors, weights, members, side):
    """Split vectors at the mean of the axis of largest variance; False if there is none."""
    depth = vectors.shape[1]
    sums, squares = np.zeros(depth), np.zeros(depth)
    total = 0.0
    for i in members:
        weight = weights[i]
        total += weight
        for d in range(depth):
            sums[d] += weight * vectors[i, d]
            squares[d] += weight * vectors[i, d] * vectors[i, d]
    widest, axis = 0.0, -1
    for d in range(depth):
        spread = squares[d] - sums[d] * sums[d] / total
        if spread > widest:
            widest, axis = spread, d
    if axis < 0:
        return False
    cut = sums[axis] / total
    for j in range(len(members)):
        side[j] = vectors[members[j], axis] > cut
    return True


@kernel
def _sum_halves(vectors, weights, members, side, halves):
    """The weighted sum of each half, and its weight; return the size of the second."""
    depth = vectors.shape[1]
    halves[:] = 0.0
    ones = 0
    for j in range(len(members)):
        i, half = members[j], side[j]
        weight = weights[i]
        ones += half
        halves[half, depth] += weight
        for d in range(depth):
            halves[half, d] += weight * vectors[i, d]
    return ones


@kernel
def _move_halves(vectors, members, halves, side):
    """Move vectors to the half with the nearer mean; whether any moved."""
    depth = vectors.shape[1]
    normal = np.empty(depth)
    offset = 0.0
    for d in range(depth):
        first, second = halves[0, d] / halves[0, depth], halves[1, d] / halves[1, depth]
        normal[d] = second - first
        offset += 0.5 * (second * second - first * first)
    moved = False
    for j in range(len(members)):
        i = members[j]
        along = -offset
        for d in range(depth):
            along += vectors[i, d] * normal[d]
        if (along > 0) != side[j]:
            side[j] = along > 0
            moved = True
    return moved


@kernel
def _cost_of(sums):
    """Error and bits of a row for vectors with these weighted sums, minus the common part.

    The squared error of vectors about their mean is the sum of their squares minus the mean's.
    """
    depth = len(sums) - 1
    cost = 0.0
    for d in range(depth):
        square = sums[d] * sums[d] / sums[depth]
        cost += _value_cost(square) - square
    return cost


@inlined
def _value_cost(square):
    """Error and bits of a value of a row, whose step is as fine as all its vectors require."""
    if square < 0.25:
        return square + WORTH * _ZERO_BITS
    bits = _FIRST_BITS + _OCTAVE_BITS * max(np.floor(0.5 * np.log2(square)), 0.0)
    return 1 / 12 + WORTH * bits


def row_means(
    vectors: NDArray[np.float32],
    weights: NDArray[np.float64],
    labels: NDArray[np.int32],
    count: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weighted means ``(count, D)`` of the vectors with each label, and their weights ``(count,)``.

    The mean of no vectors is 0.
    """
    sums, total = np.zeros((count, vectors.shape[1])), np.zeros(count)
    _add_rows(vectors, weights, labels, sums, total)
    return sums / np.where(total > 0, total, 1.0)[:, None], total


@kernel
def _add_rows(vectors, weights, labels, sums, total):
    for i in range(len(vectors)):
        label, weight = labels[i], weights[i]
        total[label] += weight
        for d in range(vectors.shape[1]):
            sums[label, d] += weight * vectors[i, d]

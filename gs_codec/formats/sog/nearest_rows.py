"""Find the palette row of each vector: the lowest error and bits among rows that may be near.

Rows are compared in blocks. Each vector searches the blocks of the most used rows, that of its
current row, and those whose means are nearest to it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.formats.cells import WORTH
from gs_codec.formats.codebook import label_bits
from gs_codec.runtime.arrays import empty
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.threads import run_all

#: Number of rows of a block: 24 kB, for the first cache.
_WIDTH = 128

#: Number of most used rows, which all vectors search.
_COMMON = 2 * _WIDTH

#: Number of coefficients that are added at once, so that costs are loaded and stored less often.
_TOGETHER = 8

#: Number of vectors per task.
_CHUNK = 1 << 13


class _Blocks(NamedTuple):
    """Rows in blocks; places without a row have infinite squares.

    Attributes
    ----------
    values : ndarray, shape (blocks, D padded to a multiple of `_TOGETHER`, _WIDTH), float32
    squares : ndarray, shape (blocks, _WIDTH), float32
        Squared magnitude of each row.
    prices : ndarray, shape (blocks, _WIDTH), float32
        Its bits, in units of squared errors.
    """

    values: NDArray[np.float32]
    squares: NDArray[np.float32]
    prices: NDArray[np.float32]


def nearest_rows(
    vectors: NDArray[np.float32],
    weights: NDArray[np.float64],
    labels: NDArray[np.int32],
    rows: NDArray[np.float32],
    nearest: int,
) -> NDArray[np.int32]:
    """The row with the lowest error and bits for each vector, among the rows in use.

    Parameters
    ----------
    vectors : ndarray, shape (N, D), float32
    weights : ndarray, shape (N,), float64
        As in `split_cells`.
    labels : ndarray, shape (N,), int32
        Current row of each vector.
    rows : ndarray, shape (K, D), float32
        Similar ones next to each other.
    nearest : int
        Number of blocks that a vector searches, besides its current one and the most used rows.
    """
    counts = np.bincount(labels, minlength=len(rows))
    is_common = np.zeros(len(rows), bool)
    is_common[np.argsort(-counts, kind="stable")[:_COMMON]] = True
    common, others = (
        np.flatnonzero((counts > 0) & chosen).astype(np.int32) for chosen in (is_common, ~is_common)
    )
    sequence = np.concatenate([_padded(common), _padded(others)])
    first = -(-len(common) // _WIDTH)
    blocks = _blocks_of(rows, sequence, WORTH * label_bits(counts))
    near_blocks = _means_of(blocks, first)
    block_of = np.zeros(len(rows), np.int64)
    block_of[sequence] = np.arange(len(sequence)) // _WIDTH
    found = empty(labels.shape, labels.dtype)

    def run(start: int) -> None:
        some = slice(start, start + _CHUNK)
        part, inverse = vectors[some], (1.0 / weights[some]).astype(np.float32)
        searched = np.zeros((len(blocks.values), len(part)), np.bool_)
        searched[:first] = True
        searched[block_of[labels[some]], np.arange(len(part))] = True
        _choose_blocks(part, *near_blocks, nearest, searched[first:])
        places = np.zeros(len(part), np.int64)
        _search(part, inverse, *blocks, searched, places)
        found[some] = sequence[places]

    run_all(run, range(0, len(vectors), _CHUNK))
    return found


def _padded(index: NDArray[np.int32]) -> NDArray[np.int32]:
    """Indices of rows, filled up with -1 to whole blocks."""
    return np.pad(index, (0, -len(index) % _WIDTH), constant_values=-1)


def _blocks_of(
    rows: NDArray[np.float32], sequence: NDArray[np.int32], prices: NDArray[np.float64]
) -> _Blocks:
    """The rows in a sequence, which may be -1, and their prices."""
    used, depth = sequence >= 0, rows.shape[1]
    values = np.zeros((len(sequence), depth + -depth % _TOGETHER), np.float32)
    values[used, :depth] = rows[sequence[used]]
    squares = np.where(used, (values * values).sum(axis=1), np.float32(np.inf))
    by_block = values.reshape(-1, _WIDTH, values.shape[1]).transpose(0, 2, 1)
    shape = (len(by_block), _WIDTH)
    of_rows = np.where(used, prices[sequence], 0.0).astype(np.float32)
    return _Blocks(np.ascontiguousarray(by_block), squares.reshape(shape), of_rows.reshape(shape))


def _means_of(blocks: _Blocks, first: int) -> _Blocks:
    """The means of the blocks from the `first`, as rows without prices."""
    numbers = np.isfinite(blocks.squares[first:]).sum(axis=1)
    means = (blocks.values[first:].sum(axis=2) / numbers[:, None]).astype(np.float32)
    return _blocks_of(means, _padded(np.arange(len(means), dtype=np.int32)), np.zeros(len(means)))


@kernel
def _find_costs(vector, inverse, values, squares, prices, own, costs):
    """Errors and bits of the rows of a block, minus the vector's square; `own` is temporary."""
    depth, width = values.shape
    for d in range(len(vector)):
        own[d] = np.float32(-2.0) * vector[d]
    for k in range(width):
        costs[k] = squares[k] + inverse * prices[k]
    for d in range(0, depth, _TOGETHER):
        a, b, c, e = own[d], own[d + 1], own[d + 2], own[d + 3]
        f, g, h, i = own[d + 4], own[d + 5], own[d + 6], own[d + 7]
        for k in range(width):
            low = (a * values[d, k] + b * values[d + 1, k]) + (
                c * values[d + 2, k] + e * values[d + 3, k]
            )
            high = (f * values[d + 4, k] + g * values[d + 5, k]) + (
                h * values[d + 6, k] + i * values[d + 7, k]
            )
            costs[k] += low + high


@kernel
def _choose_blocks(vectors, values, squares, prices, nearest, chosen):
    """Mark the blocks ``chosen (blocks, n)`` whose means are nearest to each vector."""
    own, costs = np.zeros(values.shape[1], np.float32), np.empty(values.shape[2], np.float32)
    least, places = np.empty(nearest, np.float32), np.empty(nearest, np.int64)
    for j in range(len(vectors)):
        found = 0
        for block in range(len(values)):
            _find_costs(
                vectors[j], np.float32(0.0), values[block], squares[block], prices[block], own,
                costs,
            )  # fmt: skip
            for k in range(min(len(costs), len(chosen) - block * len(costs))):
                if found == nearest and costs[k] >= least[nearest - 1]:
                    continue
                found = min(found + 1, nearest)
                place = found - 1
                while place > 0 and least[place - 1] > costs[k]:
                    least[place], places[place] = least[place - 1], places[place - 1]
                    place -= 1
                least[place] = costs[k]
                places[place] = block * len(costs) + k
        for place in range(found):
            chosen[places[place], j] = True


@kernel
def _search(vectors, inverse, values, squares, prices, searched, places):
    """Find the place of the best row of each vector, in the blocks ``searched (blocks, n)``."""
    own, costs = np.zeros(values.shape[1], np.float32), np.empty(values.shape[2], np.float32)
    least = np.full(len(vectors), np.float32(np.inf))
    for block in range(len(values)):
        for j in range(len(vectors)):
            if not searched[block, j]:
                continue
            _find_costs(
                vectors[j], inverse[j], values[block], squares[block], prices[block], own, costs
            )
            lowest = least[j]
            lower = 0
            for k in range(len(costs)):
                lower += costs[k] < lowest
            if lower:
                for k in range(len(costs)):
                    if costs[k] < lowest:
                        lowest = costs[k]
                        places[j] = block * len(costs) + k
                least[j] = lowest

"""Morton codes over axes of unequal depth; the canonical order of a scene."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.far import find_far
from gs_codec.runtime.arrays import Disk, current
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.scene import Scene

#: Bits of each axis in `spatial_order`.
_DEPTH = 21


def bit_layout(depths: tuple[int, int, int]) -> NDArray[np.int64]:
    """Axis of each code bit, most significant first.

    From level ``max(depths) - 1`` down to 0, each axis deeper than the level gives one bit, x
    before y before z; an axis of depth 0 (constant) gives none.
    """
    levels = range(max(depths) - 1, -1, -1)
    axes = [axis for level in levels for axis in range(3) if depths[axis] > level]
    return np.array(axes, np.int64)


def _bits(depths: tuple[int, int, int]) -> Iterator[tuple[int, int, int]]:
    """Yield the axis, its bit, and the bit of the code, for each code bit."""
    left = list(depths)
    total = sum(depths)
    for position, axis in enumerate(bit_layout(depths), 1):
        left[axis] -= 1
        yield axis, left[axis], total - position


def _byte_tables(depths: tuple[int, int, int]) -> NDArray[np.int64]:
    """Code bits of each value of each byte of each axis, shape (3, 3, 256)."""
    tables = np.zeros((3, 3, 256), np.int64)
    for axis, of_axis, of_code in _bits(depths):
        byte, bit = divmod(of_axis, 8)
        tables[axis, byte] |= ((np.arange(256) >> bit) & 1) << of_code
    return tables


@kernel
def _encode(cells, tables, codes):
    for i in range(codes.size):
        code = 0
        for axis in range(3):
            cell = np.int64(cells[axis, i])
            code |= tables[axis, 0, cell & 255]
            code |= tables[axis, 1, (cell >> 8) & 255]
            code |= tables[axis, 2, (cell >> 16) & 255]
        codes[i] = code


@lru_cache(maxsize=1)  # all blocks of a file have the same depths
def axis_tables(depths: tuple[int, int, int]) -> NDArray[np.uint32]:
    """Axis bits of each value of each byte of a code, shape (8, 256, 3)."""
    tables = np.zeros((8, 256, 3), np.uint32)
    for axis, of_axis, of_code in _bits(depths):
        byte, bit = divmod(of_code, 8)
        tables[byte, :, axis] |= (((np.arange(256) >> bit) & 1) << of_axis).astype(np.uint32)
    return tables


@inlined
def cells_of(code, size, tables):
    """Quantised position of a Morton code of `size` bytes; see `axis_tables`."""
    x = y = z = np.uint32(0)
    for byte in range(size):
        row = tables[byte, (code >> (8 * byte)) & 255]
        x |= row[0]
        y |= row[1]
        z |= row[2]
    return x, y, z


@kernel
def _decode(codes, size, tables, cells):
    for i in range(codes.size):
        cells[0, i], cells[1, i], cells[2, i] = cells_of(codes[i], size, tables)


def encode_morton(cells: NDArray[np.uint32], depths: tuple[int, int, int]) -> NDArray[np.int64]:
    """Morton codes ``(N,)`` of quantised positions ``(3, N)``."""
    codes = np.empty(cells.shape[1], np.int64)
    _encode(cells, _byte_tables(depths), codes)
    return codes


def decode_morton(codes: NDArray[np.int64], depths: tuple[int, int, int]) -> NDArray[np.uint32]:
    """Quantised positions ``(3, N)`` of Morton codes ``(N,)``."""
    cells = np.empty((3, codes.size), np.uint32)
    _decode(codes, -(-sum(depths) // 8), axis_tables(depths), cells)
    return cells


def spatial_order(
    positions: NDArray[np.float32], log_scale: NDArray[np.float32] | None = None
) -> NDArray[np.int64]:
    """Permutation ``(N,)`` that sorts finite centres ``(3, N)`` along a Morton curve.

    Far centres come last, along their own curve: on a common curve, all others would fall into one
    cell. `find_far` selects them, using `log_scale` if given.
    """
    found = find_far(positions, log_scale)
    if found is None:
        return _along_curve(positions)
    near = np.delete(np.arange(positions.shape[1]), found.far)
    far = found.far[spatial_order(positions[:, found.far])]  # find far centres at every scale
    # Reversed, so that it begins near the corner where the curve of the others ends.
    return np.concatenate([near[_along_curve(positions[:, near])], far[::-1]])


def _along_curve(positions: NDArray[np.float32]) -> NDArray[np.int64]:
    wide = positions.astype(np.float64)
    low = wide.min(axis=1, keepdims=True, initial=np.inf)
    side = float((wide - low).max(initial=0.0)) or 1.0
    cells = ((wide - low) * (((1 << _DEPTH) - 1) / side)).astype(np.uint32)
    return canonical_order(encode_morton(cells, (_DEPTH,) * 3))


def canonical_order(codes: NDArray[np.int64], *keys: NDArray) -> NDArray[np.int64]:
    """Permutation ``(N,)`` that sorts by (Morton code, keys, original index).

    Parameters
    ----------
    codes : ndarray, shape (N,), int64
    *keys : ndarray, each shape (N,)
        Order within a cell: by the first key, then the next.
    """
    order = np.argsort(codes)
    tied = find_ties(codes[order])
    ties = order[tied]
    order[tied] = ties[np.lexsort((ties, *(key[ties] for key in keys[::-1]), codes[ties]))]
    return order


def find_ties(*ordered: NDArray) -> NDArray[np.bool_]:
    """Which items ``(N,)`` equal a neighbour in all keys, each ``(N,)``."""
    same = np.all([keys[1:] == keys[:-1] for keys in ordered], axis=0)
    tied = np.zeros(ordered[0].size, bool)
    tied[1:] |= same
    tied[:-1] |= same
    return tied


Index = TypeVar("Index", bound=np.integer)


def in_stream_order(scene: Scene, order: NDArray[Index]) -> tuple[Scene, NDArray[Index]]:
    """Return the scene, and for each Gaussian of the stream its index in that scene.

    A scene on disk is sorted first; otherwise each block would read from all over the file.
    """
    storage = current()
    if not isinstance(storage, Disk):
        return scene, order
    return scene.take(order), storage.keep(np.arange(len(order), dtype=order.dtype))

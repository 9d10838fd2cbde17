"""Interleaved rows (a PLY) to planes (what the codec works on) and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.storage import empty
from gs_codec.workers import run_all

#: Rows moved at once: a tile of 62 columns (1 MB) stays in the second-level cache.
_TILE = 4096
_CHUNK = 1 << 16


def to_planes(rows: NDArray[np.float32], columns: list[int]) -> NDArray[np.float32]:
    """Planes ``(C, N)`` of C columns of ``rows (N, P)``."""
    planes = empty((len(columns), len(rows)), np.float32)

    def gather(start: int, stop: int) -> None:
        for channel, column in enumerate(columns):
            planes[channel, start:stop] = rows[start:stop, column]

    _for_tiles(gather, len(rows))
    return planes


def to_rows(planes: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Rows ``(N, C)`` of C planes ``(N,)``."""
    rows = np.empty((len(planes[0]), len(planes)), np.float32)

    def scatter(start: int, stop: int) -> None:
        for channel, plane in enumerate(planes):
            rows[start:stop, channel] = plane[start:stop]

    _for_tiles(scatter, len(rows))
    return rows


def _for_tiles(move, count: int) -> None:
    def run(start: int) -> None:
        end = min(start + _CHUNK, count)
        for tile in range(start, end, _TILE):
            move(tile, min(tile + _TILE, end))

    run_all(run, range(0, count, _CHUNK))

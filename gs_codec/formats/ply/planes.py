"""Conversion between planes ``(C, N)`` of the codec and rows ``(N, C)`` of a file."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gs_codec.runtime.arrays import empty
from gs_codec.runtime.threads import run_all

#: Rows moved at once: a tile of 62 columns (1 MB) stays in the second-level cache.
TILE = 4096
_CHUNK = 1 << 16


def to_planes(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Planes ``(C, N)`` of rows ``(N, C)``."""
    planes = empty((rows.shape[1], len(rows)), np.float32)

    def gather(start: int, stop: int) -> None:
        for channel, plane in enumerate(planes):
            plane[start:stop] = rows[start:stop, channel]

    for_tiles(gather, len(rows))
    return planes


def to_rows(planes: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Rows ``(N, C)`` of C planes ``(N,)``."""
    rows = np.empty((len(planes[0]), len(planes)), np.float32)

    def scatter(start: int, stop: int) -> None:
        for channel, plane in enumerate(planes):
            rows[start:stop, channel] = plane[start:stop]

    for_tiles(scatter, len(rows))
    return rows


def for_tiles(move: Callable[[int, int], None], count: int) -> None:
    """Call ``move(start, stop)`` for all of `count` rows, tile by tile, from several threads."""

    def run(start: int) -> None:
        end = min(start + _CHUNK, count)
        for tile in range(start, end, TILE):
            move(tile, min(tile + TILE, end))

    run_all(run, range(0, count, _CHUNK))

"""Lists of the splats that each tile draws, front to back."""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.rendering.project import (
    CENTRE_X,
    CENTRE_Y,
    FACTOR_XX,
    FACTOR_XY,
    FACTOR_YY,
    REACH,
    TILE,
    to_tile,
)
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.threads import available_threads, run_all


class TileLists(NamedTuple):
    """Splat-tile pairs: tile t draws ``splats[starts[t] : starts[t + 1]]``, nearest first."""

    splats: NDArray[np.int32]
    starts: NDArray[np.int64]


def list_tiles(
    fields: NDArray[np.float64], tiles: NDArray[np.int32], columns: int, rows: int
) -> TileLists:
    """List splats by tile; ``fields (V, 11)`` and ``tiles (V, 4)`` are sorted by depth."""
    threads = available_threads()
    bounds = np.linspace(0, len(fields), threads + 1).astype(np.int64)
    parts = list(zip(bounds[:-1], bounds[1:], strict=True))
    counts = run_all(partial(_count, fields, tiles, columns, rows), parts)
    # Splats of an earlier part come earlier in each tile.
    places = np.cumsum(np.stack(counts, axis=1).ravel())
    starts = np.concatenate([[0], places]).reshape(-1)
    cursors = starts[:-1].reshape(columns * rows, threads).T
    splats = np.empty(int(starts[-1]), np.int32)
    run_all(
        lambda job: _fill(fields, tiles, columns, *job[0], job[1].copy(), splats),
        zip(parts, cursors, strict=True),
    )
    return TileLists(splats, starts[::threads].copy())


def _count(fields, tiles, columns, rows, part):
    counts = np.zeros(columns * rows, np.int64)
    _count_pairs(fields, tiles, columns, *part, counts)
    return counts


@kernel
def _count_pairs(fields, tiles, columns, start, stop, counts):
    for i in range(start, stop):
        for row in range(tiles[i, 2], tiles[i, 3]):
            first, end = _span(fields[i], tiles[i], row)
            for column in range(first, end):
                counts[row * columns + column] += 1


@kernel
def _fill(fields, tiles, columns, start, stop, cursors, splats):
    for i in range(start, stop):
        for row in range(tiles[i, 2], tiles[i, 3]):
            first, end = _span(fields[i], tiles[i], row)
            for column in range(first, end):
                tile = row * columns + column
                splats[cursors[tile]] = i
                cursors[tile] += 1


@inlined
def _span(field, box, row):
    """First and end tile of a row of tiles that the ellipse q <= REACH meets."""
    fxx = field[FACTOR_XX]
    fyy = field[FACTOR_YY]
    slope = -field[FACTOR_XY] / fxx
    # Heights over the centre where the ellipse ends, and where it reaches farthest right.
    top = math.sqrt(field[REACH]) / fyy
    turn = top * slope / math.sqrt(slope * slope + (fyy / fxx) ** 2)
    low = max(row * TILE - field[CENTRE_Y], -top)
    high = min(row * TILE + TILE - 1 - field[CENTRE_Y], top)
    if low > high:
        return 0, 0
    left = _edge(field, fxx, fyy, slope, min(high, max(low, -turn)), -1.0)
    right = _edge(field, fxx, fyy, slope, min(high, max(low, turn)), 1.0)
    # One pixel of margin, so that rounding has no effect.
    first = max(box[0], to_tile(left - 1.0, box[1]))
    end = min(box[1], to_tile(right + 1.0 + TILE, box[1]))
    return first, end


@inlined
def _edge(field, fxx, fyy, slope, y, side):
    """Column of the ellipse's boundary at height `y` over its centre."""
    left = field[REACH] - (fyy * y) ** 2
    return field[CENTRE_X] + slope * y + side * math.sqrt(max(0.0, left)) / fxx

"""A scene projected for one camera, ready for kernels that process its tiles."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.rendering.project import (
    CENTRE_X,
    CENTRE_Y,
    DEPTH,
    FACTOR_XX,
    FACTOR_XY,
    FACTOR_YY,
    REACH,
    TILE,
    Splats,
    project,
    to_tile,
)
from gs_codec.rendering.tiles_float32 import draw_float32
from gs_codec.rendering.tiles_float64 import AHEAD, draw_tiles, request_fields
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.simd import prefetch
from gs_codec.runtime.threads import available_threads, run_all, using_threads
from gs_codec.scene import Scene

_CHUNK = 1 << 14

#: Number of splats between the one whose box is requested from memory and the one in use.
_FAR_AHEAD = 16


class TileLists(NamedTuple):
    """Splat-tile pairs: tile t has ``splats[starts[t] : starts[t + 1]]``, nearest first."""

    splats: NDArray[np.int32]
    starts: NDArray[np.int64]


class Frame(NamedTuple):
    """Splats, in the scene's order, and the splats of each tile."""

    camera: Camera
    splats: Splats
    lists: TileLists
    columns: int
    rows: int

    @property
    def pairs(self) -> int:
        """Number of splat-tile pairs."""
        return len(self.lists.splats)

    def over_tiles(self, function: Callable, *arguments: Any) -> None:
        """Run a kernel over all tiles, in threads.

        It is called with ``fields (V, 11)``, the splats of the lists ``(pairs,)``, their starts
        ``(tiles + 1,)``, the first and end tile to process, the number of tile columns, and
        `arguments`. It may write only to the pixels or pairs of its own tiles.
        """
        tiles = self.columns * self.rows

        def run(first: int) -> None:
            end = min(first + size, tiles)
            function(self.splats.fields, *self.lists, first, end, self.columns, *arguments)

        with using_threads(None, self.pairs):
            size = -(-tiles // (16 * available_threads()))
            run_all(run, range(0, tiles, size))

    def draw(
        self, background: Sequence[float], dtype: type[np.floating], sums: NDArray[np.float64]
    ) -> tuple[NDArray, NDArray, NDArray]:
        """Render colour ``(H, W, 3)``, alpha and depth ``(H, W)``; see `draw_tiles` for `sums`."""
        shape = (self.camera.height, self.camera.width)
        colour = np.empty((*shape, 3), dtype)
        alpha, depth = np.empty(shape, dtype), np.empty(shape, dtype)
        behind = np.array(background, np.float64)
        self.over_tiles(draw_tiles, behind, colour, alpha, depth, sums)
        return colour, alpha, depth

    def draw_float32(
        self, background: Sequence[float]
    ) -> tuple[NDArray[np.float32], tuple[NDArray, NDArray, NDArray]]:
        """Render colour ``(H, W, 3)`` in float32; also return the inputs of `sum_gradients`."""
        tiles = self.columns * self.rows
        state = (
            np.empty((tiles, TILE * TILE), np.float32),
            np.empty((self.pairs, TILE), np.uint16),
            np.empty(tiles, np.int64),
        )
        colour = np.empty((self.camera.height, self.camera.width, 3), np.float32)
        self.over_tiles(draw_float32, np.array(background, np.float64), colour, *state)
        return colour, state

    def sum_pairs(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sum ``values (pairs, K)`` over the pairs of each splat: ``(V, K)``."""
        totals = np.zeros((len(self.splats.fields), values.shape[1]))
        _sum_pairs(self.lists.splats, values, totals)
        return totals


def make_frame(scene: Scene, camera: Camera, antialiased: bool | None = None) -> Frame:
    """Project a scene, and list its splats by tile and depth; see `render`."""
    if antialiased is None:
        antialiased = scene.antialiased
    columns, rows = -(-camera.width // TILE), -(-camera.height // TILE)
    parts = project_all(scene, camera, antialiased)
    splats = Splats(*(np.concatenate(x) for x in zip(*parts, strict=True)))
    with using_threads(None, len(splats.fields)):
        lists = _list_tiles(splats, columns, rows)
    return Frame(camera, splats, lists, columns, rows)


def project_all(scene: Scene, camera: Camera, antialiased: bool) -> list[Splats]:
    """Visible splats, in parts, in the scene's order; the last part is empty."""
    parts = run_all(
        lambda start: project(scene, camera, antialiased, start, min(start + _CHUNK, scene.count)),
        range(0, scene.count, _CHUNK),
    )
    return [*parts, project(scene, camera, antialiased, 0, 0)]


def _nearest_first(depths: NDArray[np.float64]) -> NDArray[np.int64]:
    """Order of depths; equal ones keep the scene's order."""
    order = np.argsort(depths)
    ordered = depths[order]
    # Rarely needed, and several times slower.
    return np.argsort(depths, kind="stable") if (ordered[1:] == ordered[:-1]).any() else order


def _list_tiles(splats: Splats, columns: int, rows: int) -> TileLists:
    """List splats by tile, nearest first."""
    fields, tiles, _ = splats
    order = _nearest_first(fields[:, DEPTH])
    threads = available_threads()
    bounds = np.linspace(0, len(fields), threads + 1).astype(np.int64)
    parts = list(zip(bounds[:-1], bounds[1:], strict=True))
    counts = np.zeros((threads, columns * rows), np.int64)

    def count(job: tuple[tuple[int, int], NDArray[np.int64]]) -> NDArray[np.int32]:
        (start, stop), numbers = job
        return _count(fields, tiles, order, columns, start, stop, numbers)

    spans = run_all(count, zip(parts, counts, strict=True))
    # In each tile, splats of an earlier part come first.
    starts = np.concatenate([[0], np.cumsum(counts.T)])
    cursors = starts[:-1].reshape(columns * rows, threads).T
    listed = np.empty(int(starts[-1]), np.int32)
    run_all(
        lambda job: _fill(tiles, order, columns, *job[0], job[1], job[2].copy(), listed),
        zip(parts, spans, cursors, strict=True),
    )
    return TileLists(listed, starts[::threads].copy())


@kernel
def _count(fields, tiles, order, columns, start, stop, counts):
    """Count splats ``order[start:stop]`` by tile.

    Returns their spans ``(rows, 2)``: first and end tile of each row of tiles of each splat.
    """
    touched = 0
    for place in range(start, stop):
        prefetch(tiles, 4 * order[min(place + _FAR_AHEAD, stop - 1)])
        i = order[place]
        touched += tiles[i, 3] - tiles[i, 2]
    spans, number = np.empty((touched, 2), np.int32), 0
    for place in range(start, stop):
        ahead = order[min(place + AHEAD, stop - 1)]
        prefetch(tiles, 4 * ahead)
        request_fields(fields, ahead)
        i = order[place]
        box, ellipse = tiles[i], _ellipse(fields[i])
        for row in range(box[2], box[3]):
            first, end = _span(ellipse, box, row)
            spans[number, 0], spans[number, 1] = first, end
            number += 1
            for column in range(first, end):
                counts[row * columns + column] += 1
    return spans


@kernel
def _fill(tiles, order, columns, start, stop, spans, cursors, splats):
    number = 0
    for place in range(start, stop):
        prefetch(tiles, 4 * order[min(place + _FAR_AHEAD, stop - 1)])
        i = order[place]
        for row in range(tiles[i, 2], tiles[i, 3]):
            first, end = spans[number, 0], spans[number, 1]
            number += 1
            for column in range(first, end):
                tile = row * columns + column
                splats[cursors[tile]] = i
                cursors[tile] += 1


@inlined
def _ellipse(field):
    """Centre, factors and reach of a splat, and heights of its top and its rightmost point.

    The ellipse q <= REACH ends at height `top`, and reaches farthest right at height `turn`.
    """
    fxx, fyy, reach = field[FACTOR_XX], field[FACTOR_YY], field[REACH]
    slope = -field[FACTOR_XY] / fxx
    top = math.sqrt(reach) / fyy
    turn = top * slope / math.sqrt(slope * slope + (fyy / fxx) ** 2)
    return field[CENTRE_X], field[CENTRE_Y], fxx, fyy, slope, reach, top, turn


@inlined
def _span(ellipse, box, row):
    """First and end tile of a row of tiles that an ellipse touches."""
    u, v, fxx, fyy, slope, reach, top, turn = ellipse
    low = max(row * TILE - v, -top)
    high = min(row * TILE + TILE - 1 - v, top)
    if low > high:
        return 0, 0
    y = min(high, max(low, -turn))
    left = u + slope * y - math.sqrt(max(0.0, reach - (fyy * y) ** 2)) / fxx
    y = min(high, max(low, turn))
    right = u + slope * y + math.sqrt(max(0.0, reach - (fyy * y) ** 2)) / fxx
    # One pixel of margin, so that rounding has no effect.
    first = max(box[0], to_tile(left - 1.0, box[1]))
    end = min(box[1], to_tile(right + 1.0 + TILE, box[1]))
    return first, end


@kernel
def _sum_pairs(splats, values, totals):
    columns = values.shape[1]
    for pair in range(len(splats)):
        ahead = splats[min(pair + AHEAD, len(splats) - 1)] * columns
        prefetch(totals, ahead)
        prefetch(totals, ahead + columns - 1)
        total = totals[splats[pair]]
        for k in range(columns):
            total[k] += values[pair, k]


def draw_few(
    scene: Scene, camera: Camera, start: int, stop: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Render Gaussians `start` to `stop` on black, with few calls, for views of few pixels.

    Returns what `make_frame` and `draw_float32` would: colour ``(H, W, 3)``, and the transmittance
    behind all splats ``(tiles, 256)``.
    """
    splats = project(scene, camera, scene.antialiased, start, stop)
    fields, boxes, _ = splats
    order = _nearest_first(fields[:, DEPTH])
    colour = np.empty((camera.height, camera.width, 3), np.float32)
    columns, rows = -(-camera.width // TILE), -(-camera.height // TILE)
    left = np.empty((columns * rows, TILE * TILE), np.float32)
    _draw_few(fields, boxes, order, columns, np.zeros(3), colour, left)
    return colour, left


@kernel
def _draw_few(fields, boxes, order, columns, background, colour, left):
    tiles, first, end = len(left), np.int64(0), len(fields)
    starts = np.zeros(tiles + 1, np.int64)
    spans = _count(fields, boxes, order, columns, first, end, starts[1:])
    for tile in range(tiles):
        starts[tile + 1] += starts[tile]
    splats = np.empty(starts[tiles], np.int32)
    _fill(boxes, order, columns, first, end, spans, starts[:-1].copy(), splats)
    drawn, reached = np.empty((len(splats), TILE), np.uint16), np.empty(tiles, np.int64)
    draw_float32(
        fields, splats, starts, first, tiles, columns, background, colour, left, drawn, reached
    )

"""A traced view: the weight alpha T of every Gaussian in each of its pixels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.rendering.frame import make_frame
from gs_codec.rendering.project import TILE
from gs_codec.rendering.tiles_float32 import (
    LEAST_LEFT,
    PIXELS,
    cover,
    place_in_tile,
    splat_of,
)
from gs_codec.rendering.tiles_float64 import AHEAD, request_fields, tile_bounds
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.simd import (
    between,
    cut_off,
    first_of,
    largest,
    last_of,
    load,
    prefetch,
    repeated,
    store,
    total,
    where,
)
from gs_codec.scene import Scene

#: Column of (alpha T)^2 in the sums over pixels, after R, G, B.
SQUARED = 3

#: A weight of 1 in units of the finest rows; a unit is 1/257 of a step of an 8-bit image. A row has
#: weights of 8 bits, in 1, 2, 4, ... units; images of them have 74 dB or more.
_UNITS = 65535.0

#: Largest weight of 8 bits.
_LEVELS = np.float32(255)

#: The same values, typed for the kernels.
_UNIT = np.float32(1 / _UNITS)
_MOST = np.float32(_UNITS)
_HALF = np.float32(0.5)
_ZERO = np.float32(0)
_ONE = np.float32(1)

#: A row is faint if all its weights are below this, in units.
_FAINT = np.int32(_UNITS / 512)

#: First bit of a row's scale: 0 is faint; from 1 up, the weights are in 1, 2, 4, ... units.
_SCALE = 12

#: Initial length of the row buffer; a splat in a tile needs up to 16.
_FIRST_ROWS = 1 << 14

#: Initial length of the weight buffer; a splat in a tile needs up to 256.
_FIRST_WEIGHTS = 1 << 16


class TracedView(NamedTuple):
    """Weights of a view, by splat-tile pair and row; the pairs of a tile are nearest first.

    Attributes
    ----------
    camera : Camera
    seen : ndarray, shape (V,), int64
        Gaussians that may be visible in the tiles, ascending.
    tiles : ndarray, shape (tiles,), int64
        Numbers of the traced tiles, row by row.
    pairs : ndarray, shape (pairs,), int32
        Index in `seen` of each pair's Gaussian.
    starts : ndarray, shape (tiles + 1,), int64
        Start of the pairs of each tile.
    ends : ndarray, shape (pairs,), int32
        End of the rows of each pair.
    rows : ndarray, shape (rows,), uint16
        Bit fields of 4: row in the tile, first column, last column, scale.
    weights : ndarray, shape (16 + weights + 16,), uint8
        From the first to the last column of each row, in units of the row's scale.
    left : ndarray, shape (tiles, 256), float32
        Transmittance of each pixel behind all splats.
    """

    camera: Camera
    seen: NDArray[np.int64]
    tiles: NDArray[np.int64]
    pairs: NDArray[np.int32]
    starts: NDArray[np.int64]
    ends: NDArray[np.int32]
    rows: NDArray[np.uint16]
    weights: NDArray[np.uint8]
    left: NDArray[np.float32]

    @property
    def nbytes(self) -> int:
        """Size in memory, in bytes."""
        return sum(array.nbytes for array in self[1:])

    @property
    def pixels(self) -> int:
        """Number of traced pixels."""
        rows, columns = np.divmod(self.tiles, -(-self.camera.width // TILE))
        wide = np.minimum(self.camera.width - TILE * columns, TILE)
        high = np.minimum(self.camera.height - TILE * rows, TILE)
        return int(np.sum(wide * high))

    def residual(
        self,
        colours: NDArray[np.float32],
        target: NDArray,
        background: NDArray[np.float64],
        *,
        summed: bool,
        faint: bool,
    ) -> tuple[NDArray[np.float64], float]:
        """Sums ``(V, 4)`` of alpha T times the residual and of (alpha T)^2, and the squared error.

        Parameters
        ----------
        colours : ndarray, shape (V, 3), float32
            Colours of the Gaussians in ``seen``.
        target : ndarray, shape (H, W, 3)
            The residual is this minus the image, in the traced pixels.
        background : ndarray, shape (3,)
        summed : bool
            Whether to compute the sums; otherwise they are empty, in half the time.
        faint : bool
            Whether to include faint rows, a third of all rows with less than 1 % of the weight.
        """
        sums = np.zeros((len(self.seen) if summed else 0, SQUARED + 1))
        columns = -(-self.camera.width // TILE)
        return sums, _residual(*self[2:], columns, colours, target, background, faint, sums)


#: Buffers for rows and weights, reused because allocating memory takes longer than tracing.
TraceBuffers = tuple[NDArray[np.uint16], NDArray[np.uint8]]


def trace_view(
    scene: Scene,
    camera: Camera,
    every: int = 1,
    first: int = 0,
    buffers: TraceBuffers | None = None,
) -> tuple[TracedView, TraceBuffers]:
    """Trace every n-th tile of a view (`every`); also return the buffers, for reuse.

    The traced tiles are on diagonals; `first` is the number of the first diagonal.
    """
    frame = make_frame(scene, camera)
    splats, starts = frame.lists
    rows, columns = np.divmod(np.arange(len(starts) - 1), frame.columns)
    chosen = (rows + columns) % every == first % every
    counts = np.diff(starts)
    splats, starts = splats[np.repeat(chosen, counts)], np.append(0, np.cumsum(counts[chosen]))
    used = np.zeros(len(frame.splats.fields), bool)
    used[splats] = True
    rank = np.cumsum(used, dtype=np.int32) - 1
    tiles = np.flatnonzero(chosen)
    ends, left = np.zeros(len(splats), np.int32), np.zeros((len(tiles), PIXELS), np.float32)
    if buffers is None:
        buffers = np.empty(_FIRST_ROWS, np.uint16), np.empty(_FIRST_WEIGHTS, np.uint8)
    size = (frame.columns, camera.width, camera.height)
    *buffers, end = _trace(frame.splats.fields, splats, starts, tiles, *size, left, ends, *buffers)
    own = buffers[0][: ends.max(initial=0)].copy(), buffers[1][: end + TILE].copy()
    seen, pairs = frame.splats.gaussians[used], rank[splats]
    traced = TracedView(camera, seen, tiles, pairs, starts, ends, *own, left)
    return traced, (buffers[0], buffers[1])


@kernel
def _trace(fields, splats, starts, tiles, columns, width, height, left_of, ends, rows, weights):
    """Fill the outputs; return `rows` and `weights`, enlarged if needed, and the end of weights."""
    light, levels_of = np.empty(PIXELS, np.float32), np.empty(_FIRST_WEIGHTS, np.uint8)
    # What rounding has taken from the weights of a pixel so far.
    owed = np.empty(PIXELS, np.float32)
    used, end_row = np.int64(TILE), np.int64(0)
    for tile in range(len(tiles)):
        x0, x1, y0, y1 = tile_bounds(tiles[tile], columns, width, height)
        light[:] = _ZERO
        owed[:] = _ZERO
        for y in range(y1 - y0):
            light[y * TILE : y * TILE + x1 - x0] = _ONE
        pairs, first_row = (starts[tile], starts[tile + 1]), end_row
        most = TILE * (pairs[1] - pairs[0])
        rows = _enlarged(rows, first_row + most)
        levels_of = _enlarged(levels_of, TILE * (most + 1))
        end_row = _trace_tile(
            fields, splats, *pairs, x0, y0, height, light, owed, ends, rows, first_row, levels_of
        )
        weights = _enlarged(weights, used + TILE * (end_row - first_row + 1))
        used = _pack_weights(rows, first_row, end_row, levels_of, weights, used)
        for pixel in range(PIXELS):
            left_of[tile, pixel] = abs(light[pixel])
    return rows, weights, used


@kernel
def _enlarged(array, least):
    """An array of at least some length, with its values."""
    while len(array) < least:
        array = np.concatenate((array, np.empty_like(array)))
    return array


@kernel
def _trace_tile(
    fields, splats, start, end, x0, y0, height, light, owed, ends, rows, end_row, levels_of
):
    """Fill the rows of a tile, and their weights in all columns; return the end of the rows."""
    first_row, still_open = end_row, 0
    for pair in range(start, end):
        request_fields(fields, splats[min(pair + AHEAD, end - 1)])
        field = fields[splats[pair]]
        splat = splat_of(field)
        top, bottom, u, v = place_in_tile(field, x0, y0, height)
        for y in range(top, bottom):
            weight, _, left = cover(splat, u, v, y, load(light, y * TILE), LEAST_LEFT)
            store(light, y * TILE, left)
            units = cut_off(weight * _MOST + _HALF)
            first, last = first_of(units > _ZERO), last_of(units > _ZERO)
            if first <= last:
                scale = _scale_of(np.int32(largest(units)))
                rows[end_row] = y | first << 4 | last << 8 | scale << _SCALE
                levels, left = _round_row(units, load(owed, y * TILE), scale)
                store(owed, y * TILE, left)
                store(levels_of, (end_row - first_row) * TILE, levels)
                end_row += 1
        ends[pair] = end_row
        while still_open < PIXELS and light[still_open] <= _ZERO:
            still_open += 1
        if still_open == PIXELS:
            for hidden in range(pair + 1, end):
                ends[hidden] = end_row
            break
    return end_row


@inlined
def _scale_of(most):
    """Scale of a row by its largest weight, in units."""
    if most < _FAINT:
        return 0
    scale = 1
    while (most + ((1 << scale) >> 2)) >> (scale - 1) > _LEVELS:
        scale += 1
    return scale


@inlined
def _round_row(units, owed, scale):
    """Round a row's weights, from units to units of its scale; also return what is owed then.

    A pixel's error goes to its next weights, at most half a step to each, so that their sum stays.
    """
    step = np.int64(1) << max(scale - 1, 0)
    half = np.float32(step >> 1)
    wanted = units + where(owed < half, where(owed > -half, owed, repeated(-half)), repeated(half))
    levels = cut_off(where(wanted > -half, wanted + half, repeated(_ZERO)) * np.float32(1 / step))
    levels = where(levels < _LEVELS, levels, repeated(_LEVELS))
    levels = where(units > _ZERO, levels, repeated(_ZERO))
    return levels, owed + units - levels * np.float32(step)


@kernel
def _pack_weights(rows, first_row, end_row, levels_of, weights, used):
    """Append the weights of rows from their first to their last column; return their end."""
    for row in range(first_row, end_row):
        first, last = np.int64(rows[row]) >> 4 & 15, np.int64(rows[row]) >> 8 & 15
        store(weights, used, load(levels_of, (row - first_row) * TILE + first))
        used += last - first + 1
    return used


@kernel
def _residual(
    tiles, pairs, starts, ends, rows, weights, left, columns, colours, target, background, faint,
    sums,
):  # fmt: skip
    """Fill ``sums (V, 4)``, unless it is empty; return the squared error."""
    height, width = target.shape[:2]
    # Red, green and blue, one after another.
    residual = np.zeros(3 * PIXELS, np.float32)
    error, row, start, least = 0.0, 0, TILE, 0 if faint else 1 << _SCALE
    for tile in range(len(tiles)):
        x0, x1, y0, y1 = tile_bounds(tiles[tile], columns, width, height)
        residual[:] = _ZERO
        for y in range(y0, y1):
            for x in range(x0, x1):
                pixel = (y - y0) * TILE + x - x0
                for channel in range(3):
                    behind = left[tile, pixel] * background[channel]
                    residual[pixel + channel * PIXELS] = target[y, x, channel] - behind
        own, place = (starts[tile], starts[tile + 1]), (row, start)
        row, start = _subtract(*own, pairs, ends, rows, weights, least, colours, *place, residual)
        for value in residual:
            error += np.float64(value) * value
        if len(sums) > 0:
            _add_up(*own, pairs, ends, rows, weights, least, residual, *place, sums)
    return error


@kernel
def _subtract(first, end, pairs, ends, rows, weights, least, colours, row, start, residual):
    """Subtract pairs `first` to `end` from the residual of their tile.

    Returns the start of the rows and weights of the next tile.
    """
    for pair in range(first, end):
        prefetch(colours, 3 * pairs[min(pair + AHEAD, end - 1)])
        colour = colours[pairs[pair]]
        red, green, blue = _UNIT * colour[0], _UNIT * colour[1], _UNIT * colour[2]
        while row < ends[pair]:
            code = np.int64(rows[row])
            weight, line, start = _weights_of(code, weights, start)
            row += 1
            if code < least:
                continue
            store(residual, line, load(residual, line) - weight * red)
            store(residual, line + PIXELS, load(residual, line + PIXELS) - weight * green)
            store(residual, line + 2 * PIXELS, load(residual, line + 2 * PIXELS) - weight * blue)
    return row, start


@kernel
def _add_up(first, end, pairs, ends, rows, weights, least, residual, row, start, sums):
    """Add pairs `first` to `end` of a tile to ``sums (V, 4)``."""
    for pair in range(first, end):
        prefetch(sums, 4 * pairs[min(pair + AHEAD, end - 1)])
        red = green = blue = square = repeated(_ZERO)
        while row < ends[pair]:
            code = np.int64(rows[row])
            weight, line, start = _weights_of(code, weights, start)
            row += 1
            if code < least:
                continue
            red += weight * load(residual, line)
            green += weight * load(residual, line + PIXELS)
            blue += weight * load(residual, line + 2 * PIXELS)
            square += weight * weight
        sum_of = sums[pairs[pair]]
        sum_of[0] += np.float64(total(red)) / _UNITS
        sum_of[1] += np.float64(total(green)) / _UNITS
        sum_of[2] += np.float64(total(blue)) / _UNITS
        sum_of[SQUARED] += np.float64(total(square)) / _UNITS**2


@inlined
def _weights_of(code, weights, start):
    """Weights of a row, 0 outside its columns; its start in a plane, and that of the next row."""
    first, last = code >> 4 & 15, code >> 8 & 15
    scale = np.float32(1 << max((code >> _SCALE) - 1, 0))
    units = where(between(first, last), scale * load(weights, start - first), repeated(_ZERO))
    return units, (code & 15) * TILE, start + last - first + 1

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
    alpha_at,
    cover,
    place_in_tile,
    row_of,
    splat_of,
    total_of,
)
from gs_codec.rendering.tiles_float64 import tile_bounds
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.scene import Scene

#: Column of (alpha T)^2 in the sums over pixels, after R, G, B.
SQUARED = 3

#: A weight of 1 in units of the finest rows; a unit is 1/257 of a step of an 8-bit image. A row has
#: weights of 8 bits, in 1, 2, 4, ... units; images of them have 74 dB or more.
_UNITS = 65535.0

#: Largest weight of 8 bits.
_LEVELS = np.int32(255)

#: The same values, typed for the kernels.
_UNIT = np.float32(1 / _UNITS)
_MOST = np.float32(_UNITS)
_HALF = np.float32(0.5)
_ZERO = np.float32(0)
_ONE = np.float32(1)
_WIDTH = np.int32(TILE)

#: A row is faint if all its weights are below this, in units.
_FAINT = np.int32(_UNITS / 512)

#: First bit of a row's scale: 0 is faint; from 1 up, the weights are in 1, 2, 4, ... units.
_SCALE = 12

#: Offsets of the planes of a tile, after red. Unsigned, because numba tests whether signed indices
#: are negative.
_GREEN = np.uint64(PIXELS)
_BLUE = np.uint64(2 * PIXELS)

#: Offsets of the column sums, after red.
_BY_GREEN = np.uint64(TILE)
_BY_BLUE = np.uint64(2 * TILE)
_BY_SQUARE = np.uint64(3 * TILE)

#: Initial length of the row buffer; one splat in a tile needs 16.
_FIRST_ROWS = 1 << 14

#: Initial length of the weight buffer; one splat in a tile needs 272.
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
    gaussians = frame.splats.gaussians
    used = np.zeros(len(gaussians), bool)
    used[splats] = True
    order = np.flatnonzero(used)
    order = order[np.argsort(gaussians[order])]
    rank = np.empty(len(gaussians), np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    tiles = np.flatnonzero(chosen)
    ends, left = np.zeros(len(splats), np.int32), np.zeros((len(tiles), PIXELS), np.float32)
    if buffers is None:
        buffers = np.empty(_FIRST_ROWS, np.uint16), np.empty(_FIRST_WEIGHTS, np.uint8)
    size = (frame.columns, camera.width, camera.height)
    *buffers, end = _trace(frame.splats.fields, splats, starts, tiles, *size, left, ends, *buffers)
    own = buffers[0][: ends.max(initial=0)].copy(), buffers[1][: end + TILE].copy()
    traced = TracedView(camera, gaussians[order], tiles, rank[splats], starts, ends, *own, left)
    return traced, (buffers[0], buffers[1])


@kernel
def _trace(fields, splats, starts, tiles, columns, width, height, left_of, ends, rows, weights):
    """Fill the outputs; return `rows` and `weights`, enlarged if needed, and the end of weights."""
    light, row_weights = np.empty(PIXELS, np.float32), np.zeros(2 * TILE, np.int32)
    # What rounding has taken from the weights of a pixel so far.
    owed = np.empty(PIXELS, np.int32)
    used, used_rows = TILE, 0
    for tile in range(len(tiles)):
        x0, x1, y0, y1 = tile_bounds(tiles[tile], columns, width, height)
        light[:] = _ZERO
        owed[:] = 0
        for y in range(y1 - y0):
            light[y * TILE : y * TILE + x1 - x0] = _ONE
        still_open = 0
        for pair in range(starts[tile], starts[tile + 1]):
            if used_rows + TILE > len(rows):
                rows = np.concatenate((rows, np.empty_like(rows)))
            if used + PIXELS + TILE > len(weights):
                weights = np.concatenate((weights, np.empty_like(weights)))
            while still_open < PIXELS and light[still_open] <= _ZERO:
                still_open += 1
            if still_open < PIXELS:
                field = fields[splats[pair]]
                slope, reach, opacity, _, _, _ = splat_of(field)
                top, bottom, u, v = place_in_tile(field, x0, y0, height)
                for y in range(top, bottom):
                    offset, across = row_of(field, u, v, y)
                    row = light[y * TILE : y * TILE + TILE]
                    first_column, last_column, largest = _WIDTH, np.int32(-1), np.int32(0)
                    for x in range(TILE):
                        alpha, drawn = alpha_at(x, slope, offset, across, reach, opacity)
                        weight, _ = cover(row, x, alpha, drawn, LEAST_LEFT)
                        units, column = np.int32(weight * _MOST + _HALF), np.int32(x)
                        row_weights[x] = units
                        first_column = min(first_column, column if units > 0 else _WIDTH)
                        last_column = max(last_column, column if units > 0 else np.int32(-1))
                        largest = max(largest, units)
                    if last_column >= 0:
                        scale = _scale_of(largest)
                        rows[used_rows] = y | first_column << 4 | last_column << 8 | scale << _SCALE
                        used_rows += 1
                        _round_row(row_weights, owed[y * TILE : y * TILE + TILE], scale)
                        at, begin = np.uint64(used), np.uint64(first_column)
                        for x in range(TILE):
                            weights[at + np.uint64(x)] = row_weights[begin + np.uint64(x)]
                        used += last_column - first_column + 1
            ends[pair] = used_rows
        for pixel in range(PIXELS):
            left_of[tile, pixel] = abs(light[pixel])
    return rows, weights, used


@inlined
def _scale_of(largest):
    """Scale of a row by its largest weight, in units."""
    if largest < _FAINT:
        return 0
    scale = 1
    while (largest + ((1 << scale) >> 2)) >> (scale - 1) > _LEVELS:
        scale += 1
    return scale


@inlined
def _round_row(weights, owed, scale):
    """Round a row's weights, from units to units of its scale.

    A pixel's error goes to its next weights, at most half a step to each, so that their sum stays.
    """
    shift = max(scale - 1, 0)
    half = np.int32(1 << shift >> 1)
    for x in range(TILE):
        weight = weights[x]
        wanted = weight + min(max(owed[x], -half), half)
        level = min(max(wanted + half, np.int32(0)) >> shift, _LEVELS)
        level = level if weight > 0 else np.int32(0)
        owed[x] += weight - (level << shift)
        weights[x] = level


@kernel
def _residual(
    tiles, pairs, starts, ends, rows, weights, left, columns, colours, target, background, faint,
    sums,
):  # fmt: skip
    """Fill ``sums (V, 4)``, unless it is empty; return the squared error."""
    height, width = target.shape[:2]
    # Red, green and blue, one after another.
    residual = np.zeros(3 * PIXELS, np.float32)
    by_column = np.zeros((SQUARED + 1) * TILE, np.float32)
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
        own, place = slice(starts[tile], starts[tile + 1]), (row, start)
        row, start = _subtract(
            pairs[own], ends[own], rows, weights, least, colours, *place, residual
        )
        for value in residual:
            error += np.float64(value) * value
        if len(sums) > 0:
            _add_up(pairs[own], ends[own], rows, weights, least, residual, *place, by_column, sums)
    return error


@kernel
def _subtract(pairs, ends, rows, weights, least, colours, row, start, residual):
    """Subtract the pairs of a tile from its residual; return the start of the next tile's pairs."""
    for pair in range(len(pairs)):
        colour = colours[pairs[pair]]
        red, green, blue = _UNIT * colour[0], _UNIT * colour[1], _UNIT * colour[2]
        while row < ends[pair]:
            code = rows[row]
            first, last, line, at, scale = _unpack(code, start)
            start += last - first + 1
            row += 1
            if code < least:
                continue
            for x in range(TILE):
                k, column = np.uint64(x), np.int32(x)
                inside = (column >= first) & (column <= last)
                weight = scale * np.float32(weights[at + k]) if inside else _ZERO
                residual[line + k] -= weight * red
                residual[line + k + _GREEN] -= weight * green
                residual[line + k + _BLUE] -= weight * blue
    return row, start


@kernel
def _add_up(pairs, ends, rows, weights, least, residual, row, start, by_column, sums):
    """Add the pairs of a tile to ``sums (V, 4)``."""
    for pair in range(len(pairs)):
        by_column[:] = _ZERO
        while row < ends[pair]:
            code = rows[row]
            first, last, line, at, scale = _unpack(code, start)
            start += last - first + 1
            row += 1
            if code < least:
                continue
            for x in range(TILE):
                k, column = np.uint64(x), np.int32(x)
                inside = (column >= first) & (column <= last)
                weight = scale * np.float32(weights[at + k]) if inside else _ZERO
                by_column[k] += weight * residual[line + k]
                by_column[k + _BY_GREEN] += weight * residual[line + k + _GREEN]
                by_column[k + _BY_BLUE] += weight * residual[line + k + _BLUE]
                by_column[k + _BY_SQUARE] += weight * weight
        total = sums[pairs[pair]]
        for channel in range(3):
            total[channel] += total_of(by_column, channel) / _UNITS
        total[SQUARED] += total_of(by_column, SQUARED) / _UNITS**2


@kernel
def _unpack(code, start):
    """Unpack a row that starts at `start`.

    Returns its first and last column, its start in a plane, the position of its column 0, and the
    units of its weights.
    """
    first, last = np.int32(code >> 4 & 15), np.int32(code >> 8 & 15)
    scale = np.float32(1 << max(np.int32(code >> _SCALE) - 1, 0))
    return first, last, np.uint64((code & 15) * TILE), np.uint64(start - first), scale

"""Trace splats through the pixels of a tile in float64, front to back, and composite them.

Everything that is drawn, summed or differentiated over pixels goes through `trace_splat`.
"""

from __future__ import annotations

import math

import numpy as np

from gs_codec.rendering.project import (
    BLUE,
    CENTRE_X,
    CENTRE_Y,
    DEPTH,
    FACTOR_XX,
    FACTOR_XY,
    FACTOR_YY,
    GREEN,
    MIN_ALPHA,
    OPACITY,
    REACH,
    RED,
    TILE,
)
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.simd import prefetch

#: Maximum alpha of one splat in one pixel.
MAX_ALPHA = 0.99

#: A pixel is done before its transmittance falls below this.
MIN_TRANSMITTANCE = 1e-4

#: exp(-x) at multiples of 1 / _STEPS up to ln 255, the largest exponent of a visible splat.
_STEPS = 32.0
_EXPONENTIALS = np.exp(-np.arange(6 * _STEPS) / _STEPS)


@inlined
def tile_bounds(tile, columns, width, height):
    """First and end pixel column, first and end row of a tile."""
    x0 = tile % columns * TILE
    y0 = tile // columns * TILE
    return x0, min(x0 + TILE, width), y0, min(y0 + TILE, height)


@inlined
def tile_buffers():
    """Buffers for `trace_splat`: left, pixels, alphas and before, each ``(256,)``."""
    size = TILE * TILE
    return np.empty(size), np.empty(size, np.int64), np.empty(size), np.empty(size)


@inlined
def trace_splat(field, x0, x1, y0, y1, left, pixels, alphas, before):
    """List the pixels of a splat, and reduce their transmittance.

    ``left (256,)`` is the transmittance of the tile's pixels, negative where a pixel is done.
    ``pixels``, ``alphas`` and ``before`` (256,) receive the pixel in the tile, alpha, and the
    transmittance before the splat.

    Returns the number of listed pixels, and the number of pixels that it completes.
    """
    u, v = field[CENTRE_X], field[CENTRE_Y]
    fxx, fxy, fyy = field[FACTOR_XX], field[FACTOR_XY], field[FACTOR_YY]
    opacity = field[OPACITY]
    reach = field[REACH] + 1e-9
    count = done = 0
    high = math.sqrt(reach) / fyy
    for y in range(max(y0, whole(v - high)), min(y1, whole(v + high) + 1)):
        dy = y - v
        across = (fyy * dy) ** 2
        half = math.sqrt(max(0.0, reach - across)) / fxx
        middle = u - fxy / fxx * dy
        offset = fxy * dy - fxx * u
        row = (y - y0) * TILE - x0
        for x in range(max(x0, whole(middle - half)), min(x1, whole(middle + half) + 1)):
            pixel = row + x
            transmittance = left[pixel]
            if transmittance <= 0.0:
                continue
            q = (fxx * x + offset) ** 2 + across
            if not q <= reach:
                continue
            alpha = min(MAX_ALPHA, opacity * _exp_minus(0.5 * q))
            if alpha < MIN_ALPHA:
                continue
            after = transmittance * (1.0 - alpha)
            if after < MIN_TRANSMITTANCE:
                left[pixel] = -transmittance
                done += 1
                continue
            left[pixel] = after
            pixels[count] = pixel
            alphas[count] = alpha
            before[count] = transmittance
            count += 1
    return count, done


@inlined
def whole(value):
    """Floor as an integer; values far outside the image are clamped."""
    return np.int64(math.floor(min(1e6, max(-1e6, value))))


@inlined
def _exp_minus(x):
    """exp(-x) for 0 <= x < 6, to 1e-11: the same on every machine, and faster than libm."""
    step = np.int64(x * _STEPS)
    r = step / _STEPS - x
    series = 1.0 + r * (1.0 + r * (0.5 + r * (1 / 6 + r * (1 / 24 + r * (1 / 120)))))
    return _EXPONENTIALS[step] * series


#: Number of pairs between the one whose values are requested from memory and the one processed.
AHEAD = 8

#: Values of a splat.
_FIELDS = DEPTH + 1


@inlined
def request_fields(fields, splat):
    """Let the values of a splat come nearer while earlier pairs are processed."""
    prefetch(fields, splat * _FIELDS)
    prefetch(fields, splat * _FIELDS + DEPTH)


#: Columns of the sums of each splat-tile pair, over its pixels.
WEIGHT, SQUARED_WEIGHT, TRANSMITTANCE, PIXELS = range(4)


@kernel
def draw_tiles(fields, splats, starts, first, end, columns, background, colour, alpha, depth, sums):
    """Render tiles `first` to `end` into images ``(H, W, 3)``, ``(H, W)``, ``(H, W)`` float32.

    Also fills ``sums (pairs, 4)``, unless it is empty.
    """
    height, width = alpha.shape
    light = np.empty((TILE * TILE, 4))
    left, pixels, alphas, before = tile_buffers()
    for tile in range(first, end):
        x0, x1, y0, y1 = tile_bounds(tile, columns, width, height)
        light[:] = 0.0
        left[:] = 1.0
        still_open = (x1 - x0) * (y1 - y0)
        for pair in range(starts[tile], starts[tile + 1]):
            request_fields(fields, splats[min(pair + AHEAD, starts[tile + 1] - 1)])
            field = fields[splats[pair]]
            count, done = trace_splat(field, x0, x1, y0, y1, left, pixels, alphas, before)
            red, green, blue, far = field[RED], field[GREEN], field[BLUE], field[DEPTH]
            for i in range(count):
                weight = alphas[i] * before[i]
                pixel = light[pixels[i]]
                pixel[0] += weight * red
                pixel[1] += weight * green
                pixel[2] += weight * blue
                pixel[3] += weight * far
                if len(sums):
                    sums[pair, WEIGHT] += weight
                    sums[pair, SQUARED_WEIGHT] += weight * weight
                    sums[pair, TRANSMITTANCE] += before[i]
                    sums[pair, PIXELS] += 1.0
            still_open -= done
            if still_open == 0:
                break
        for y in range(y0, y1):
            for x in range(x0, x1):
                pixel = light[(y - y0) * TILE + x - x0]
                remaining = abs(left[(y - y0) * TILE + x - x0])
                covered = 1.0 - remaining
                for channel in range(3):
                    colour[y, x, channel] = pixel[channel] + remaining * background[channel]
                alpha[y, x] = covered
                depth[y, x] = pixel[3] / covered if covered > 0.0 else 0.0

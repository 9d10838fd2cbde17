"""Compositing the splats of a tile, front to back, as the 3DGS rasteriser does it."""

from __future__ import annotations

import math

import numpy as np

from gs_codec.kernels import inlined, kernel
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

#: Alpha of one splat in one pixel is at most this.
MAX_ALPHA = 0.99

#: A pixel is done before its transmittance falls below this.
MIN_TRANSMITTANCE = 1e-4

#: Columns of the sums kept for each splat-tile pair, over the pixels it was added to.
WEIGHT, SQUARED_WEIGHT, TRANSMITTANCE, PIXELS = range(4)

#: exp(-x) at multiples of 1 / _STEPS up to the largest exponent a visible splat has, ln 255.
_STEPS = 32.0
_EXPONENTIALS = np.exp(-np.arange(6 * _STEPS) / _STEPS)


@kernel
def draw_tiles(fields, splats, starts, first, end, columns, background, colour, alpha, depth, sums):
    """Draw tiles `first` to `end` into images ``(H, W, 3)``, ``(H, W)``, ``(H, W)`` float32.

    `sums` is ``(pairs, 4)`` to be filled, or empty: then none are kept.
    """
    height, width = alpha.shape
    light = np.empty((TILE * TILE, 4))
    left = np.empty(TILE * TILE)
    for tile in range(first, end):
        y0 = tile // columns * TILE
        x0 = tile % columns * TILE
        y1 = min(y0 + TILE, height)
        x1 = min(x0 + TILE, width)
        light[:] = 0.0
        left[:] = 1.0
        open_pixels = (y1 - y0) * (x1 - x0)
        for pair in range(starts[tile], starts[tile + 1]):
            open_pixels -= _draw_splat(
                fields[splats[pair]], x0, y0, x1, y1, light, left, pair, sums
            )
            if open_pixels == 0:
                break
        for y in range(y0, y1):
            for x in range(x0, x1):
                pixel = (y - y0) * TILE + x - x0
                remaining = abs(left[pixel])
                covered = 1.0 - remaining
                for channel in range(3):
                    colour[y, x, channel] = light[pixel, channel] + remaining * background[channel]
                alpha[y, x] = covered
                depth[y, x] = light[pixel, 3] / covered if covered > 0.0 else 0.0


@inlined
def _draw_splat(field, x0, y0, x1, y1, light, left, pair, sums):
    """Add a splat to a tile; how many pixels were done by it. Those have a negative `left`."""
    u, v = field[CENTRE_X], field[CENTRE_Y]
    fxx, fxy, fyy = field[FACTOR_XX], field[FACTOR_XY], field[FACTOR_YY]
    red, green, blue, far = field[RED], field[GREEN], field[BLUE], field[DEPTH]
    opacity = field[OPACITY]
    reach = field[REACH] + 1e-9
    done = 0
    weight = squared = seen = hits = 0.0
    high = math.sqrt(reach) / fyy
    for y in range(max(y0, _whole(v - high)), min(y1, _whole(v + high) + 1)):
        dy = y - v
        across = (fyy * dy) ** 2
        half = math.sqrt(max(0.0, reach - across)) / fxx
        middle = u - fxy / fxx * dy
        offset = fxy * dy - fxx * u
        row = (y - y0) * TILE - x0
        for x in range(max(x0, _whole(middle - half)), min(x1, _whole(middle + half) + 1)):
            pixel = row + x
            transmittance = left[pixel]
            if transmittance <= 0.0:
                continue
            q = (fxx * x + offset) ** 2 + across
            if not q <= reach:
                continue
            a = min(MAX_ALPHA, opacity * _exp_minus(0.5 * q))
            if a < MIN_ALPHA:
                continue
            after = transmittance * (1.0 - a)
            if after < MIN_TRANSMITTANCE:
                left[pixel] = -transmittance
                done += 1
                continue
            left[pixel] = after
            w = a * transmittance
            light[pixel, 0] += w * red
            light[pixel, 1] += w * green
            light[pixel, 2] += w * blue
            light[pixel, 3] += w * far
            weight += w
            squared += w * w
            seen += transmittance
            hits += 1.0
    if len(sums):
        sums[pair, WEIGHT] = weight
        sums[pair, SQUARED_WEIGHT] = squared
        sums[pair, TRANSMITTANCE] = seen
        sums[pair, PIXELS] = hits
    return done


@inlined
def _whole(value):
    """Floor as an integer; far outside the image any will do."""
    return np.int64(math.floor(min(1e6, max(-1e6, value))))


@inlined
def _exp_minus(x):
    """exp(-x) for 0 <= x < 6, to 1e-11: the same on every machine, and faster than libm."""
    step = np.int64(x * _STEPS)
    r = step / _STEPS - x
    series = 1.0 + r * (1.0 + r * (0.5 + r * (1 / 6 + r * (1 / 24 + r * (1 / 120)))))
    return _EXPONENTIALS[step] * series

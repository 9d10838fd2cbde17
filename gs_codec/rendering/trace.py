"""The pixels of a tile that a splat is added to, front to back, as the 3DGS rasteriser has it.

Everything that is drawn, summed or differentiated over pixels goes through `trace_splat`.
"""

from __future__ import annotations

import math

import numpy as np

from gs_codec.kernels import inlined
from gs_codec.rendering.project import (
    CENTRE_X,
    CENTRE_Y,
    FACTOR_XX,
    FACTOR_XY,
    FACTOR_YY,
    MIN_ALPHA,
    OPACITY,
    REACH,
    TILE,
)

#: Alpha of one splat in one pixel is at most this.
MAX_ALPHA = 0.99

#: A pixel is done before its transmittance falls below this.
MIN_TRANSMITTANCE = 1e-4

#: exp(-x) at multiples of 1 / _STEPS up to the largest exponent a visible splat has, ln 255.
_STEPS = 32.0
_EXPONENTIALS = np.exp(-np.arange(6 * _STEPS) / _STEPS)


@inlined
def tile_bounds(tile, columns, width, height):
    """First and end pixel column, first and end row of a tile."""
    x0 = tile % columns * TILE
    y0 = tile // columns * TILE
    return x0, min(x0 + TILE, width), y0, min(y0 + TILE, height)


@inlined
def trace_splat(field, x0, x1, y0, y1, left, pixels, alphas, before):
    """List the pixels that a splat is added to, and reduce their transmittance by it.

    ``left (256,)`` is the transmittance of the tile's pixels, negative where a pixel is done.
    ``pixels``, ``alphas`` and ``before`` (256,) receive the pixel in the tile, alpha, and the
    transmittance before the splat.

    Returns how many were listed, and how many pixels are done because of it.
    """
    return trace_down_to(MIN_TRANSMITTANCE, field, x0, x1, y0, y1, left, pixels, alphas, before)


@inlined
def trace_down_to(least, field, x0, x1, y0, y1, left, pixels, alphas, before):
    """`trace_splat` that ends a pixel before its transmittance falls below `least`."""
    u, v = field[CENTRE_X], field[CENTRE_Y]
    fxx, fxy, fyy = field[FACTOR_XX], field[FACTOR_XY], field[FACTOR_YY]
    opacity = field[OPACITY]
    reach = field[REACH] + 1e-9
    count = done = 0
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
            alpha = min(MAX_ALPHA, opacity * _exp_minus(0.5 * q))
            if alpha < MIN_ALPHA:
                continue
            after = transmittance * (1.0 - alpha)
            if after < least:
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
def _whole(value):
    """Floor as an integer; values far outside the image are clamped."""
    return np.int64(math.floor(min(1e6, max(-1e6, value))))


@inlined
def _exp_minus(x):
    """exp(-x) for 0 <= x < 6, to 1e-11: the same on every machine, and faster than libm."""
    step = np.int64(x * _STEPS)
    r = step / _STEPS - x
    series = 1.0 + r * (1.0 + r * (0.5 + r * (1 / 6 + r * (1 / 24 + r * (1 / 120)))))
    return _EXPONENTIALS[step] * series

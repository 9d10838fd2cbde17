"""Squared change of an image from small changes of each splat, summed over its pixels."""

from __future__ import annotations

import math

import numpy as np

from gs_codec.rendering.project import (
    BLUE,
    CENTRE_X,
    CENTRE_Y,
    FACTOR_XX,
    FACTOR_XY,
    FACTOR_YY,
    GREEN,
    MIN_ALPHA,
    RED,
    TILE,
)
from gs_codec.rendering.trace import MAX_ALPHA, MIN_TRANSMITTANCE, tile_bounds, trace_splat
from gs_codec.runtime.kernels import inlined, kernel

#: Columns of the sums over a splat's pixels. g is the squared derivative of the pixel by ln alpha;
#: (e, f) is the offset from the centre, in axes where q = e^2 + f^2. Columns: g, g e^2, g e f,
#: g f^2, g e^4, g e^3 f, g e^2 f^2, g e f^3, g f^4, and (alpha T)^2.
G, G_EE, G_EF, G_FF, G_EEEE, G_EEEF, G_EEFF, G_EFFF, G_FFFF, SQUARED_WEIGHT = range(10)


#: Most splats that are added to one pixel: each takes at least `MIN_ALPHA` of its transmittance.
_LAYERS = math.ceil(math.log(MIN_TRANSMITTANCE) / math.log(1.0 - MIN_ALPHA))


@kernel
def sum_moments(fields, splats, starts, columns, width, height, background, sums):
    """Add all tiles of a view, in order, to ``sums (V, 10)``.

    A tile is traced front to back, then summed back to front.
    """
    # A tile touches only as much of these as it has layers.
    pixels = np.empty(_LAYERS * TILE * TILE, np.int64)
    alphas = np.empty(_LAYERS * TILE * TILE)
    before = np.empty(_LAYERS * TILE * TILE)
    left = np.empty(TILE * TILE)
    behind = np.empty((TILE * TILE, 3))
    for tile in range(len(starts) - 1):
        x0, x1, y0, y1 = tile_bounds(tile, columns, width, height)
        left[:] = 1.0
        still_open = (x1 - x0) * (y1 - y0)
        nearest = pair = starts[tile]
        ends = np.zeros(starts[tile + 1] - nearest + 1, np.int64)
        while pair < starts[tile + 1] and still_open > 0:
            used = ends[pair - nearest]
            count, done = trace_splat(
                fields[splats[pair]], x0, x1, y0, y1, left,
                pixels[used:], alphas[used:], before[used:],
            )  # fmt: skip
            still_open -= done
            pair += 1
            ends[pair - nearest] = used + count
        for pixel in range(TILE * TILE):
            for channel in range(3):
                behind[pixel, channel] = abs(left[pixel]) * background[channel]
        while pair > nearest:
            pair -= 1
            start, stop = ends[pair - nearest], ends[pair - nearest + 1]
            field, total = fields[splats[pair]], sums[splats[pair]]
            _add_pixels(field, x0, y0, start, stop, pixels, alphas, before, behind, total)


@inlined
def _add_pixels(field, x0, y0, start, stop, pixels, alphas, before, behind, total):
    """Add the pixels of one splat in one tile, and its light to `behind` for the next splat."""
    red, green, blue = field[RED], field[GREEN], field[BLUE]
    u, v = field[CENTRE_X] - x0, field[CENTRE_Y] - y0
    fxx, fxy, fyy = field[FACTOR_XX], field[FACTOR_XY], field[FACTOR_YY]
    sum_g = sum_ee = sum_ef = sum_ff = squared_weight = 0.0
    sum_eeee = sum_eeef = sum_eeff = sum_efff = sum_ffff = 0.0
    for i in range(start, stop):
        # Unsigned, so that numba does not test each index for being negative.
        pixel = np.uint64(pixels[i])
        alpha = alphas[i]
        weight = alpha * before[i]
        squared_weight += weight * weight
        own_red, own_green, own_blue = weight * red, weight * green, weight * blue
        # An alpha at its limit does not change.
        if alpha < MAX_ALPHA:
            uncovered = alpha / (1.0 - alpha)
            by_red = own_red - behind[pixel, 0] * uncovered
            by_green = own_green - behind[pixel, 1] * uncovered
            by_blue = own_blue - behind[pixel, 2] * uncovered
            g = by_red * by_red + by_green * by_green + by_blue * by_blue
            dy = np.int64(pixel // np.uint64(TILE)) - v
            e = fxx * (np.int64(pixel % np.uint64(TILE)) - u) + fxy * dy
            f = fyy * dy
            ee, ef, ff = e * e, e * f, f * f
            sum_g += g
            sum_ee += g * ee
            sum_ef += g * ef
            sum_ff += g * ff
            sum_eeee += g * ee * ee
            sum_eeef += g * ee * ef
            sum_eeff += g * ee * ff
            sum_efff += g * ef * ff
            sum_ffff += g * ff * ff
        behind[pixel, 0] += own_red
        behind[pixel, 1] += own_green
        behind[pixel, 2] += own_blue
    total[G] += sum_g
    total[G_EE] += sum_ee
    total[G_EF] += sum_ef
    total[G_FF] += sum_ff
    total[G_EEEE] += sum_eeee
    total[G_EEEF] += sum_eeef
    total[G_EEFF] += sum_eeff
    total[G_EFFF] += sum_efff
    total[G_FFFF] += sum_ffff
    total[SQUARED_WEIGHT] += squared_weight


@inlined
def second_moment(total, u, v):
    """Sum of ``g (o . u) (o . v)`` over the pixels, o being their offsets (e, f)."""
    return (
        total[G_EE] * u[0] * v[0]
        + total[G_EF] * (u[0] * v[1] + u[1] * v[0])
        + total[G_FF] * u[1] * v[1]
    )


@inlined
def fourth_moment(total, u, v):
    """Sum of ``g ((o . u) (o . v))^2`` over the pixels."""
    ee, ef, ff = u[0] * v[0], u[0] * v[1] + u[1] * v[0], u[1] * v[1]
    return (
        total[G_EEEE] * ee * ee
        + total[G_EEEF] * 2.0 * ee * ef
        + total[G_EEFF] * (ef * ef + 2.0 * ee * ff)
        + total[G_EFFF] * 2.0 * ef * ff
        + total[G_FFFF] * ff * ff
    )

"""Squared change of an image from small changes of each splat, summed over its pixels."""

from __future__ import annotations

import numpy as np

from gs_codec.rendering.project import TILE
from gs_codec.rendering.tiles_float32 import (
    BEHIND,
    LEAST_LEFT,
    MOST_ALPHA,
    PIXELS,
    draw_tile,
    open_tile,
    put_tile,
    total_of,
    turn_back,
    uncover,
    walk_back,
)
from gs_codec.rendering.tiles_float64 import tile_bounds
from gs_codec.runtime.kernels import inlined, kernel

#: Columns of the sums over a splat's pixels. g is the squared derivative of the pixel by ln alpha;
#: (e, f) is the offset from the centre, in axes where q = e^2 + f^2. Columns: g, g e^2, g e f,
#: g f^2, g e^4, g e^3 f, g e^2 f^2, g e f^3, g f^4, and (alpha T)^2.
G, G_EE, G_EF, G_FF, G_EEEE, G_EEEF, G_EEFF, G_EFFF, G_FFFF, SQUARED_WEIGHT = range(10)

_ZERO = np.float32(0)


@kernel
def sum_moments(fields, splats, starts, columns, background, colour, sums):
    """Draw all tiles of a view into an image ``(H, W, 3)``, and add them to ``sums (V, 10)``."""
    height, width, _ = colour.shape
    light, ends = np.empty(BEHIND, np.float32), np.empty(PIXELS, np.int32)
    by_column = np.empty((SQUARED_WEIGHT + 1) * TILE, np.float32)
    for tile in range(len(starts) - 1):
        x0, x1, y0, y1 = tile_bounds(tile, columns, width, height)
        open_tile(x0, x1, y0, y1, light, ends)
        start, stop = starts[tile], starts[tile + 1]
        reached = draw_tile(fields, splats, start, stop, x0, y0, height, LEAST_LEFT, light, ends)
        put_tile(light, x0, x1, y0, y1, background, colour)
        turn_back(background, light)
        walk_back(
            _take_moments, _total_moments, fields, splats, start, reached, x0, y0, height, light,
            ends, by_column, sums,
        )  # fmt: skip


@inlined
def _take_moments(row, x, alpha, red, green, blue, place, columns):
    e, f, ff, _ = place
    weight, by_red, by_green, by_blue = uncover(row, x, alpha, red, green, blue)
    g = by_red * by_red + by_green * by_green + by_blue * by_blue
    # An alpha at its limit does not change.
    g = g if alpha < MOST_ALPHA else _ZERO
    ge, gf = g * e, g * f
    gee, gef, gff = ge * e, ge * f, gf * f
    columns[x] += g
    columns[x + G_EE * TILE] += gee
    columns[x + G_EF * TILE] += gef
    columns[x + G_FF * TILE] += gff
    columns[x + G_EEEE * TILE] += gee * e * e
    columns[x + G_EEEF * TILE] += gee * e * f
    columns[x + G_EEFF * TILE] += gee * ff
    columns[x + G_EFFF * TILE] += gef * ff
    columns[x + G_FFFF * TILE] += gff * ff
    columns[x + SQUARED_WEIGHT * TILE] += weight * weight


@inlined
def _total_moments(pair, splat, u, columns, sums):
    total = sums[splat]
    for k in range(SQUARED_WEIGHT + 1):
        total[k] += total_of(columns, k)


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

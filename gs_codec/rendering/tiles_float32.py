"""Tiles rendered in float32, a row of 16 pixels at a time: for optimisation, not for measuring.

Measurements use `tiles_float64`; this is several times faster. Pixels do not depend on one another,
and sums are kept by column until a splat is done, so the results do not depend on the vector width
of the processor.
"""

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
    OPACITY,
    REACH,
    RED,
    TILE,
)
from gs_codec.rendering.tiles_float64 import MAX_ALPHA, MIN_TRANSMITTANCE, tile_bounds, whole
from gs_codec.runtime.kernels import inlined, kernel

#: Columns of the sums over a splat's pixels: the derivative by its colour, then moments of s =
#: alpha dL/dalpha: s, s dx, s dy, s dx^2, s dx dy, s dy^2, with (dx, dy) from the splat's centre to
#: the pixel. They suffice: alpha = opacity exp(-q / 2), and q is quadratic in (dx, dy).
BY_RED, BY_GREEN, BY_BLUE, MOMENT, MOMENT_X, MOMENT_Y, MOMENT_XX, MOMENT_XY, MOMENT_YY = range(9)

_ZERO = np.float32(0)
_ONE = np.float32(1)
_LEAST_ALPHA = np.float32(MIN_ALPHA)
MOST_ALPHA = np.float32(MAX_ALPHA)
LEAST_LEFT = np.float32(MIN_TRANSMITTANCE)

#: The same for leave-one-out errors: removing an opaque splat reveals what it hid.
_LEAST_HIDDEN = np.float32(1e-6)

#: Planes of a tile, consecutive in one array, so that the compiler knows that they do not overlap:
#: transmittance (negative if a pixel is done); red, green and blue, or derivatives by them; and the
#: light behind the splats not yet processed backwards, times these derivatives.
PIXELS = TILE * TILE
RED_PLANE, GREEN_PLANE, BLUE_PLANE, BEHIND, _PLANES = (k * PIXELS for k in range(1, 6))

#: Sums by column of the tile: by red, green, blue; s, s dy, s dy^2.
_BY_COLUMN = 6 * TILE

_NEVER = np.int32(2**31 - 1)

#: Coefficients of exp(-x) for 0 <= x < 0.7, after the constant 1.
_SERIES = tuple(
    np.float32(c)
    for c in (-0.99999999, 0.49999909, -0.16665146, 0.041572763, -0.0080679527, 0.0010332433)
)

_SIXTEENTH = np.float32(1 / 16)


@inlined
def _exp_minus_half(q):
    """exp(-q / 2) for 0 <= q < 11.1, to 2e-6."""
    x = _SIXTEENTH * q
    c1, c2, c3, c4, c5, c6 = _SERIES
    root = _ONE + x * (c1 + x * (c2 + x * (c3 + x * (c4 + x * (c5 + x * c6)))))
    root *= root
    root *= root
    return root * root


@inlined
def alpha_at(x, slope, offset, across, reach, opacity):
    """Alpha of a splat in column `x` of a row, and whether the splat is drawn there."""
    along = slope * np.float32(x) + offset
    q = along * along + across
    alpha = min(MOST_ALPHA, opacity * _exp_minus_half(min(q, reach)))
    return alpha, (q <= reach) & (alpha >= _LEAST_ALPHA)


@inlined
def splat_of(field):
    """Values common to all rows: slope of the offset, largest q, opacity, and colour."""
    return (
        np.float32(field[FACTOR_XX]), np.float32(field[REACH]), np.float32(field[OPACITY]),
        np.float32(field[RED]), np.float32(field[GREEN]), np.float32(field[BLUE]),
    )  # fmt: skip


@inlined
def place_in_tile(field, x0, y0, height):
    """First and end row of a splat in a tile, and its centre there."""
    v = field[CENTRE_Y] - y0
    high = math.sqrt(field[REACH]) / field[FACTOR_YY]
    rows = min(height - y0, TILE)
    return max(0, whole(v - high)), min(rows, whole(v + high) + 1), field[CENTRE_X] - x0, v


@inlined
def row_of(field, u, v, y):
    """Values of a row for `alpha_at`: offset, q across; from float64, to avoid cancellation."""
    dy = y - v
    across = (field[FACTOR_YY] * dy) ** 2
    return np.float32(field[FACTOR_XY] * dy - field[FACTOR_XX] * u), np.float32(across)


@inlined
def cover(row, x, alpha, drawn, least):
    """Composite a splat onto pixel `x`; return its weight, and whether the pixel was done before.

    A pixel is done before its transmittance would fall below `least`.
    """
    left = row[x]
    after = left * (_ONE - alpha)
    drawn &= left > _ZERO
    last = drawn & (after < least)
    drawn &= after >= least
    row[x] = -left if last else (after if drawn else left)
    return alpha * left if drawn else _ZERO, last


@inlined
def lift(row, x, alpha):
    """Remove a splat from pixel `x`; return its weight, and its ratio to the light it hides."""
    over = _ONE / (_ONE - alpha)
    row[x] *= over
    return alpha * row[x], alpha * over


@inlined
def uncover(row, x, alpha, red, green, blue):
    """Remove a splat from pixel `x`, and add it to the light behind the next.

    Returns its weight, and the change of red, green and blue of the pixel without it.
    """
    weight, uncovered = lift(row, x, alpha)
    by_red = row[x + RED_PLANE] * uncovered - weight * red
    by_green = row[x + GREEN_PLANE] * uncovered - weight * green
    by_blue = row[x + BLUE_PLANE] * uncovered - weight * blue
    row[x + RED_PLANE] += weight * red
    row[x + GREEN_PLANE] += weight * green
    row[x + BLUE_PLANE] += weight * blue
    return weight, by_red, by_green, by_blue


@kernel
def draw_tile(fields, splats, start, end, x0, y0, height, least, light, ends):
    """Render a tile front to back; return the end of the pairs that its pixels need.

    A pixel is done before its transmittance falls below `least`; ``ends (256,)`` receives the
    number of the pair at which each pixel is done.
    """
    still_open = 0
    for pair in range(start, end):
        field, number = fields[splats[pair]], np.int32(pair - start)
        slope, reach, opacity, red, green, blue = splat_of(field)
        top, bottom, u, v = place_in_tile(field, x0, y0, height)
        for y in range(top, bottom):
            offset, across = row_of(field, u, v, y)
            row = light[y * TILE : y * TILE + BEHIND]
            done = ends[y * TILE : y * TILE + TILE]
            for x in range(TILE):
                alpha, drawn = alpha_at(x, slope, offset, across, reach, opacity)
                weight, last = cover(row, x, alpha, drawn, least)
                row[x + RED_PLANE] += weight * red
                row[x + GREEN_PLANE] += weight * green
                row[x + BLUE_PLANE] += weight * blue
                done[x] = number if last else done[x]
        while still_open < PIXELS and light[still_open] <= _ZERO:
            still_open += 1
        if still_open == PIXELS:
            return pair + 1
    return end


@inlined
def walk_back(take, total, fields, splats, start, end, x0, y0, height, light, ends, columns, sums):
    """Go over the splats of a tile, back to front.

    For each pixel, ``take(row, x, alpha, red, green, blue, place, columns)`` removes a splat and
    adds to the sums by column; `alpha` is 0 where the splat is not drawn. `place` is the offset
    from its centre: a, b, b squared, and rows, with q = a squared + b squared. ``total(pair, splat,
    u, columns, sums)`` sums the columns.
    """
    for pair in range(end - 1, start - 1, -1):
        splat, number = splats[pair], np.int32(pair - start)
        field = fields[splat]
        slope, reach, opacity, red, green, blue = splat_of(field)
        top, bottom, u, v = place_in_tile(field, x0, y0, height)
        columns[:] = _ZERO
        for y in range(top, bottom):
            offset, across = row_of(field, u, v, y)
            down, dy = np.float32(field[FACTOR_YY] * (y - v)), np.float32(y - v)
            row = light[y * TILE : y * TILE + BEHIND + TILE]
            done = ends[y * TILE : y * TILE + TILE]
            for x in range(TILE):
                alpha, drawn = alpha_at(x, slope, offset, across, reach, opacity)
                alpha = alpha if drawn & (done[x] > number) else _ZERO
                place = slope * np.float32(x) + offset, down, across, dy
                take(row, x, alpha, red, green, blue, place, columns)
        total(pair, splat, u, columns, sums)


@inlined
def _take_gradient(row, x, alpha, red, green, blue, place, columns):
    _, _, _, dy = place
    weight, uncovered = lift(row, x, alpha)
    own = weight * (
        row[x + RED_PLANE] * red + row[x + GREEN_PLANE] * green + row[x + BLUE_PLANE] * blue
    )
    behind = row[x + BEHIND]
    change = own - behind * uncovered
    # An alpha at its limit does not change.
    change = change if alpha < MOST_ALPHA else _ZERO
    row[x + BEHIND] = behind + own
    columns[x] += weight * row[x + RED_PLANE]
    columns[x + TILE] += weight * row[x + GREEN_PLANE]
    columns[x + 2 * TILE] += weight * row[x + BLUE_PLANE]
    columns[x + 3 * TILE] += change
    columns[x + 4 * TILE] += change * dy
    columns[x + 5 * TILE] += change * dy * dy


@inlined
def _total_gradient(pair, splat, u, columns, sums):
    total = sums[pair]
    total[:] = 0.0
    for x in range(TILE):
        dx = x - u
        total[BY_RED] += columns[x]
        total[BY_GREEN] += columns[x + TILE]
        total[BY_BLUE] += columns[x + 2 * TILE]
        moment, moment_y = np.float64(columns[x + 3 * TILE]), np.float64(columns[x + 4 * TILE])
        total[MOMENT] += moment
        total[MOMENT_X] += moment * dx
        total[MOMENT_Y] += moment_y
        total[MOMENT_XX] += moment * dx * dx
        total[MOMENT_XY] += moment_y * dx
        total[MOMENT_YY] += columns[x + 5 * TILE]


@inlined
def total_of(columns, number):
    """Total of a sum by column, added in the same order everywhere."""
    a = b = c = d = _ZERO
    for x in range(number * TILE, (number + 1) * TILE, 4):
        a += columns[x]
        b += columns[x + 1]
        c += columns[x + 2]
        d += columns[x + 3]
    return np.float64((a + b) + (c + d))


@inlined
def open_tile(x0, x1, y0, y1, light, ends):
    """Prepare the planes of a tile for `draw_tile`; pixels outside the image count as done."""
    light[:] = _ZERO
    ends[:] = np.int32(-1)
    for y in range(y1 - y0):
        light[y * TILE : y * TILE + x1 - x0] = _ONE
        ends[y * TILE : y * TILE + x1 - x0] = _NEVER


@kernel
def draw_float32(
    fields, splats, starts, first, end, columns, background, colour, left, ends, reached
):
    """Render tiles `first` to `end` into an image ``(H, W, 3)``, float32.

    ``left (tiles, 256)`` and ``ends (tiles, 256)`` receive the transmittance behind all splats, and
    the number of the pair at which a pixel is done; ``reached (tiles,)`` the end of the pairs that
    were drawn.
    """
    height, width, _ = colour.shape
    light = np.empty(_PLANES, np.float32)
    for tile in range(first, end):
        x0, x1, y0, y1 = tile_bounds(tile, columns, width, height)
        open_tile(x0, x1, y0, y1, light, ends[tile])
        start, stop = starts[tile], starts[tile + 1]
        reached[tile] = draw_tile(
            fields, splats, start, stop, x0, y0, height, LEAST_LEFT, light, ends[tile]
        )
        for pixel in range(PIXELS):
            left[tile, pixel] = abs(light[pixel])
        put_tile(light, x0, x1, y0, y1, background, colour)


@inlined
def put_tile(light, x0, x1, y0, y1, background, colour):
    """Copy a tile rendered by `draw_tile` into an image ``(H, W, 3)``."""
    for y in range(y0, y1):
        for x in range(x0, x1):
            pixel = (y - y0) * TILE + x - x0
            for channel in range(3):
                behind = abs(light[pixel]) * np.float32(background[channel])
                colour[y, x, channel] = light[pixel + (channel + 1) * PIXELS] + behind


@kernel
def sum_gradients(
    fields, splats, starts, first, end, columns, background, by_colour, left, ends, reached, sums
):  # fmt: skip
    """Fill ``sums (pairs, 9)`` for tiles `first` to `end`, from the results of `draw_float32`.

    ``by_colour (H, W, 3)`` is the derivative of the loss by the image.
    """
    height, width, _ = by_colour.shape
    light = np.empty(_PLANES, np.float32)
    by_column = np.empty(_BY_COLUMN, np.float32)
    for tile in range(first, end):
        x0, x1, y0, y1 = tile_bounds(tile, columns, width, height)
        light[:] = _ZERO
        for pixel in range(PIXELS):
            light[pixel] = left[tile, pixel]
        for y in range(y0, y1):
            for x in range(x0, x1):
                pixel = (y - y0) * TILE + x - x0
                behind = 0.0
                for channel in range(3):
                    slope = by_colour[y, x, channel]
                    light[pixel + (channel + 1) * PIXELS] = slope
                    behind += slope * background[channel]
                light[pixel + BEHIND] = left[tile, pixel] * behind
        start, stop = starts[tile], reached[tile]
        sums[stop : starts[tile + 1]] = 0.0
        walk_back(
            _take_gradient, _total_gradient, fields, splats, start, stop, x0, y0, height, light,
            ends[tile], by_column, sums,
        )  # fmt: skip


@kernel
def sum_errors_without(
    fields, splats, starts, first, end, columns, width, height, background, errors
):
    """Squared error of tiles `first` to `end` without each single splat: ``errors (pairs, 1)``."""
    light, ends = np.empty(BEHIND, np.float32), np.empty(PIXELS, np.int32)
    by_column = np.empty(TILE, np.float32)
    for tile in range(first, end):
        x0, x1, y0, y1 = tile_bounds(tile, columns, width, height)
        open_tile(x0, x1, y0, y1, light, ends)
        start, stop = starts[tile], starts[tile + 1]
        reached = draw_tile(fields, splats, start, stop, x0, y0, height, _LEAST_HIDDEN, light, ends)
        turn_back(background, light)
        errors[reached:stop] = 0.0
        walk_back(
            _take_error, _total_error, fields, splats, start, reached, x0, y0, height, light, ends,
            by_column, errors,
        )  # fmt: skip


@inlined
def turn_back(background, light):
    """After `draw_tile`, prepare for back to front: keep only the light behind all splats."""
    for pixel in range(PIXELS):
        light[pixel] = abs(light[pixel])
        for channel in range(3):
            behind = light[pixel] * np.float32(background[channel])
            light[pixel + (channel + 1) * PIXELS] = behind


@inlined
def _take_error(row, x, alpha, red, green, blue, place, columns):
    _, by_red, by_green, by_blue = uncover(row, x, alpha, red, green, blue)
    columns[x] += by_red * by_red + by_green * by_green + by_blue * by_blue


@inlined
def _total_error(pair, splat, u, columns, errors):
    errors[pair, 0] = total_of(columns, 0)

"""Tiles rendered in float32, a row of 16 pixels at a time: for optimisation, not for measuring.

Measurements use `tiles_float64`; this is several times faster. Rows are processed as `simd` lanes,
and sums are kept by column until a splat is done, so the results do not depend on the processor.
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
from gs_codec.rendering.tiles_float64 import (
    AHEAD,
    MAX_ALPHA,
    MIN_TRANSMITTANCE,
    request_fields,
    tile_bounds,
    whole,
)
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.simd import (
    bits_of,
    columns,
    load,
    mask_of,
    repeated,
    store,
    total,
    where,
    wide,
)

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

#: Planes of a tile, one after another in an array: transmittance (negative if a pixel is done);
#: red, green and blue, or derivatives by them; and the light behind the splats not yet processed
#: backwards, times these derivatives.
PIXELS = TILE * TILE
RED_PLANE, GREEN_PLANE, BLUE_PLANE, BEHIND, _PLANES = (k * PIXELS for k in range(1, 6))

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
    root = root * root
    root = root * root
    return root * root


@inlined
def _alpha_of(q, opacity):
    """Alpha of a splat at distances q."""
    alpha = opacity * _exp_minus_half(q)
    return where(alpha < MOST_ALPHA, alpha, repeated(MOST_ALPHA))


@inlined
def place_in_tile(field, x0, y0, height):
    """First and end row of a splat in a tile, and its centre there."""
    v = field[CENTRE_Y] - y0
    high = math.sqrt(field[REACH]) / field[FACTOR_YY]
    rows = min(height - y0, TILE)
    return max(0, whole(v - high)), min(rows, whole(v + high) + 1), field[CENTRE_X] - x0, v


@inlined
def splat_of(field):
    """Factors of the conic, largest q, and opacity of a splat."""
    factors = field[FACTOR_XX], field[FACTOR_XY], field[FACTOR_YY]
    return factors, np.float32(field[REACH]), np.float32(field[OPACITY])


@inlined
def colour_of(field):
    """Red, green and blue of a splat."""
    return np.float32(field[RED]), np.float32(field[GREEN]), np.float32(field[BLUE])


@inlined
def _row_of(splat, u, v, y):
    """Offsets a and b of a row from the centre, and b squared; q is a squared + b squared."""
    (fxx, fxy, fyy), _, _ = splat
    # In float64, to avoid cancellation.
    down = fyy * (y - v)
    offset = np.float32(fxy * (y - v) - fxx * u)
    return np.float32(fxx) * columns() + offset, np.float32(down), np.float32(down**2)


@inlined
def cover(splat, u, v, y, left, least):
    """Composite a splat onto a row of transmittances `left`, negative where a pixel is done.

    Returns the weights of the splat, where it is drawn, and the transmittances after it. A pixel is
    done before its transmittance would fall below `least`.
    """
    _, reach, opacity = splat
    along, _, across = _row_of(splat, u, v, y)
    q, weight = along * along + across, repeated(_ZERO)
    drawn = (q <= reach) & (left > _ZERO)
    if bits_of(drawn) != 0:
        alpha = _alpha_of(q, opacity)
        drawn = drawn & (alpha >= _LEAST_ALPHA)
        after = left * (_ONE - alpha)
        last, drawn = drawn & (after < least), drawn & (after >= least)
        weight = where(drawn, alpha * left, weight)
        left = where(last, -_ONE * left, where(drawn, after, left))
    return weight, drawn, left


@inlined
def lift(light, at, alpha):
    """Remove a splat from a row; return its weight, and its ratio to the light it hides."""
    over = _ONE / (_ONE - alpha)
    left = load(light, at) * over
    store(light, at, left)
    return alpha * left, alpha * over


@inlined
def uncover(light, at, alpha, red, green, blue):
    """Remove a splat from a row, and add it to the light behind the next.

    Returns its weight, and the change of red, green and blue of the pixels without it.
    """
    weight, uncovered = lift(light, at, alpha)
    old_red, old_green = load(light, at + RED_PLANE), load(light, at + GREEN_PLANE)
    old_blue = load(light, at + BLUE_PLANE)
    own_red, own_green, own_blue = weight * red, weight * green, weight * blue
    store(light, at + RED_PLANE, old_red + own_red)
    store(light, at + GREEN_PLANE, old_green + own_green)
    store(light, at + BLUE_PLANE, old_blue + own_blue)
    return (
        weight,
        old_red * uncovered - own_red,
        old_green * uncovered - own_green,
        old_blue * uncovered - own_blue,
    )


@kernel
def draw_tile(fields, splats, start, end, x0, y0, height, least, light, drawn):
    """Render a tile front to back; return the end of the pairs that its pixels need.

    A pixel is done before its transmittance falls below `least`; ``drawn (pairs, 16)`` receives
    the pixels that each pair draws, as bits of each of its rows.
    """
    still_open = 0
    for pair in range(start, end):
        request_fields(fields, splats[min(pair + AHEAD, end - 1)])
        field = fields[splats[pair]]
        splat, (red, green, blue) = splat_of(field), colour_of(field)
        top, bottom, u, v = place_in_tile(field, x0, y0, height)
        for y in range(top, bottom):
            at = y * TILE
            weight, seen, left = cover(splat, u, v, y, load(light, at), least)
            store(light, at, left)
            drawn[pair, y] = bits_of(seen)
            if bits_of(seen) != 0:
                store(light, at + RED_PLANE, load(light, at + RED_PLANE) + weight * red)
                store(light, at + GREEN_PLANE, load(light, at + GREEN_PLANE) + weight * green)
                store(light, at + BLUE_PLANE, load(light, at + BLUE_PLANE) + weight * blue)
        while still_open < PIXELS and light[still_open] <= _ZERO:
            still_open += 1
        if still_open == PIXELS:
            return pair + 1
    return end


@inlined
def walk_back(
    take, add_up, none, fields, splats, start, end, x0, y0, height, light, drawn, results
):
    """Go over the splats of a tile, back to front.

    For each row, ``take(light, at, alpha, red, green, blue, place, sums)`` removes a splat, and
    returns the sums by column with the row added, `none` at first; `alpha` is 0 where the splat is
    not drawn. `place` is the offset from its centre: a, b, b squared, and rows, with q = a squared
    + b squared. ``add_up(pair, splat, u, sums, results)`` adds up the columns.
    """
    for pair in range(end - 1, start - 1, -1):
        request_fields(fields, splats[max(pair - AHEAD, start)])
        field = fields[splats[pair]]
        splat, (red, green, blue) = splat_of(field), colour_of(field)
        top, bottom, u, v = place_in_tile(field, x0, y0, height)
        sums = none
        for y in range(top, bottom):
            seen = np.int64(drawn[pair, y])
            if seen == 0:
                continue
            along, down, across = _row_of(splat, u, v, y)
            alpha = _alpha_of(along * along + across, splat[2])
            alpha = where(mask_of(seen), alpha, repeated(_ZERO))
            place = along, down, across, np.float32(y - v)
            sums = take(light, y * TILE, alpha, red, green, blue, place, sums)
        add_up(pair, splats[pair], u, sums, results)


@inlined
def _take_gradient(light, at, alpha, red, green, blue, place, sums):
    weight, uncovered = lift(light, at, alpha)
    by_red, by_green = load(light, at + RED_PLANE), load(light, at + GREEN_PLANE)
    by_blue = load(light, at + BLUE_PLANE)
    own = weight * (by_red * red + by_green * green + by_blue * blue)
    behind = load(light, at + BEHIND)
    # An alpha at its limit does not change.
    change = where(alpha < MOST_ALPHA, own - behind * uncovered, repeated(_ZERO))
    store(light, at + BEHIND, behind + own)
    dy = place[3]
    return (
        sums[0] + weight * by_red,
        sums[1] + weight * by_green,
        sums[2] + weight * by_blue,
        sums[3] + change,
        sums[4] + change * dy,
        sums[5] + change * dy * dy,
    )


@inlined
def _total_gradient(pair, splat, u, sums, results):
    row, dx = results[pair], wide(columns()) - u
    by_moment, by_moment_y = wide(sums[3]) * dx, wide(sums[4]) * dx
    row[BY_RED] = total(wide(sums[0]))
    row[BY_GREEN] = total(wide(sums[1]))
    row[BY_BLUE] = total(wide(sums[2]))
    row[MOMENT] = total(wide(sums[3]))
    row[MOMENT_X] = total(by_moment)
    row[MOMENT_Y] = total(wide(sums[4]))
    row[MOMENT_XX] = total(by_moment * dx)
    row[MOMENT_XY] = total(by_moment_y)
    row[MOMENT_YY] = total(wide(sums[5]))


@inlined
def open_tile(x0, x1, y0, y1, light):
    """Prepare the planes of a tile for `draw_tile`; pixels outside the image count as done."""
    light[:] = _ZERO
    for y in range(y1 - y0):
        light[y * TILE : y * TILE + x1 - x0] = _ONE


@kernel
def draw_float32(
    fields, splats, starts, first, end, columns, background, colour, left, drawn, reached
):
    """Render tiles `first` to `end` into an image ``(H, W, 3)``, float32.

    ``left (tiles, 256)`` receives the transmittance behind all splats; ``drawn (pairs, 16)`` the
    pixels that each pair draws, as in `draw_tile`; ``reached (tiles,)`` the end of the pairs that
    were drawn.
    """
    height, width, _ = colour.shape
    light = np.empty(_PLANES, np.float32)
    for tile in range(first, end):
        x0, x1, y0, y1 = tile_bounds(tile, columns, width, height)
        open_tile(x0, x1, y0, y1, light)
        start, stop = starts[tile], starts[tile + 1]
        reached[tile] = draw_tile(
            fields, splats, start, stop, x0, y0, height, LEAST_LEFT, light, drawn
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
    fields, splats, starts, first, end, columns, background, by_colour, left, drawn, reached, sums
):  # fmt: skip
    """Fill ``sums (pairs, 9)`` for tiles `first` to `end`, from the results of `draw_float32`.

    ``by_colour (H, W, 3)`` is the derivative of the loss by the image.
    """
    height, width, _ = by_colour.shape
    light = np.empty(_PLANES, np.float32)
    zero = repeated(_ZERO)
    none = zero, zero, zero, zero, zero, zero
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
            _take_gradient, _total_gradient, none, fields, splats, start, stop, x0, y0, height,
            light, drawn, sums,
        )  # fmt: skip


@kernel
def sum_errors_without(
    fields, splats, starts, first, end, columns, width, height, background, errors
):
    """Squared error of tiles `first` to `end` without each single splat: ``errors (pairs, 1)``."""
    light, drawn = np.empty(BEHIND, np.float32), np.empty((len(splats), TILE), np.uint16)
    for tile in range(first, end):
        x0, x1, y0, y1 = tile_bounds(tile, columns, width, height)
        open_tile(x0, x1, y0, y1, light)
        start, stop = starts[tile], starts[tile + 1]
        reached = draw_tile(
            fields, splats, start, stop, x0, y0, height, _LEAST_HIDDEN, light, drawn
        )
        turn_back(background, light)
        errors[reached:stop] = 0.0
        walk_back(
            _take_error, _total_error, repeated(_ZERO), fields, splats, start, reached, x0, y0,
            height, light, drawn, errors,
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
def _take_error(light, at, alpha, red, green, blue, place, sums):
    _, by_red, by_green, by_blue = uncover(light, at, alpha, red, green, blue)
    return sums + (by_red * by_red + by_green * by_green + by_blue * by_blue)


@inlined
def _total_error(pair, splat, u, sums, errors):
    errors[pair, 0] = np.float64(total(sums))

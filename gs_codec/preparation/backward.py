"""From derivatives by pixel to derivatives by splat, front to back over the tiles once more.

Let C be the colour of a pixel, S_k the light from behind splat k, and w_k = alpha_k T_k its weight.
Then ``dC / dc_k = w_k`` and ``dC / dalpha_k = T_k c_k - S_k / (1 - alpha_k)`` (Kerbl et al. 2023,
Appendix C, which goes back to front).
"""

from __future__ import annotations

import numpy as np

from gs_codec.kernels import kernel
from gs_codec.rendering.project import BLUE, CENTRE_X, CENTRE_Y, GREEN, RED, TILE
from gs_codec.rendering.trace import MAX_ALPHA, tile_bounds, trace_splat

#: Columns of the sums over a splat's pixels: the derivative by its colour, then moments of
#: s = alpha dL/dalpha: s, s dx, s dy, s dx^2, s dx dy, s dy^2, with (dx, dy) from the splat's
#: centre to the pixel. They suffice: alpha = opacity exp(-q / 2), and q is quadratic in (dx, dy).
BY_RED, BY_GREEN, BY_BLUE, MOMENT, MOMENT_X, MOMENT_Y, MOMENT_XX, MOMENT_XY, MOMENT_YY = range(9)


@kernel
def differentiate_tiles(fields, splats, starts, first, end, columns, colour, by_colour, sums):
    """Fill ``sums (pairs, 9)`` for tiles `first` to `end`.

    ``colour (H, W, 3)`` is the image, background included; ``by_colour (H, W, 3)`` is the
    derivative of the loss by it.
    """
    height, width, _ = colour.shape
    pull = np.empty((TILE * TILE, 4))
    left = np.empty(TILE * TILE)
    pixels = np.empty(TILE * TILE, np.int64)
    alphas = np.empty(TILE * TILE)
    before = np.empty(TILE * TILE)
    for tile in range(first, end):
        x0, x1, y0, y1 = tile_bounds(tile, columns, width, height)
        left[:] = 1.0
        for y in range(y0, y1):
            for x in range(x0, x1):
                pixel = pull[(y - y0) * TILE + x - x0]
                pixel[3] = 0.0
                for channel in range(3):
                    pixel[channel] = by_colour[y, x, channel]
                    pixel[3] += by_colour[y, x, channel] * colour[y, x, channel]
        still_open = (x1 - x0) * (y1 - y0)
        for pair in range(starts[tile], starts[tile + 1]):
            total = sums[pair]
            total[:] = 0.0
            if still_open == 0:
                continue
            field = fields[splats[pair]]
            count, done = trace_splat(field, x0, x1, y0, y1, left, pixels, alphas, before)
            still_open -= done
            red, green, blue = field[RED], field[GREEN], field[BLUE]
            u, v = field[CENTRE_X] - x0, field[CENTRE_Y] - y0
            by_red = by_green = by_blue = moment = 0.0
            moment_x = moment_y = moment_xx = moment_xy = moment_yy = 0.0
            for i in range(count):
                # Unsigned, so that numba does not test each index for being negative.
                place = np.uint64(pixels[i])
                alpha = alphas[i]
                weight = alpha * before[i]
                pull_red, pull_green, pull_blue = pull[place, 0], pull[place, 1], pull[place, 2]
                by_red += weight * pull_red
                by_green += weight * pull_green
                by_blue += weight * pull_blue
                own = weight * (pull_red * red + pull_green * green + pull_blue * blue)
                behind = pull[place, 3] - own
                pull[place, 3] = behind
                # An alpha at its limit does not change.
                if alpha < MAX_ALPHA:
                    change = own - behind * (alpha / (1.0 - alpha))
                    dx = np.int64(place % np.uint64(TILE)) - u
                    dy = np.int64(place // np.uint64(TILE)) - v
                    moment += change
                    moment_x += change * dx
                    moment_y += change * dy
                    moment_xx += change * dx * dx
                    moment_xy += change * dx * dy
                    moment_yy += change * dy * dy
            total[BY_RED], total[BY_GREEN], total[BY_BLUE] = by_red, by_green, by_blue
            total[MOMENT], total[MOMENT_X], total[MOMENT_Y] = moment, moment_x, moment_y
            total[MOMENT_XX], total[MOMENT_XY], total[MOMENT_YY] = moment_xx, moment_xy, moment_yy

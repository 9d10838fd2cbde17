"""Compositing the splats of a tile, front to back."""

from __future__ import annotations

import numpy as np

from gs_codec.kernels import kernel
from gs_codec.rendering.project import BLUE, DEPTH, GREEN, RED, TILE
from gs_codec.rendering.trace import tile_bounds, trace_splat

#: Columns of the sums kept for each splat-tile pair, over the pixels it was added to.
WEIGHT, SQUARED_WEIGHT, TRANSMITTANCE, PIXELS = range(4)


@kernel
def draw_tiles(fields, splats, starts, first, end, columns, background, colour, alpha, depth, sums):
    """Draw tiles `first` to `end` into images ``(H, W, 3)``, ``(H, W)``, ``(H, W)`` float32.

    ``sums (pairs, 4)`` is filled too, unless it is empty.
    """
    height, width = alpha.shape
    light = np.empty((TILE * TILE, 4))
    left = np.empty(TILE * TILE)
    pixels = np.empty(TILE * TILE, np.int64)
    alphas = np.empty(TILE * TILE)
    before = np.empty(TILE * TILE)
    for tile in range(first, end):
        x0, x1, y0, y1 = tile_bounds(tile, columns, width, height)
        light[:] = 0.0
        left[:] = 1.0
        still_open = (x1 - x0) * (y1 - y0)
        for pair in range(starts[tile], starts[tile + 1]):
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

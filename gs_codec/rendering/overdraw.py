"""How many splats lie over each pixel of a view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.rendering.frame import make_frame
from gs_codec.rendering.project import TILE
from gs_codec.rendering.tiles_float64 import tile_bounds, tile_buffers, trace_splat
from gs_codec.runtime.kernels import kernel
from gs_codec.scene import Scene


def count_splats(scene: Scene, camera: Camera) -> NDArray[np.int64]:
    """Number of splats with an alpha of at least 1/255 at each pixel, ``(H, W)``.

    Splats behind opaque ones count, because graphics cards blend all of them.
    """
    frame = make_frame(scene, camera)
    counts = np.zeros((camera.height, camera.width), np.int64)
    frame.over_tiles(_count_splats, counts)
    return counts


@kernel
def _count_splats(fields, splats, starts, first, end, columns, counts):
    """Count in tiles `first` to `end`."""
    height, width = counts.shape
    left, pixels, alphas, before = tile_buffers()
    for tile in range(first, end):
        x0, x1, y0, y1 = tile_bounds(tile, columns, width, height)
        tile_counts = counts[y0:y1, x0:x1]
        for pair in range(starts[tile], starts[tile + 1]):
            left[:] = 1.0  # nothing hides the splat
            field = fields[splats[pair]]
            count, _ = trace_splat(field, x0, x1, y0, y1, left, pixels, alphas, before)
            for i in range(count):
                tile_counts[pixels[i] // TILE, pixels[i] % TILE] += 1

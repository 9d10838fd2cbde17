"""The Gaussians whose splats cover pixels of a picture."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.rendering.frame import make_frame
from gs_codec.rendering.project import OPACITY, TILE
from gs_codec.rendering.tiles_float64 import tile_bounds, tile_buffers, trace_splat
from gs_codec.runtime.kernels import kernel
from gs_codec.scene import Scene

#: A splat covers pixels where its alpha is at least this share of its peak: within 1.4 standard
#: deviations, so that even the smallest splats cover a pixel.
_SHARE = math.exp(-1.0)


def covering(
    scene: Scene, camera: Camera, wanted: NDArray[np.bool_], least: float = 0.0
) -> NDArray[np.bool_]:
    """Mask ``(N,)`` of the Gaussians whose splats cover any of some pixels.

    Parameters
    ----------
    scene : Scene
    camera : Camera
    wanted : ndarray, shape (H, W), bool
        The pixels.
    least : float, 0-1
        Minimum transmittance in front of the splat at such a pixel; 0 ignores what is in front.
    """
    frame = make_frame(scene, camera)
    hits = np.zeros(frame.pairs, bool)
    frame.over_tiles(_cover, np.ascontiguousarray(wanted), float(least), hits)
    found = np.zeros(scene.count, bool)
    found[frame.splats.gaussians[frame.lists.splats[hits]]] = True
    return found


@kernel
def _cover(fields, splats, starts, first, end, columns, wanted, least, hits):
    """Fill `hits` of the splats in tiles `first` to `end`."""
    left, pixels, alphas, before = tile_buffers()
    height, width = wanted.shape
    for tile in range(first, end):
        x0, x1, y0, y1 = tile_bounds(tile, columns, width, height)
        if not wanted[y0:y1, x0:x1].any():
            continue
        left[:] = 1.0
        for pair in range(starts[tile], starts[tile + 1]):
            if least <= 0.0:
                left[:] = 1.0
            field = fields[splats[pair]]
            count, _ = trace_splat(field, x0, x1, y0, y1, left, pixels, alphas, before)
            lowest = _SHARE * field[OPACITY]
            for k in range(count):
                row, column = y0 + pixels[k] // TILE, x0 + pixels[k] % TILE
                if wanted[row, column] and alphas[k] >= lowest and before[k] >= least:
                    hits[pair] = True
                    break

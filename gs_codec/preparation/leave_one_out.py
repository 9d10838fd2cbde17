"""What the images lose if one Gaussian goes (after POTR, arXiv 2601.14821).

Without splat k, the pixels that it covers change by ``S alpha / (1 - alpha) - alpha T c``, where S
is the light of everything behind it. The squared change is summed over pixels and views.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from gs_codec.kernels import kernel
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.frame import make_frame
from gs_codec.rendering.project import RED, TILE
from gs_codec.rendering.trace import tile_bounds, trace_down_to
from gs_codec.scene import Scene

#: Transmittance where a pixel ends; low, as the removal of an opaque splat shows what it hid.
_LEAST = 1e-6


def leave_one_out(
    scene: Scene,
    cameras: Sequence[Camera],
    background: Sequence[float] = (0.0, 0.0, 0.0),
    advance: Callable[[], None] | None = None,
) -> NDArray[np.float64]:
    """Squared error that the images of a scene would have without each single Gaussian.

    Errors against other images are not a better guide: all Gaussians whose removal reduces the
    same error would be removed together, which is too many.

    Parameters
    ----------
    scene : Scene
    cameras : sequence of Camera
    background : sequence of three float
        RGB behind the scene.
    advance : callable, optional
        Called after each view.

    Returns
    -------
    ndarray, shape (N,), float64
        Sum over views, pixels and colours.
    """
    scores = np.zeros(scene.count)
    behind = np.array(background, np.float64)
    for camera in cameras:
        frame = make_frame(scene, camera)
        errors = np.zeros((frame.pairs, 1))
        frame.over_tiles(_leave_out, camera.width, camera.height, behind, errors)
        scores += frame.sum_pairs(scene.count, errors)[:, 0]
        if advance is not None:
            advance()
    return scores


@kernel
def _leave_out(fields, splats, starts, first, end, columns, width, height, background, errors):
    """Fill ``errors (pairs, 1)``."""
    left = np.empty(TILE * TILE)
    pixels = np.empty(TILE * TILE, np.int64)
    alphas = np.empty(TILE * TILE)
    before = np.empty(TILE * TILE)
    behind = np.empty((TILE * TILE, 3))
    for tile in range(first, end):
        x0, x1, y0, y1 = tile_bounds(tile, columns, width, height)
        # First sum all light of each pixel; then go front to back and subtract what is passed.
        behind[:] = 0.0
        left[:] = 1.0
        for pair in range(starts[tile], starts[tile + 1]):
            field = fields[splats[pair]]
            count, _ = trace_down_to(_LEAST, field, x0, x1, y0, y1, left, pixels, alphas, before)
            for i in range(count):
                for channel in range(3):
                    behind[pixels[i], channel] += alphas[i] * before[i] * field[RED + channel]
        for pixel in range(TILE * TILE):
            for channel in range(3):
                behind[pixel, channel] += abs(left[pixel]) * background[channel]
        left[:] = 1.0
        for pair in range(starts[tile], starts[tile + 1]):
            field = fields[splats[pair]]
            count, _ = trace_down_to(_LEAST, field, x0, x1, y0, y1, left, pixels, alphas, before)
            added = 0.0
            for i in range(count):
                pixel = pixels[i]
                uncovered = alphas[i] / (1.0 - alphas[i])
                for channel in range(3):
                    own = alphas[i] * before[i] * field[RED + channel]
                    behind[pixel, channel] -= own
                    change = behind[pixel, channel] * uncovered - own
                    added += change * change
            errors[pair, 0] = added

"""The camera that shows the most of a scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.coding.clean import solid_gaussians
from gs_codec.scene import Scene

#: Maximum number of centres that count.
_SAMPLES = 20_000


def widest_view(scene: Scene, cameras: Sequence[Camera]) -> int:
    """Index of the camera with the most solid centres of the scene inside its image.

    Parameters
    ----------
    scene : Scene
    cameras : sequence of Camera
        At least one; ties go to the first.
    """
    finite = np.isfinite(scene.positions).all(axis=0)
    some = solid_gaussians(scene.opacity[0], finite)
    some = some[:: max(1, len(some) // _SAMPLES)]
    points = scene.positions[:, some].astype(np.float64)
    return int(np.argmax([_inside(points, camera) for camera in cameras]))


def _inside(points: NDArray[np.float64], camera: Camera) -> int:
    """Number of points ``(3, n)`` inside an image, ignoring lens distortion."""
    x, y, z = camera.rotation @ (points - camera.position[:, None])
    u, v = camera.fx * x + camera.cx * z, camera.fy * y + camera.cy * z
    inside = (z > 0) & (u >= 0) & (u <= camera.width * z) & (v >= 0) & (v <= camera.height * z)
    return int(inside.sum())

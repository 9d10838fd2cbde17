"""Lines drawn over a pane."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import open3d as o3d
from numpy.typing import NDArray


def line_mesh(
    lines: Sequence[NDArray], width: float, lens: Sequence[float]
) -> o3d.geometry.TriangleMesh:
    """Closed lines in the plane at distance 1 before a camera, visible from both sides.

    Open3D's own lines are not used, because it does not draw horizontal ones.

    Parameters
    ----------
    lines : sequence of ndarray, shape (n, 2)
        Pixels.
    width : float
        Pixels.
    lens : sequence of four float
        Focal lengths and principal point, from `Pose.lens`.
    """
    starts = np.concatenate(lines).astype(np.float64)
    ends = np.concatenate([np.roll(line, -1, axis=0) for line in lines])
    along = ends - starts
    length = np.linalg.norm(along, axis=1, keepdims=True)
    along *= 0.5 * width / np.where(length > 0, length, np.inf)
    across = along[:, ::-1] * (-1, 1)
    # Each side extends half a width beyond its ends, so that corners are closed.
    first, last = starts - along, ends + along
    quads = np.stack([first + across, first - across, last - across, last + across], axis=1)
    fx, fy, cx, cy = lens
    places = (quads.reshape(-1, 2) - (cx, cy)) / (fx, fy)
    vertices = np.concatenate([places, np.ones((len(places), 1))], axis=1)
    sides = np.array([(0, 1, 2), (0, 2, 3), (2, 1, 0), (3, 2, 0)])
    triangles = (4 * np.arange(len(starts))[:, None, None] + sides).reshape(-1, 3)
    return o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(triangles.astype(np.int32))
    )

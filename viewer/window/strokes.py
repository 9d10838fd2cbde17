"""Lines drawn over a pane, in pixels: seen on dark and on light pictures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import open3d as o3d

from viewer.scenes.region import Pixel

#: A light line on a dark, wider one: width in pixels, grey level, and depth in near planes.
STROKES = {"stroke edge": (5.0, 0.05, 1.4), "stroke": (2.0, 0.95, 1.2)}


def stroke_mesh(
    corners: Sequence[Pixel], width: float, lens: Sequence[float]
) -> o3d.geometry.TriangleMesh:
    """A closed line in the plane at distance 1 before a camera, visible from both sides.

    Parameters
    ----------
    corners : sequence of pairs of float
        Pixels.
    width : float
        Pixels.
    lens : sequence of four float
        Focal lengths and principal point, as `Pose.lens` gives them.
    """
    ends = np.array(corners, np.float64)
    along = np.roll(ends, -1, axis=0) - ends
    length = np.linalg.norm(along, axis=1, keepdims=True)
    along *= 0.5 * width / np.where(length > 0, length, np.inf)
    across = along[:, ::-1] * (-1, 1)
    # Each side reaches half a width beyond its ends, so that corners are closed.
    first, last = ends - along, np.roll(ends, -1, axis=0) + along
    quads = np.stack([first + across, first - across, last - across, last + across], axis=1)
    fx, fy, cx, cy = lens
    places = (quads.reshape(-1, 2) - (cx, cy)) / (fx, fy)
    vertices = np.concatenate([places, np.ones((len(places), 1))], axis=1)
    sides = np.array([(0, 1, 2), (0, 2, 3), (2, 1, 0), (3, 2, 0)])
    triangles = (4 * np.arange(len(ends))[:, None, None] + sides).reshape(-1, 3)
    return o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(triangles.astype(np.int32))
    )

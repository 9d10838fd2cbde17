"""The outline of a picked Gaussian."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from gs_codec.cameras.inria import as_camera
from gs_codec.rendering.pixel import splat_outline
from viewer.scenes.opened import Opened
from viewer.scenes.pose import Pose

#: Minimum distance of an outline from its centre, pixels.
_LEAST = 7.0

#: Radius of the mark of the centre, pixels.
_CENTRE = 3.0

#: Radius of the ring around a measured point, pixels.
_POINT = 5.0

#: Widths of the dark line and the light one over it, pixels, and their RGB, 0-1.
LINES = ((5.0, (0.0, 0.0, 0.0)), (2.0, (1.0, 1.0, 1.0)))

#: Depth where a line ends that comes before the camera, relative to its deepest point.
NEAR = 1e-3

_ANGLES = 2 * np.pi * np.arange(24) / 24
_CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)


def marker(
    scene: Opened, row: int, pose: Pose, width: int, height: int
) -> list[NDArray[np.float64]]:
    """Closed lines ``(n, 2)`` that mark a Gaussian in a picture of this size, pixels.

    They are the outline of its splat at three standard deviations and a ring at its centre; none if
    it is behind the camera.
    """
    places, depth = pose.project(scene.positions[row][None], width, height)
    if not depth[0] > 0 or not np.isfinite(places).all():
        return []
    centre = places[0]
    outline = splat_outline(scene.gaussians, as_camera(pose.camera(width, height)), row)
    around = _LEAST * _CIRCLE if outline is None else _widened(outline - centre)
    return [centre + around, centre + _CENTRE * _CIRCLE]


def measure_lines(
    points: Sequence[NDArray], pose: Pose, width: int, height: int
) -> list[NDArray[np.float64]]:
    """Closed lines ``(n, 2)``, pixels: between two points if it is seen, and a ring at each."""
    if not len(points):
        return []
    ends = (np.array(points) - pose.position) @ pose.rotation.T
    front = ends[:, 2] > 0
    lines = []
    if len(ends) == 2 and front.any():
        if not front.all():  # cut where it comes before the camera
            behind, ahead = ends[np.argsort(front)]
            share = (1 - NEAR) * ahead[2] / (ahead[2] - behind[2])
            ends[np.argmin(front)] = ahead + share * (behind - ahead)
        lines.append(pose.project(ends @ pose.rotation + pose.position, width, height)[0])
    places = pose.project(np.array(points), width, height)[0][front]
    return [*lines, *(place + _POINT * _CIRCLE for place in places)]


def _widened(around: NDArray[np.float64]) -> NDArray[np.float64]:
    """An ellipse around 0 ``(n, 2)``, pushed outwards to a minimum distance from its centre."""
    margin = max(_LEAST - float(np.linalg.norm(around, axis=1).min()), 0.0)
    along = np.roll(around, -1, axis=0) - np.roll(around, 1, axis=0)
    across = np.stack([along[:, 1], -along[:, 0]], axis=1)
    length = np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    outwards = np.sign(np.sum(across * around, axis=1, keepdims=True))
    return around + margin * outwards * across / length


def draw_marker(canvas: Image.Image, lines: list[NDArray[np.float64]]) -> None:
    """Draw closed lines, light on dark, visible on any background."""
    pen = ImageDraw.Draw(canvas)
    for thickness, colour in LINES:
        fill = tuple(round(255 * c) for c in colour)
        for line in lines:
            closed = np.clip(np.concatenate([line, line[:2]]), -1e5, 1e5)
            pen.line([tuple(p) for p in closed.tolist()], fill, round(thickness), "curve")

"""Cubes: their faces and edges for the window, and drawn in software."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from viewer.pictures.layers import Legend
from viewer.scenes.pose import Pose

#: Brightness of the faces perpendicular to x, y and z, to distinguish them.
_SHADES = np.array([0.8, 1.0, 0.6], np.float32)

#: The upper face perpendicular to x of a unit cube, anticlockwise seen from outside.
_UPPER = np.array([[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]]) - 0.5
_LOWER = (_UPPER * [-1, 1, 1])[::-1]


@dataclass(frozen=True, eq=False)
class Cubes:
    """Axis-aligned cubes.

    Attributes
    ----------
    middles : ndarray, shape (n, 3), float32
    sides : ndarray, shape (n,), float32
    colours : ndarray, shape (n, 3), float32, 0-1
    legend : Legend or None
    filled : bool
        Whether faces are drawn as well as edges.
    """

    middles: NDArray[np.float32]
    sides: NDArray[np.float32]
    colours: NDArray[np.float32]
    legend: Legend | None = None
    filled: bool = True

    @property
    def boxes(self) -> NDArray[np.float32]:
        """Lowest and highest corner of each cube ``(n, 2, 3)``."""
        ends = np.array([-0.5, 0.5], np.float32)[:, None] * self.sides[:, None, None]
        return self.middles[:, None] + ends

    def faces(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Corners ``(6, n, 4, 3)``, anticlockwise from outside, and colours ``(6, n, 3)``."""
        units = [np.roll(face, axis, 1) for axis in range(3) for face in (_LOWER, _UPPER)]
        offsets = np.array(units, np.float32)[:, None] * self.sides[:, None, None]
        shades = _SHADES.repeat(2)[:, None, None] if self.filled else np.ones((6, 1, 1), np.float32)
        return self.middles[:, None] + offsets, shades * self.colours


def draw_cubes(canvas: Image.Image, cubes: Cubes, pose: Pose) -> None:
    """Draw the faces of cubes that face the camera, or all edges; nearest on top."""
    size = canvas.width, canvas.height
    ahead = pose.position - cubes.middles
    order = np.argsort(-np.linalg.norm(ahead, axis=1), kind="stable")
    # Lower faces face a camera below them, upper ones a camera above.
    beyond = np.stack([way * ahead[:, axis] for axis in range(3) for way in (-1, 1)])
    corners, colours = cubes.faces()
    drawn = beyond > cubes.sides / 2 if cubes.filled else np.ones_like(beyond, bool)
    cube, side = np.nonzero(drawn.T[order])
    some = side, order[cube]
    pixels, depth = pose.project(corners[some].reshape(-1, 3), *size)
    pixels, depth = pixels.reshape(-1, 4, 2), depth.reshape(-1, 4)
    seen = (depth > 0).all(axis=1) & (pixels.max(axis=1) >= 0).all(axis=1)
    seen &= (pixels.min(axis=1) < size).all(axis=1)
    pen = ImageDraw.Draw(canvas)
    polygons = np.clip(pixels[seen], -1e6, 1e6).reshape(-1, 8)
    shown = np.rint(255 * colours[some][seen]).astype(int)
    for polygon, colour in zip(polygons.tolist(), shown.tolist(), strict=True):
        rgb = tuple(colour)
        pen.polygon(polygon, *((rgb, None) if cubes.filled else (None, rgb)))

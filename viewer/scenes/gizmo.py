"""Handles for placing: arrows that move, rings that turn, a circle that scales."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import dist

import numpy as np
from numpy.typing import NDArray

from gs_codec.edit.motion import rotation
from viewer.scenes.pose import Pose
from viewer.scenes.region import Pixel

#: Length of the arrows, pixels; radii of rings and of the circle, relative to it; radius of the
#: handle in the middle, pixels.
_LENGTH = 90.0
_RING, _CIRCLE, _MIDDLE = 0.8, 1.2, 9.0

#: Maximum distance of the mouse from a handle, pixels.
_NEAR = 7.0

#: RGB of x, y and z, and of handles without an axis.
COLOURS = ((1.0, 0.3, 0.3), (0.35, 0.9, 0.35), (0.4, 0.6, 1.0), (1.0, 1.0, 1.0))

_ANGLES = 2 * np.pi * np.arange(64) / 64


@dataclass(frozen=True, eq=False)
class Handle:
    """A handle in a picture.

    Attributes
    ----------
    kind : {"shift", "move", "turn", "scale"}
        Move in the picture's plane or along an axis, turn about an axis, or scale.
    axis : int
        Index of the axis; 3 without one.
    line : ndarray, shape (n, 2)
        Closed line, pixels.
    """

    kind: str
    axis: int
    line: NDArray[np.float64]


class Gizmo:
    """The handles at a point, seen in a picture.

    Parameters
    ----------
    centre : ndarray, shape (3,)
    pose : Pose
    size : tuple of two int
        Width and height of the picture, pixels.
    """

    def __init__(self, centre: NDArray, pose: Pose, size: tuple[int, int]) -> None:
        self._centre, self._pose, self._size = np.asarray(centre, np.float64), pose, size
        self._lens = pose.lens(*size)
        depth = float((pose.rotation @ (self._centre - pose.position))[2])
        self._unit, self._depth = _LENGTH * depth / self._lens[0], depth
        self.handles: list[Handle] = []
        if depth > 0:
            self._place()

    def _place(self) -> None:
        circle = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
        self.middle = self._pixels(np.zeros((1, 3)))[0]
        self._add("shift", 3, self.middle + _MIDDLE * circle)
        for axis in range(3):
            self._add("move", axis, self._pixels(np.outer([0.15, 1.0], np.eye(3)[axis])))
        for axis in range(3):
            self._add("turn", axis, self._pixels(_RING * np.insert(circle, axis, 0, axis=1)))
        self._add("scale", 3, self.middle + _CIRCLE * _LENGTH * circle)

    def _add(self, kind: str, axis: int, line: NDArray) -> None:
        if np.isfinite(line).all():
            self.handles.append(Handle(kind, axis, line))

    def _pixels(self, offsets: NDArray) -> NDArray[np.float64]:
        """Pixels of points ``(n, 3)``, in lengths of arrows from the centre."""
        pixels, depth = self._pose.project(self._centre + self._unit * offsets, *self._size)
        return np.where((depth > 0)[:, None], pixels, np.nan)

    def at(self, place: Pixel) -> Handle | None:
        """The handle under the mouse."""
        far = [_distance(place, handle.line) for handle in self.handles]
        nearest = int(np.argmin(far)) if far else 0
        return self.handles[nearest] if far and far[nearest] <= _NEAR else None

    def dragged(self, handle: Handle, start: Pixel, place: Pixel) -> NDArray[np.float64]:
        """The matrix ``(4, 4)`` of a drag of a handle between two pixels."""
        drag = np.subtract(place, start)
        if handle.kind == "scale":
            factor = dist(place, self.middle) / max(dist(start, self.middle), 1e-6)
            return about(self._centre, factor=max(factor, 1e-3))
        if handle.kind == "shift":
            right, down = drag * self._depth / np.array(self._lens[:2])
            return about(
                self._centre, right * self._pose.rotation[0] + down * self._pose.rotation[1]
            )
        axis = np.eye(3)[handle.axis]
        if handle.kind == "move":
            along, least = handle.line[1] - handle.line[0], 0.1 * _LENGTH
            share = drag @ along / max(along @ along, least**2)
            return about(self._centre, 0.85 * self._unit * share * axis)
        # Along the ring where the mouse went down, at the ring's speed there.
        nearest = int(np.argmin(np.linalg.norm(handle.line - start, axis=1)))
        step = handle.line[(nearest + 1) % 64] - handle.line[nearest - 1]
        pace = step / (_ANGLES[2] * (-1 if handle.axis == 1 else 1))
        angle = drag @ pace / max(pace @ pace, (0.3 * _RING * _LENGTH) ** 2)
        return about(self._centre, angles=np.degrees(angle) * axis)


def about(
    centre: NDArray,
    shift: Sequence[float] | NDArray = (0.0, 0.0, 0.0),
    angles: Sequence[float] | NDArray = (0.0, 0.0, 0.0),
    factor: float = 1.0,
) -> NDArray[np.float64]:
    """The matrix ``(4, 4)`` that scales and turns about a centre, then shifts.

    `angles` are degrees about x, then y, then z, as in `gs_codec.edit.rotate`.
    """
    matrix = np.eye(4)
    matrix[:3, :3] = factor * rotation(np.asarray(angles).tolist())
    matrix[:3, 3] = np.asarray(shift) + centre - matrix[:3, :3] @ centre
    return matrix


def _distance(place: Pixel, line: NDArray) -> float:
    """Distance of a pixel from a closed line."""
    starts, along = line, np.roll(line, -1, axis=0) - line
    away = np.asarray(place) - starts
    share = np.einsum("nk,nk->n", away, along) / np.maximum((along**2).sum(axis=1), 1e-12)
    return float(np.linalg.norm(away - np.clip(share, 0, 1)[:, None] * along, axis=1).min())

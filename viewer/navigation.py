"""From moves of a mouse to poses: turn about a point ahead, shift, come nearer."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from viewer.layers import thinned
from viewer.pose import Pose

#: Angle of a drag over the height of the picture.
_TURN = np.pi

#: Steepest look up or down that turning reaches, radians.
_STEEPEST = np.radians(89)

#: Shorter than this, a part of a unit vector has no direction.
_LEVEL = 1e-6

#: What one step of the wheel leaves of the distance.
_NEARER = 0.9

#: Least distance, by what it was at first: there, the wheel pushes the point ahead on.
_LEAST = 0.02

#: Half the width of what is straight ahead, by its depth, and centres that are looked at for it.
_AHEAD, _SAMPLES = 0.25, 20_000


@dataclass(frozen=True)
class _Drag:
    """What is held: a pose, and where the mouse took it, pixels."""

    pose: Pose
    x: int
    y: int
    shifts: bool


class Navigator:
    """Where a mouse leads a camera.

    A drag is measured from the pose and the place where it began, so it ends at the same pose
    however many events it came in, and back at its start it is where it was.

    Attributes
    ----------
    up : ndarray, shape (3,)
        Unit vector that a look turns about; the horizon keeps its slope.
    distance : float
        From the camera to the point straight ahead that it turns about and comes nearer to.
    """

    def __init__(self) -> None:
        self.up = np.array([0.0, -1.0, 0.0])
        self.distance = self._least = 1.0
        self._drag: _Drag | None = None

    def aim(self, distance: float) -> None:
        """Turn about a point so far ahead from now on; ends a drag."""
        self.distance, self._least = distance, _LEAST * distance
        self._drag = None

    def hold(self, pose: Pose, x: int, y: int, shifts: bool = False) -> None:
        """Begin a drag that turns the camera, or shifts it."""
        self._drag = _Drag(pose, x, y, shifts)

    def release(self) -> None:
        """End a drag."""
        self._drag = None

    def drag(self, x: int, y: int, width: int, height: int) -> Pose | None:
        """The pose now that the mouse is at ``x, y``; of a picture of that size.

        None where nothing is held.
        """
        held = self._drag
        if held is None:
            return None
        if held.shifts:
            return self.shifted(held.pose, x - held.x, y - held.y, width, height)
        return self.turned(held.pose, (x - held.x) / height, (y - held.y) / height)

    def turned(self, pose: Pose, right: float, down: float) -> Pose:
        """Turned about the point ahead, as what is before it follows a drag, heights."""
        ahead, up = pose.rotation[2], self.up
        across = np.cross(ahead, up)
        steep = np.linalg.norm(across) < _LEVEL
        across = pose.rotation[0] if steep else across / np.linalg.norm(across)
        # Along the horizon and square to it, so that a rolled camera follows the mouse too.
        drag = right * pose.rotation[0] + down * pose.rotation[1]
        slope = np.arcsin(np.clip(ahead @ up, -1, 1))
        wanted = slope - _TURN * (drag @ np.cross(ahead, across))
        tilt = np.clip(wanted, min(-_STEEPEST, slope), max(_STEEPEST, slope)) - slope
        turn = _about(up, -_TURN * (drag @ across)) @ _about(across, tilt)
        centre = pose.position + self.distance * ahead
        return replace(
            pose,
            rotation=pose.rotation @ turn.T,
            position=centre - self.distance * (turn @ ahead),
        )

    def shifted(self, pose: Pose, right: int, down: int, width: int, height: int) -> Pose:
        """Shifted so that the point ahead follows a drag, pixels of a picture of that size."""
        lens = pose.intrinsics(width, height)
        moved = right / lens[0, 0] * pose.rotation[0] + down / lens[1, 1] * pose.rotation[1]
        return replace(pose, position=pose.position - self.distance * moved)

    def nearer(self, pose: Pose, steps: float) -> Pose:
        """So many steps of the wheel nearer; ends a drag."""
        self._drag = None
        left = self.distance * _NEARER**steps
        position = pose.position + (self.distance - left) * pose.rotation[2]
        self.distance = max(left, self._least)
        return replace(pose, position=position)


def distance_ahead(pose: Pose, positions: NDArray) -> float:
    """Median depth of the centres straight ahead; without any, the distance to their median."""
    some = positions[thinned(len(positions), _SAMPLES)].astype(np.float64)
    some = some[np.isfinite(some).all(axis=1)]
    x, y, depth = pose.rotation @ (some - pose.position).T
    seen = np.hypot(x, y) < _AHEAD * depth
    if seen.any():
        return float(np.median(depth[seen]))
    if not len(some):
        return 1.0
    return float(np.linalg.norm(np.median(some, axis=0) - pose.position)) or 1.0


def _about(axis: NDArray, angle: float) -> NDArray[np.float64]:
    return o3d.geometry.get_rotation_matrix_from_axis_angle(angle * axis)

"""Mouse navigation: turn about a point ahead, shift, move nearer."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from viewer.scenes.pose import Pose

#: Angle of a drag as long as the picture is high, radians.
_TURN = np.pi

#: Steepest view up or down that turning reaches, radians.
_STEEPEST = np.radians(89)

#: Components of unit vectors shorter than this have no reliable direction.
_LEVEL = 1e-6

#: Factor on the distance for one step of the wheel.
_NEARER = 0.9

#: Least distance, relative to the first; at it, the wheel also moves the point ahead.
_LEAST = 0.02


@dataclass(frozen=True)
class _Drag:
    """A drag: the pose and the mouse position (pixels) at its start."""

    pose: Pose
    x: int
    y: int
    shifts: bool


class Navigator:
    """Moves a camera by the mouse.

    A drag is measured from its start, so the resulting pose does not depend on the number of
    events, and dragging back to the start restores the pose.

    Attributes
    ----------
    up : ndarray, shape (3,)
        Unit vector about which the view turns; the horizon keeps its slope.
    distance : float
        Distance to the point straight ahead, about which the camera turns and towards which it
        moves.
    """

    def __init__(self) -> None:
        self.up = np.array([0.0, -1.0, 0.0])
        self.distance = self._least = 1.0
        self._drag: _Drag | None = None

    def aim(self, distance: float) -> None:
        """Set the distance of the point ahead; ends a drag."""
        self.distance, self._least = distance, _LEAST * distance
        self._drag = None

    def hold(self, pose: Pose, x: int, y: int, shifts: bool = False) -> None:
        """Begin a drag that turns the camera, or shifts it."""
        self._drag = _Drag(pose, x, y, shifts)

    def release(self) -> None:
        """End a drag."""
        self._drag = None

    def drag(self, x: int, y: int, width: int, height: int) -> Pose | None:
        """The pose for a mouse at ``x, y`` in a picture of this size; None without a drag."""
        held = self._drag
        if held is None:
            return None
        if held.shifts:
            return self.shifted(held.pose, x - held.x, y - held.y, width, height)
        return self.turned(held.pose, (x - held.x) / height, (y - held.y) / height)

    def turned(self, pose: Pose, right: float, down: float) -> Pose:
        """The pose turned about the point ahead by a drag, in heights of the picture."""
        ahead, up = pose.rotation[2], self.up
        across = np.cross(ahead, up)
        steep = np.linalg.norm(across) < _LEVEL
        across = pose.rotation[0] if steep else across / np.linalg.norm(across)
        # Split the drag along and across the horizon, so that a rolled camera follows the mouse.
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
        """The pose shifted so that the point ahead follows a drag, pixels of the picture."""
        lens = pose.intrinsics(width, height)
        moved = right / lens[0, 0] * pose.rotation[0] + down / lens[1, 1] * pose.rotation[1]
        return replace(pose, position=pose.position - self.distance * moved)

    def nearer(self, pose: Pose, steps: float) -> Pose:
        """The pose moved nearer by steps of the wheel; ends a drag."""
        self._drag = None
        left = self.distance * _NEARER**steps
        position = pose.position + (self.distance - left) * pose.rotation[2]
        self.distance = max(left, self._least)
        return replace(pose, position=position)


def _about(axis: NDArray, angle: float) -> NDArray[np.float64]:
    return o3d.geometry.get_rotation_matrix_from_axis_angle(angle * axis)

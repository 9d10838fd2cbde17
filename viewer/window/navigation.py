"""Navigation: orbit the point ahead, look around, shift, zoom, fly."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from viewer.scenes.pose import Pose

#: Angle of a drag over the height of the picture, radians.
_TURN = np.pi

#: Maximum elevation when turning, radians.
_STEEPEST = np.radians(89)

#: Projections of unit vectors that are shorter than this have no reliable direction.
_LEVEL = 1e-6

#: Factor for the distance per step of the wheel.
_NEARER = 0.9

#: Minimum distance, relative to the first; below it, the wheel also moves the point ahead.
_LEAST = 0.02

#: Minimum opacity of the centres that framing shows.
_SEEN = 0.1

#: Quantiles of their coordinates that framing shows.
_MOST_OF = (0.02, 0.98)

#: Extent of a Gaussian from its centre, standard deviations.
_SIGMAS = 3.0

#: Kinds of drag: orbit the point ahead, look around from the camera's position, or shift it.
DragKind = Literal["turn", "look", "shift"]


@dataclass(frozen=True)
class _Drag:
    """A drag: the pose and the mouse position (pixels) at its start."""

    pose: Pose
    x: int
    y: int
    kind: DragKind


class Navigator:
    """Moves a camera by mouse and keys.

    A drag is measured from its start, so the resulting pose does not depend on the number of
    events, and dragging back to the start restores the pose.

    Attributes
    ----------
    up : ndarray, shape (3,)
        Unit vector around which the view turns; the horizon keeps its slope.
    distance : float
        Distance to the point straight ahead, which the camera orbits and moves towards.
    """

    def __init__(self) -> None:
        self.up = np.array([0.0, -1.0, 0.0])
        self.distance = self._least = 1.0
        self._drag: _Drag | None = None

    def aim(self, distance: float) -> None:
        """Set the distance of the point ahead, and end any drag."""
        self.distance, self._least = distance, _LEAST * distance
        self._drag = None

    def hold(self, pose: Pose, x: int, y: int, kind: DragKind = "turn") -> None:
        """Begin a drag."""
        self._drag = _Drag(pose, x, y, kind)

    def release(self) -> None:
        """End a drag."""
        self._drag = None

    def drag(self, x: int, y: int, width: int, height: int) -> Pose | None:
        """The pose for the mouse at ``x, y`` in a picture of this size; None without a drag."""
        held = self._drag
        if held is None:
            return None
        if held.kind == "shift":
            return self.shifted(held.pose, x - held.x, y - held.y, width, height)
        right, down = (x - held.x) / height, (y - held.y) / height
        if held.kind == "turn":
            return self.turned(held.pose, right, down, self.distance)
        # The point in the middle of the picture follows the mouse.
        angle = height / held.pose.lens(width, height)[1] / _TURN
        return self.turned(held.pose, -angle * right, -angle * down, 0.0)

    def turned(self, pose: Pose, right: float, down: float, distance: float) -> Pose:
        """The pose turned around the point at a distance by a drag, in picture heights."""
        ahead, up = pose.rotation[2], self.up
        across = np.cross(ahead, up)
        steep = np.linalg.norm(across) < _LEVEL
        across = pose.rotation[0] if steep else across / np.linalg.norm(across)
        # Split the drag along and across the horizon, so that the view of a rolled camera follows
        # the mouse.
        drag = right * pose.rotation[0] + down * pose.rotation[1]
        slope = np.arcsin(np.clip(ahead @ up, -1, 1))
        wanted = slope - _TURN * (drag @ np.cross(ahead, across))
        tilt = np.clip(wanted, min(-_STEEPEST, slope), max(_STEEPEST, slope)) - slope
        turn = _about(up, -_TURN * (drag @ across)) @ _about(across, tilt)
        return replace(
            pose,
            rotation=pose.rotation @ turn.T,
            position=pose.position + distance * (ahead - turn @ ahead),
        )

    def shifted(self, pose: Pose, right: int, down: int, width: int, height: int) -> Pose:
        """The pose shifted so that the point ahead follows a drag in pixels of the picture."""
        lens = pose.intrinsics(width, height)
        moved = right / lens[0, 0] * pose.rotation[0] + down / lens[1, 1] * pose.rotation[1]
        return replace(pose, position=pose.position - self.distance * moved)

    def nearer(self, pose: Pose, steps: float) -> Pose:
        """The pose moved nearer by steps of the wheel; ends any drag."""
        self._drag = None
        left = self.distance * _NEARER**steps
        position = pose.position + (self.distance - left) * pose.rotation[2]
        self.distance = max(left, self._least)
        return replace(pose, position=position)

    def flown(self, pose: Pose, thrust: NDArray, seconds: float) -> Pose:
        """The pose after a flight along the camera's axes, in distances ahead per second."""
        return replace(
            pose, position=pose.position + seconds * self.distance * (thrust @ pose.rotation)
        )


def focused(pose: Pose, pixel: tuple[float, float], depth: float, size: tuple[int, int]) -> Pose:
    """The pose shifted so that the point at a pixel and depth moves to the picture's middle."""
    fx, fy, _, _ = pose.lens(*size)
    offset = (pixel[0] - size[0] / 2) / fx, (pixel[1] - size[1] / 2) / fy
    shift = depth * (offset[0] * pose.rotation[0] + offset[1] * pose.rotation[1])
    return replace(pose, position=pose.position + shift)


def framing(
    pose: Pose, positions: NDArray, opacities: NDArray, lengths: NDArray
) -> tuple[Pose, float]:
    """The pose moved until its frame shows the scene, and the distance of the scene's middle.

    Far and nearly transparent centres may be outside. `lengths` are those of the longest axes.
    """
    finite = np.isfinite(positions).all(axis=1) & np.isfinite(lengths)
    some = finite & (opacities >= _SEEN)
    some = some if some.any() else finite
    centres = positions[some].astype(np.float64)
    if not len(centres):
        return pose, 1.0
    low, high = np.quantile(centres, _MOST_OF, axis=0)
    large = _SIGMAS * float(np.median(lengths[some]))  # more than the centres' box in tiny scenes
    reach = max(float(np.linalg.norm(high - low)) / 2, large) or 1.0
    sides = 2 * pose.focal[0] * pose.frame[1] / pose.frame[0], 2 * pose.focal[1]
    distance = reach * float(np.hypot(1.0, max(sides)))
    middle = (low + high) / 2
    return replace(pose, position=middle - distance * pose.rotation[2]), distance


def field_of_view(pose: Pose) -> float:
    """The vertical field of view of the frame, degrees."""
    return float(np.degrees(2 * np.arctan(0.5 / pose.focal[1])))


def with_field_of_view(pose: Pose, degrees: float) -> Pose:
    """The pose with another `field_of_view`."""
    factor = 0.5 / np.tan(np.radians(degrees) / 2) / pose.focal[1]
    return replace(pose, focal=(pose.focal[0] * factor, pose.focal[1] * factor))


def _about(axis: NDArray, angle: float) -> NDArray[np.float64]:
    return o3d.geometry.get_rotation_matrix_from_axis_angle(angle * axis)

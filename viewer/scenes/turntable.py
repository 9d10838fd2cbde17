"""The camera path of a turntable: once around a scene, in the style of its cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.clean import SOLID, solid_gaussians
from gs_codec.coding.neighbours import Neighbours
from viewer.scenes.opened import Opened, thinned
from viewer.scenes.pose import Pose, distance_ahead, look_at, of_camera
from viewer.scenes.viewpoints import Views

#: Minimum number of cameras from which to infer how a scene was captured.
_TELLING = 8

#: Threshold of the cosine between viewing directions and the middle; the scene was captured looking
#: outward if over a quarter of its cameras are below.
_INWARD = 0.5

#: Maximum gap between cameras, degrees, for a capture all around the scene.
_GAP = 140.0

#: Maximum elevation of a view of the centre, degrees.
_STEEPEST = 80.0

#: Maximum elevation when looking around from inside, degrees.
_LEVEL = 20.0

#: Share of the cameras' range of angles that a sway covers.
_SHARE = 0.8

#: Minimum sway horizontally and vertically, degrees.
_LEAST = (5.0, 2.5)

#: Number of centres used to measure the free space around a position.
_SAMPLES = 20_000

#: Share of them that may be nearer than that.
_NEARER = 0.01

#: Number of phases of a loop tried for its start.
_PHASES = 360


class _Capture(NamedTuple):
    """Positions of cameras around the middle of their subject.

    Attributes
    ----------
    poses : list of Pose
    middle, up : ndarray, shape (3,)
    axes : ndarray, shape (2, 3)
        Horizontal unit vectors.
    distance, azimuth, elevation : ndarray, shape (n,)
        Cameras as seen from the middle; angles in radians.
    inward : ndarray, shape (n,)
        Cosine between a camera's viewing direction and the middle, or down if that is larger.
    """

    poses: list[Pose]
    middle: NDArray[np.float64]
    up: NDArray[np.float64]
    axes: NDArray[np.float64]
    distance: NDArray[np.float64]
    azimuth: NDArray[np.float64]
    elevation: NDArray[np.float64]
    inward: NDArray[np.float64]

    def direction(self, azimuth: float, elevation: float) -> NDArray[np.float64]:
        """The unit vector with an azimuth and elevation, radians."""
        level = np.cos(azimuth) * self.axes[0] + np.sin(azimuth) * self.axes[1]
        return np.cos(elevation) * level + np.sin(elevation) * self.up

    @property
    def widest_gap(self) -> tuple[float, float]:
        """Largest angle between neighbouring cameras, radians, and the azimuth at its end."""
        azimuths = np.sort(self.azimuth)
        gaps = np.diff(azimuths, append=azimuths[0] + 2 * np.pi)
        widest = int(np.argmax(gaps))
        return float(gaps[widest]), float(azimuths[(widest + 1) % len(azimuths)])


def turntable(
    scene: Opened, views: Views, up: NDArray, first: Pose | None, count: int
) -> tuple[list[Pose], str]:
    """Poses once around a scene, and a description of the path.

    The camera circles around the middle of the cameras' subject. If cameras look outward, as in
    rooms, it turns on the spot, at the camera with the most free space. If all cameras are on one
    side, it sways within their range.

    Parameters
    ----------
    scene : Opened
    views : Views
        Cameras from which to infer how the scene was captured.
    up : ndarray, shape (3,)
        Unit vector.
    first : Pose or None
        First pose of the path; a circle keeps its distance and height. Default: that of a typical
        camera.
    count : int
        At least 1.
    """
    poses = [of_camera(camera) for camera in views.cameras]
    capture = _captured(scene, poses or [first or Pose(np.eye(3), np.zeros(3))], up)
    typical = capture.poses[0] if views.chosen else _typical(capture)
    first = first or typical
    path, described = _path(scene, capture, views.chosen, first)
    start = _nearest_phase(path, first, float(np.median(capture.distance)))
    return [path(start + k / count) for k in range(count)], described


def _path(
    scene: Opened, capture: _Capture, chosen: bool, first: Pose
) -> tuple[Callable[[float], Pose], str]:
    """The pose at each phase of a loop, 0-1, and a description of the path."""
    if len(capture.poses) >= _TELLING:
        if np.quantile(capture.inward, 0.25) < _INWARD:
            return _panning(scene, capture, first), "a look around from inside, as cameras look out"
        if capture.widest_gap[0] > np.radians(_GAP):
            return _swaying(capture, first), "a sway, as cameras saw it from one side"
    middle = capture.middle
    if chosen or len(capture.poses) < _TELLING:
        middle = first.position + distance_ahead(first, scene.positions) * first.rotation[2]
    return _circling(capture, first, middle), "once around"


def _captured(scene: Opened, poses: list[Pose], up: NDArray) -> _Capture:
    """Cameras around the median of the points straight ahead of them."""
    positions = np.array([pose.position for pose in poses])
    forward = np.array([pose.rotation[2] for pose in poses])
    ahead = np.array([distance_ahead(pose, scene.positions) for pose in poses])
    middle = np.median(positions + ahead[:, None] * forward, axis=0)
    across = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    across /= np.linalg.norm(across)
    axes = np.stack([across, np.cross(up, across)])
    offsets = positions - middle
    distance = np.maximum(np.linalg.norm(offsets, axis=1), 1e-9)
    azimuth = np.arctan2(offsets @ axes[1], offsets @ axes[0])
    elevation = np.arcsin(np.clip(offsets @ up / distance, -1, 1))
    inward = np.maximum(-np.einsum("ni,ni->n", offsets, forward) / distance, -forward @ up)
    return _Capture(poses, middle, up, axes, distance, azimuth, elevation, inward)


def _typical(capture: _Capture) -> Pose:
    """The camera at about the median distance and elevation."""
    far = np.abs(np.log(capture.distance / np.median(capture.distance)))
    high = np.abs(capture.elevation - np.median(capture.elevation))
    return capture.poses[int(np.argmin(far + high))]


def _circling(capture: _Capture, first: Pose, middle: NDArray) -> Callable[[float], Pose]:
    """A circle around the up axis through the first pose, looking at the middle."""
    offset = first.position - middle
    distance = float(np.linalg.norm(offset))
    steepest = np.radians(_STEEPEST)
    height = offset @ capture.up / max(distance, 1e-9)
    elevation = np.clip(np.arcsin(np.clip(height, -1, 1)), -steepest, steepest)
    azimuth = np.arctan2(offset @ capture.axes[1], offset @ capture.axes[0])

    def at(part: float) -> Pose:
        away = capture.direction(azimuth + 2 * np.pi * part, elevation)
        return _like(first, look_at(middle + distance * away, middle, capture.up))

    return at


def _panning(scene: Opened, capture: _Capture, first: Pose) -> Callable[[float], Pose]:
    """A turn on the spot, at the camera with the most free space around it."""
    finite = np.isfinite(scene.positions).all(axis=1)
    solid = scene.positions[solid_gaussians(scene.opacities, finite, SOLID)]
    solid = solid[thinned(len(solid), _SAMPLES)]
    positions = np.array([pose.position for pose in capture.poses])
    place = first.position
    if len(solid):
        room, _ = Neighbours(solid).nearest(positions, 1 + int(_NEARER * len(solid)))
        place = positions[int(np.argmax(room[:, -1]))]
    forward = np.array([pose.rotation[2] for pose in capture.poses])
    level = np.radians(_LEVEL)
    slope = np.clip(np.median(np.arcsin(np.clip(forward @ capture.up, -1, 1))), -level, level)

    def at(part: float) -> Pose:
        ahead = capture.direction(2 * np.pi * part, slope)
        return _like(first, look_at(place, place + ahead, capture.up))

    return at


def _swaying(capture: _Capture, first: Pose) -> Callable[[float], Pose]:
    """An ellipse within the range of the cameras' angles, looking at the middle."""
    gap, begin = capture.widest_gap
    covered = 2 * np.pi - gap
    low, high = np.quantile(capture.elevation, [0.1, 0.9])
    across, up = np.maximum(_SHARE * np.array([covered, high - low]), np.radians(_LEAST)) / 2
    distance = float(np.median(capture.distance))

    def at(part: float) -> Pose:
        angle = 2 * np.pi * part
        azimuth = begin + covered / 2 + across * np.sin(angle)
        away = capture.direction(azimuth, (low + high) / 2 + up * np.cos(angle))
        place = capture.middle + distance * away
        return _like(first, look_at(place, capture.middle, capture.up))

    return at


def _like(first: Pose, pose: Pose) -> Pose:
    """The pose with the lens and frame of the first."""
    return replace(first, rotation=pose.rotation, position=pose.position)


def _nearest_phase(path: Callable[[float], Pose], first: Pose, size: float) -> float:
    """The phase of a loop that is most similar to the first pose."""
    phases = np.arange(_PHASES) / _PHASES

    def difference(pose: Pose) -> float:
        moved = np.linalg.norm(pose.position - first.position) / size
        turned = np.linalg.norm(pose.rotation[2] - first.rotation[2])
        return float(moved + turned)

    return float(phases[int(np.argmin([difference(path(phase)) for phase in phases]))])

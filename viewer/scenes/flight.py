"""Camera paths: poses to pass, each at its time, and the smooth flight through them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import gs_codec
from gs_codec.cameras.inria import as_camera
from gs_codec.cameras.keyframes import Keyframes, read_keyframes, write_keyframes
from gs_codec.runtime.optional import needed
from gs_codec.runtime.wording import counted
from viewer.scenes.pose import Pose, of_camera

#: Default frames per second.
FPS = 24

#: Maximum number of frames of a film.
MOST = 99_999

#: Time from pose to pose on average, if a path has no times, seconds.
LEG = 2.0

#: Minimum time from pose to pose, seconds; it keeps times increasing.
LEAST = 1e-3


@dataclass(frozen=True, eq=False)
class CameraPath:
    """A flight through poses.

    The way is a smooth curve that does not depend on times: positions follow a cubic curve,
    rotations a cubic spline, lenses are interpolated linearly. Times set how far the camera is on
    it; equal successive poses are a pause, before which it slows down. All poses of the flight have
    the frame of the first.

    Attributes
    ----------
    poses : tuple of Pose
    times : tuple of float
        Time of each pose, seconds: 0 first, then increasing.
    fps : int
        Frames per second of films.
    """

    poses: tuple[Pose, ...] = ()
    times: tuple[float, ...] = ()
    fps: int = FPS

    @property
    def seconds(self) -> float:
        """Duration."""
        return self.times[-1] if self.times else 0.0

    def frames(self, count: int | None = None) -> list[Pose]:
        """Poses of the frames of a film, from the first pose to the last; at least two.

        Raises
        ------
        gs_codec.GsCodecError
            If there are more than `MOST`.
        """
        count = max(round(self.seconds * self.fps) + 1, 2) if count is None else count
        if count > MOST:
            raise gs_codec.GsCodecError(f"{counted(count, 'frame')}, expected at most {MOST:,}")
        return self.at(np.linspace(0, self.seconds, count))

    def at(self, times: Sequence[float] | NDArray) -> list[Pose]:
        """The poses at times, clipped to the flight; two poses are needed."""
        return self._flight(np.clip(times, 0, self.seconds))

    @cached_property
    def _flight(self) -> Callable[[NDArray], list[Pose]]:
        fits = needed("scipy.interpolate", "a camera path")
        transform = needed("scipy.spatial.transform", "a camera path")
        steps = _distances(self.poses)
        progress = fits.PchipInterpolator(self.times, np.concatenate([[0], np.cumsum(steps)]))
        way = [self.poses[0], *(p for p, step in zip(self.poses[1:], steps, strict=True) if step)]
        if len(way) == 1:
            return lambda times: [self.poses[0]] * len(times)
        knots = np.concatenate([[0], np.cumsum(steps[steps > 0])])
        places = np.array([pose.position for pose in way])
        curve = fits.CubicHermiteSpline(knots, places, _slopes(knots, places))
        turns = transform.Rotation.from_matrix(np.array([pose.rotation for pose in way]))
        spline = transform.RotationSpline(knots, turns)
        near = min(pose.near for pose in way)
        lenses = np.array([(*pose.focal, *pose.shift) for pose in way])

        def at(times: NDArray) -> list[Pose]:
            along = progress(times)
            lens = np.stack([np.interp(along, knots, column) for column in lenses.T], axis=1)
            return [
                Pose(turn, place, (fx, fy), way[0].frame, (x, y), near)
                for turn, place, (fx, fy, x, y) in zip(
                    spline(along).as_matrix(), curve(along), lens.tolist(), strict=True
                )
            ]

        return at

    @property
    def keys(self) -> dict[float, Pose]:
        """The poses by their times."""
        return dict(zip(self.times, self.poses, strict=True))

    def with_keys(self, keys: Mapping[float, Pose]) -> CameraPath:
        """The path with these poses at these times instead; it begins at 0."""
        times = sorted(keys)
        poses = tuple(keys[time] for time in times)
        return replace(self, poses=poses, times=tuple(time - times[0] for time in times))

    def retimed(self, index: int, time: float) -> CameraPath:
        """The path with another time for a pose but the first, between its neighbours."""
        ends = (-np.inf, *self.times, np.inf)
        time = float(np.clip(time, ends[index] + LEAST, ends[index + 2] - LEAST))
        return replace(self, times=(*self.times[:index], time, *self.times[index + 1 :]))


def evenly(poses: Sequence[Pose], seconds: float | None = None, fps: int = FPS) -> CameraPath:
    """A path at an even speed, in turns and moves; by default `LEG` seconds for each pose.

    A repeated pose takes a little time.
    """
    if not poses:
        return CameraPath(fps=fps)
    steps = _distances(poses)
    steps = np.maximum(steps, 0.1 * float(steps.mean()) or 1.0) if len(steps) else steps
    seconds = LEG * len(steps) if seconds is None else seconds
    times = np.concatenate([[0.0], np.cumsum(steps)])
    return CameraPath(tuple(poses), tuple((times * seconds / (times[-1] or 1.0)).tolist()), fps)


def read_path(path: Path, seconds: float | None = None) -> CameraPath:
    """Read the path of nerfstudio or SuperSplat, or one at an even speed through other cameras.

    `seconds` is the duration of a path without times, as in `evenly`.

    Raises
    ------
    gs_codec.GsCodecError
        If the file cannot be read; see `read_keyframes`.
    """
    found = read_keyframes(path)
    poses, fps = [of_camera(camera) for camera in found.cameras], found.fps or FPS
    if found.times is None:
        return evenly(poses, seconds, fps)
    times = np.asarray(found.times)
    if np.diff(times).min(initial=1) < LEAST:  # a cut
        times = times + LEAST * np.arange(len(times))
    return CameraPath(tuple(poses), tuple(times.tolist()), fps)


def write_path(path: Path, flight: CameraPath) -> None:
    """Write a path as its keyframes and all its frames, atomically; see `write_keyframes`.

    Raises
    ------
    gs_codec.GsCodecError
        If there are fewer than two poses, or too many frames, or they cannot be written.
    """
    if len(flight.poses) < 2:
        raise gs_codec.GsCodecError("a camera path needs two poses")
    cameras, frames = (
        [as_camera(pose.camera(*pose.frame)) for pose in poses]
        for poses in (flight.poses, flight.frames())
    )
    write_keyframes(path, Keyframes(cameras, flight.times, flight.fps), frames)


def _distances(poses: Sequence[Pose]) -> NDArray[np.float64]:
    """How far the camera moves and turns from pose to pose, each relative to the mean."""
    places = np.array([pose.position for pose in poses])
    axes = np.array([pose.rotation for pose in poses])
    moves = np.linalg.norm(np.diff(places, axis=0), axis=1)
    cosines = (np.einsum("nij,nij->n", axes[1:], axes[:-1]) - 1) / 2
    turns = np.arccos(np.clip(cosines, -1, 1 - 1e-12)) - np.arccos(1 - 1e-12)
    steps = sum(each / (each.mean() or 1.0) for each in (moves, turns)) if len(moves) else moves
    return np.where(steps > 1e-6, steps, 0.0)


def _slopes(knots: NDArray, positions: NDArray) -> NDArray[np.float64]:
    """Velocity at each position: that of the parabola through it and its neighbours."""
    steps = np.diff(knots)[:, None]
    speeds = np.diff(positions, axis=0) / steps
    inner = (speeds[:-1] * steps[1:] + speeds[1:] * steps[:-1]) / (steps[:-1] + steps[1:])
    return np.concatenate([speeds[:1], inner, speeds[-1:]])

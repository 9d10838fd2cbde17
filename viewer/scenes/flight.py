"""A smooth camera path through poses, and poses in files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import gs_codec
from gs_codec.cameras.inria import as_camera
from gs_codec.runtime.optional import needed
from viewer.scenes.pose import Pose, of_camera


def write_poses(path: Path, poses: Sequence[Pose]) -> None:
    """Write poses, in order, as a ``cameras.json``; atomically.

    Raises
    ------
    gs_codec.GsCodecError
        If there are none, or they cannot be written.
    """
    named = enumerate(poses, 1)
    gs_codec.write_cameras(
        path,
        [as_camera(pose.camera(*pose.frame) | {"img_name": f"pose {k:03d}"}) for k, pose in named],
    )


def read_poses(path: Path) -> list[Pose]:
    """Read the poses of all cameras of a file, in order.

    Raises
    ------
    gs_codec.GsCodecError
        If the file cannot be read; see `gs_codec.read_cameras`.
    """
    return [of_camera(camera) for camera in gs_codec.read_cameras(path)]


def flythrough(poses: Sequence[Pose], count: int) -> list[Pose]:
    """Poses on a smooth path from the first to the last, through all others.

    Positions follow a cubic curve, rotations a cubic spline; lenses are interpolated linearly. Time
    is proportional to how far the camera moves and turns, so its speed is even. All poses have the
    frame of the first.

    Parameters
    ----------
    poses : sequence of Pose
        At least two.
    count : int
        At least 2.
    """
    curve = needed("scipy.interpolate", "flythrough").CubicHermiteSpline
    transform = needed("scipy.spatial.transform", "flythrough")
    positions = np.array([pose.position for pose in poses])
    rotations = transform.Rotation.from_matrix(np.array([pose.rotation for pose in poses]))
    knots = _times(positions, (rotations[1:] * rotations[:-1].inv()).magnitude())
    times = np.linspace(0, knots[-1], count)
    places = curve(knots, positions, _slopes(knots, positions))(times)
    turns = transform.RotationSpline(knots, rotations)(times).as_matrix()
    lenses = np.array([(*pose.focal, *pose.shift) for pose in poses])
    lens = np.stack([np.interp(times, knots, column) for column in lenses.T], axis=1)
    return [
        Pose(turn, place, (fx, fy), poses[0].frame, (x, y))
        for turn, place, (fx, fy, x, y) in zip(turns, places, lens.tolist(), strict=True)
    ]


def _times(positions: NDArray, turns: NDArray) -> NDArray[np.float64]:
    """Time of each position on a path; a repeated pose takes a little time."""
    moves = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    steps = moves / (moves.mean() or 1.0) + turns / (turns.mean() or 1.0)
    least = 0.1 * float(steps.mean()) or 1.0
    return np.concatenate([[0.0], np.cumsum(np.maximum(steps, least))])


def _slopes(knots: NDArray, positions: NDArray) -> NDArray[np.float64]:
    """Velocity at each position: that of the parabola through it and its neighbours."""
    steps = np.diff(knots)[:, None]
    speeds = np.diff(positions, axis=0) / steps
    inner = (speeds[:-1] * steps[1:] + speeds[1:] * steps[:-1]) / (steps[:-1] + steps[1:])
    return np.concatenate([speeds[:1], inner, speeds[-1:]])

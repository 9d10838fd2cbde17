"""Keyframes of a camera path: cameras to pass, each at its time.

Files have the layout of nerfstudio's camera paths: its viewer opens the keyframes, ``ns-render``
and `read_cameras` take the frames between them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from gs_codec.cameras.camera import Camera
from gs_codec.cameras.camera_files import cameras_of, read_cameras
from gs_codec.cameras.camera_paths import read_camera_path, read_supersplat
from gs_codec.cameras.json_fields import as_list, as_number, load_json, short
from gs_codec.errors import InvalidInput
from gs_codec.runtime.atomic import atomic_writer

#: Frames per second of SuperSplat's and nerfstudio's files that state none.
_FPS = 30

#: Seconds from keyframe to keyframe in nerfstudio's files that state none.
_STEP = 2.0

#: Range of frames per second.
FPS = range(1, 121)


@dataclass(frozen=True, eq=False)
class Keyframes:
    """Cameras that a path passes.

    Attributes
    ----------
    cameras : sequence of Camera
    times : sequence of float, or None
        Time of each camera, seconds, not decreasing; None if the file has none.
    fps : int or None
        Frames per second; None if the file has none.
    """

    cameras: Sequence[Camera]
    times: Sequence[float] | None = None
    fps: int | None = None


def read_keyframes(path: Path) -> Keyframes:
    """Read the keyframes of nerfstudio's and SuperSplat's files; all cameras of other files.

    Old files of nerfstudio, whose keyframes have no matrix, give all frames. Raises InvalidInput
    like `read_cameras`, or if times are wrong.
    """
    whole = load_json(path) if path.suffix.lower() == ".json" and path.is_file() else None
    if not isinstance(whole, dict):
        return Keyframes(read_cameras(path))
    if "camera_path" in whole:
        return _nerfstudio(path, whole)
    if whole.get("animTracks"):
        return _supersplat_track(path, whole)
    if whole.get("poseSets"):
        return _supersplat_poses(path, whole)
    return Keyframes(read_cameras(path))


def _nerfstudio(path: Path, whole: dict[str, Any]) -> Keyframes:
    fps, keyframes, where = _fps(path, "fps", whole.get("fps")), whole.get("keyframes"), str(path)
    if isinstance(keyframes, list) and keyframes and all(map(_has_matrix, keyframes)):
        if whole.get("is_cycle"):
            keyframes = [*keyframes, keyframes[0]]
        frames = [each | {"camera_to_world": each["matrix"]} for each in keyframes]
        steps = [_step(where, whole, each) for each in keyframes[1:]]
    else:
        frames = as_list(where, "camera_path", whole["camera_path"])
        steps = [1 / fps] * (len(frames) - 1)
    cameras = cameras_of(path, read_camera_path(path, whole | {"camera_path": frames}))
    return Keyframes(cameras, _ordered(path, accumulate(steps, initial=0.0)), fps)


def _has_matrix(keyframe: Any) -> bool:
    return isinstance(keyframe, dict) and isinstance(keyframe.get("matrix"), list)


def _step(where: str, whole: dict[str, Any], keyframe: dict[str, Any]) -> float:
    """Seconds from the keyframe before to this one."""
    key, source = "default_transition_sec", whole
    if keyframe.get("override_transition_enabled"):
        key, source = "override_transition_sec", keyframe
    return as_number(where, key, source.get(key, _STEP))


def _supersplat_track(path: Path, whole: dict[str, Any]) -> Keyframes:
    """The first track; the first view is not part of it."""
    tracks = as_list(str(path), "animTracks", whole["animTracks"])[:1]
    cameras = cameras_of(
        path, read_supersplat(path, whole | {"animTracks": tracks, "cameras": [], "poseSets": []})
    )
    fps = _fps(path, "frameRate", tracks[0].get("frameRate"))
    frames = tracks[0]["keyframes"]["times"]
    return Keyframes(cameras, _seconds(path, frames, fps), fps)


def _supersplat_poses(path: Path, whole: dict[str, Any]) -> Keyframes:
    """The poses of the first set of a project, which may have frame numbers."""
    sets = as_list(str(path), "poseSets", whole["poseSets"])[:1]
    cameras = cameras_of(
        path, read_supersplat(path, whole | {"poseSets": sets, "cameras": [], "animTracks": []})
    )
    timeline, frames = whole.get("timeline"), [pose.get("frame") for pose in sets[0]["poses"]]
    rate = timeline.get("frameRate") if isinstance(timeline, dict) else None
    fps = _fps(path, "frameRate", rate)
    return Keyframes(cameras, None if None in frames else _seconds(path, frames, fps), fps)


def _fps(path: Path, key: str, value: Any) -> int:
    number = _FPS if value is None else as_number(str(path), key, value)
    if round(number) not in FPS:
        raise InvalidInput(f"{path}: {key} {short(number)}, expected {FPS[0]} to {FPS[-1]}")
    return round(number)


def _seconds(path: Path, frames: Sequence[Any], fps: int) -> list[float]:
    return _ordered(path, [as_number(str(path), "times", frame) / fps for frame in frames])


def _ordered(path: Path, times: Any) -> list[float]:
    """Times from 0, as given; they must not decrease."""
    times = list(times)
    if any(later < earlier for earlier, later in pairwise(times)):
        raise InvalidInput(f"{path}: times of keyframes decrease")
    return [time - times[0] for time in times]


def write_keyframes(path: Path, keyframes: Keyframes, frames: Sequence[Camera]) -> None:
    """Write keyframes with times, and all frames of the path, atomically.

    Only vertical fields of view are stored: principal points become the middle, and pixels square.
    """
    assert keyframes.times is not None
    first, steps = keyframes.cameras[0], np.diff(keyframes.times, prepend=0.0)
    head = {
        "camera_type": "perspective",
        "render_width": first.width,
        "render_height": first.height,
        "fps": keyframes.fps or _FPS,
        "seconds": keyframes.times[-1],
        "is_cycle": False,
        "smoothness_value": 0.0,
        "default_fov": _view(first)["fov"],
        "default_transition_sec": _STEP,
    }
    lists = {
        "keyframes": [
            {"matrix": _matrix(camera)}
            | _view(camera)
            | {"override_transition_enabled": True, "override_transition_sec": float(step)}
            for camera, step in zip(keyframes.cameras, steps, strict=True)
        ],
        "camera_path": [
            {"camera_to_world": _matrix(camera, 7)} | _view(camera) for camera in frames
        ],
    }
    parts = [json.dumps(head, indent=1)[1:-2]]
    for name, entries in lists.items():
        lines = ",\n  ".join(map(json.dumps, entries))
        parts.append(f'\n "{name}": [\n  {lines}\n ]')
    with atomic_writer(path) as file:
        file.write(f"{{{','.join(parts)}\n}}\n".encode())


def _matrix(camera: Camera, digits: int = 17) -> list[float]:
    """Camera to world, row by row; columns are right, up, back and position."""
    pose = np.eye(4)
    pose[:3, :3] = camera.rotation.T * [1, -1, -1]
    pose[:3, 3] = camera.position
    return [float(f"{number:.{digits}g}") for number in pose.ravel()]


def _view(camera: Camera) -> dict[str, float]:
    fov = math.degrees(2 * math.atan(camera.height / 2 / camera.fy))
    return {"fov": fov, "aspect": camera.width / camera.height}

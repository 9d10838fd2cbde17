"""Tours of pages: cameras with times, from camera paths of other programs and of the viewer."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from gs_codec.cameras.camera import Camera
from gs_codec.cameras.camera_files import read_cameras
from gs_codec.cameras.inria import as_entry
from gs_codec.cameras.keyframes import read_keyframes

#: Poses per second of a path whose frames are known; pages interpolate between them.
_PER_SECOND = 10

#: Maximum number of poses of a tour; longer paths have fewer per second.
_MOST = 1000

#: Seconds between the cameras of a file without times.
_LEG = 4.0

#: Decimals of rotations, and significant digits of other numbers.
_DECIMALS, _DIGITS = 6, 7


def read_tour(path: str | Path) -> list[dict[str, Any]]:
    """Read a tour from any file of cameras: entries with times for a page.

    Files with all frames of a path, such as those of the viewer, give the path itself; others give
    keyframes. Raises InvalidInput like `read_cameras`, or if times are wrong.
    """
    path = Path(path)
    keyframes, cameras = read_keyframes(path), read_cameras(path)
    if keyframes.times is None or keyframes.fps is None:
        return _thinned([(k * _LEG, camera) for k, camera in enumerate(cameras)], 1)
    seconds, fps = keyframes.times[-1], keyframes.fps
    if abs(len(cameras) - 1 - seconds * fps) <= 1:
        frames = [(k / fps, camera) for k, camera in enumerate(cameras)]
        return _thinned(frames, max(fps // _PER_SECOND, 1))
    return _thinned(list(zip(keyframes.times, keyframes.cameras, strict=True)), 1)


def _thinned(timed: list[tuple[float, Camera]], step: int) -> list[dict[str, Any]]:
    """Every `step`-th camera, or fewer, and the last, as entries for a page."""
    step = max(step, math.ceil(len(timed) / _MOST))
    kept = timed[:-1:step] + timed[-1:]
    return [_rounded(as_entry(k, camera)) | {"time": time} for k, (time, camera) in enumerate(kept)]


def _rounded(entry: dict[str, Any]) -> dict[str, Any]:
    """An entry of ``cameras.json`` with fewer digits, and without a name."""
    turn = [[round(value, _DECIMALS) for value in row] for row in entry["rotation"]]
    place = [float(f"{value:.{_DIGITS}g}") for value in entry["position"]]
    lens = {
        key: float(f"{entry[key]:.{_DIGITS}g}")
        for key in ("width", "height", "fx", "fy", "cx", "cy")
    }
    return {**lens, "rotation": turn, "position": place}

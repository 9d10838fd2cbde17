"""The cameras for a command: from a file or folder, estimated, or given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.cameras.camera_files import read_cameras
from gs_codec.cameras.inria import as_camera
from gs_codec.errors import InvalidInput
from gs_codec.report import Progress
from gs_codec.runtime.mapped import other_files
from gs_codec.scene import Scene
from gs_codec.views.estimate import COUNT, auto_cameras

#: What `find_cameras` can select.
SPLITS = ("held-out", "test", "train", "all")

#: Maximum share of the centres in view that are too near to be drawn. At most 1.1e-5 in four real
#: captures and seven generated ones, in their own units; 2.7e-4 to 1.9e-2 in nerfstudio's units.
_HIDDEN = 1e-4

#: Numbers of centres and cameras that determine it.
_CENTRES, _CAMERAS = 20_000, 32


def find_cameras(
    source: str | Path | Sequence[Camera | Mapping[str, Any]],
    scene: Scene,
    split: str = "all",
    width: int | None = None,
    auto: int = COUNT,
    progress: Progress | None = None,
) -> list[Camera]:
    """Cameras from a file or folder (see `read_cameras`), ``auto`` (estimated), or given ones.

    Given ones draw what is near to them; see `near_enough`. Raises InvalidInput if there are no
    cameras.

    Parameters
    ----------
    source : path, "auto", or sequence of Camera or mapping
        A mapping is an entry of the trainer's ``cameras.json``.
    scene : Scene
        The scene for which ``auto`` estimates cameras.
    split : {"held-out", "test", "train", "all"}
        Which cameras to use; ``held-out`` means ``test`` if any camera is marked ``test``, else
        ``all``.
    width : int, optional
        Width of the images, pixels; the height follows.
    auto : int
        Number of ``auto`` cameras.
    progress : callable, optional
        Called while ``auto`` cameras are estimated.
    """
    if split not in SPLITS:
        raise InvalidInput(f"split '{split}': expected one of {', '.join(SPLITS)}")
    if not isinstance(source, str | Path):
        cameras = near_enough([as_camera(camera) for camera in source], scene)
    elif str(source) == "auto":
        cameras = auto_cameras(scene, auto, progress)
    else:
        with other_files():
            cameras = near_enough(read_cameras(source), scene)
    if not cameras:
        raise InvalidInput("cameras: none, expected at least one")
    if split == "held-out":
        split = "test" if any(camera.split == "test" for camera in cameras) else "all"
    chosen = [camera for camera in cameras if split in ("all", camera.split)]
    if not chosen:
        raise InvalidInput(f"cameras: none of the {len(cameras)} is marked '{split}'")
    if width is not None:
        if width < 1:
            raise InvalidInput(f"width {width}: expected at least 1 pixel")
        chosen = [c.resized(width, max(1, round(c.height * width / c.width))) for c in chosen]
    return chosen


def near_enough(cameras: Sequence[Camera], scene: Scene) -> list[Camera]:
    """Cameras that draw almost all of the Gaussians in front of them.

    Some trainers scale scenes so that their default minimum depth is several metres. It is halved
    until few centres in view are nearer.
    """
    points = scene.positions[:, :: max(1, scene.count // _CENTRES)].astype(np.float64)
    some = cameras[:: max(1, len(cameras) // _CAMERAS)]
    with np.errstate(all="ignore"):
        depths = np.concatenate([np.empty(0), *(_depths(points, camera) for camera in some)])
    near = min((camera.near for camera in some), default=0.0)
    while np.count_nonzero(depths < near) > _HIDDEN * len(depths):
        near /= 2
    return [replace(camera, near=min(near, camera.near)) for camera in cameras]


def _depths(points: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """Depths of the points ``(3, n)`` inside an image."""
    x, y, z = camera.rotation @ (points - camera.position[:, None])
    u, v = camera.fx * x + camera.cx * z, camera.fy * y + camera.cy * z
    return z[(z > 0) & (u >= 0) & (u <= camera.width * z) & (v >= 0) & (v <= camera.height * z)]

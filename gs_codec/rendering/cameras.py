"""The cameras to judge a scene by: from a file, or chosen for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gs_codec.errors import InvalidInput
from gs_codec.io.mapped import other_files
from gs_codec.rendering.auto_cameras import auto_cameras
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.camera_files import read_cameras
from gs_codec.rendering.inria import camera_fields
from gs_codec.scene import Scene

#: What `find_cameras` can select.
SPLITS = ("held-out", "test", "train", "all")


def find_cameras(
    source: str | Path | Sequence[Camera | Mapping[str, Any]],
    scene: Scene,
    split: str = "all",
    width: int | None = None,
    auto: int = 24,
) -> list[Camera]:
    """Cameras of a file or folder (see `read_cameras`), ``auto`` ones, or those given.

    Parameters
    ----------
    source : path, "auto", or sequence of Camera or mapping
        A mapping is an entry of the trainer's ``cameras.json``.
    scene : Scene
        The scene for which ``auto`` chooses cameras.
    split : {"held-out", "test", "train", "all"}
        Which cameras to use; ``held-out`` means ``test`` if any camera is marked ``test``, else
        ``all``.
    width : int, optional
        Width of the images, pixels; the height follows.
    auto : int
        Number of ``auto`` cameras.

    Raises
    ------
    InvalidInput
        If there are none.
    """
    if split not in SPLITS:
        raise InvalidInput(f"split '{split}': expected one of {', '.join(SPLITS)}")
    if not isinstance(source, str | Path):
        cameras = [as_camera(camera) for camera in source]
    elif str(source) == "auto":
        cameras = auto_cameras(scene, auto)
    else:
        with other_files():
            cameras = read_cameras(source)
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


def as_camera(camera: Camera | Mapping[str, Any]) -> Camera:
    """Convert an entry of ``cameras.json`` to a `Camera`.

    Raises
    ------
    InvalidInput
    """
    if isinstance(camera, Camera):
        return camera
    return Camera(**camera_fields("camera", camera))

"""The cameras for a command: from a file or folder, estimated, or given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

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


def find_cameras(
    source: str | Path | Sequence[Camera | Mapping[str, Any]],
    scene: Scene,
    split: str = "all",
    width: int | None = None,
    auto: int = COUNT,
    progress: Progress | None = None,
) -> list[Camera]:
    """Cameras from a file or folder (see `read_cameras`), ``auto`` (estimated), or given ones.

    Raises InvalidInput if there are no cameras.

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
        cameras = [as_camera(camera) for camera in source]
    elif str(source) == "auto":
        cameras = auto_cameras(scene, auto, progress)
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

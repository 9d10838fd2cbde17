"""Cameras of a scene: from cameras.json, from a COLMAP model, or chosen for the scene."""

from __future__ import annotations

import os
import re
import reprlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from gs_codec.errors import InvalidInput
from gs_codec.rendering.auto_cameras import auto_cameras
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.colmap import find_model, read_colmap
from gs_codec.rendering.inria import as_camera, read_inria
from gs_codec.runtime.mapped import other_files
from gs_codec.scene import Scene

#: Longest name of an image, characters.
_MAX_NAME = 1024

#: Not allowed in names of images: control characters, line ends and lone surrogates.
_UNPRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")

_COLMAP_FILES = ("cameras.bin", "cameras.txt", "images.bin", "images.txt")


#: What `find_cameras` can select.
SPLITS = ("held-out", "test", "train", "all")


def read_cameras(path: str | Path) -> list[Camera]:
    """Read the cameras of a dataset or of a trained scene.

    Parameters
    ----------
    path : str or Path
        A ``cameras.json`` of the INRIA trainer; a COLMAP sparse model's folder or one of its
        files; a dataset's folder with a model in ``sparse/0`` or ``sparse``; or a folder with
        ``cameras.json`` and no model. A binary model is preferred to a text model.

    Returns
    -------
    list of Camera
        From JSON in the file's order; from COLMAP by image name, split into train and test.

    Raises
    ------
    InvalidInput
        If there are no cameras, a file is broken, or a camera is not a pinhole camera.
    """
    path = Path(path)
    cameras = []
    seen: set[str] = set()
    for where, fields in _entries(path):
        name = fields["name"]
        _check_name(where, name)
        if name in seen:
            raise InvalidInput(f"{where}: image {reprlib.repr(name)} for the second time")
        seen.add(name)
        try:
            cameras.append(Camera(**fields))
        except InvalidInput as error:
            raise InvalidInput(f"{where}: {error}") from error
    if not cameras:
        raise InvalidInput(f"{path}: no cameras, expected at least one")
    return cameras


def _entries(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Location of each camera for error messages, and the fields of its `Camera`."""
    # os.path because Path's own tests raise on names that are too long.
    if os.path.isfile(path):
        if path.suffix.lower() == ".json":
            return read_inria(path)
        if path.name not in _COLMAP_FILES:
            raise InvalidInput(f"{path}: expected a .json file, or a COLMAP model's folder")
        path = path.parent
    elif not os.path.isdir(path):
        raise InvalidInput(f"{path}: no such file or folder, expected cameras")
    model = find_model(path)
    if model is not None:
        return read_colmap(model)
    if os.path.isfile(path / "cameras.json"):
        return read_inria(path / "cameras.json")
    raise InvalidInput(
        f"{path}: neither cameras.json nor a COLMAP model (cameras and images, both .bin or .txt)"
    )


def _check_name(where: str, name: str) -> None:
    if not 0 < len(name) <= _MAX_NAME:
        raise InvalidInput(f"{where}: name of {len(name)} characters, expected 1 to {_MAX_NAME}")
    if _UNPRINTABLE.search(name):
        raise InvalidInput(f"{where}: control characters in name {reprlib.repr(name)}")


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

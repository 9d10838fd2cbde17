"""Cameras from files: a trainer's cameras.json, or a COLMAP sparse model."""

from __future__ import annotations

import os
import re
import reprlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gs_codec.errors import InvalidInput
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.colmap import find_model, read_colmap
from gs_codec.rendering.inria import read_inria

#: Longest name of an image, characters.
_MAX_NAME = 1024

#: Not allowed in names of images: control characters, line ends and lone surrogates.
_UNPRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")

_COLMAP_FILES = ("cameras.bin", "cameras.txt", "images.bin", "images.txt")


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

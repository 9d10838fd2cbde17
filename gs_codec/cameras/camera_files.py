"""Read cameras from files of several programs; write cameras.json."""

from __future__ import annotations

import json
import logging
import os
import re
import reprlib
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any

from gs_codec.cameras.camera import Camera
from gs_codec.cameras.camera_paths import read_camera_path, read_supersplat
from gs_codec.cameras.colmap import DEEPER_PLACES, PLACES, find_model, models_below, read_colmap
from gs_codec.cameras.inria import as_entry, read_inria
from gs_codec.cameras.json_fields import MAX_BYTES, load_json, short
from gs_codec.cameras.transforms import move_as_trained, read_transforms
from gs_codec.errors import InvalidInput
from gs_codec.runtime.arguments import checked
from gs_codec.runtime.atomic import atomic_writer, check_writable
from gs_codec.runtime.wording import counted

log = logging.getLogger(__name__)

#: Location of each camera for error messages, and the fields of its `Camera`.
Entries = Iterator[tuple[str, dict[str, Any]]]

#: Maximum length of an image name, in characters.
_MAX_NAME = 1024

#: Characters not allowed in image names: control characters, line ends and lone surrogates.
_UNPRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")

_COLMAP_FILES = ("cameras.bin", "cameras.txt", "images.bin", "images.txt")

#: Camera files in a folder, in order of preference; all files of a group are read together.
_JSON_FILES = (
    ("cameras.json",),
    ("transforms.json",),
    ("transforms_train.json", "transforms_test.json"),
)

#: Readers of JSON objects, by a field that identifies them.
_READERS: dict[str, Callable[[Path, dict[str, Any]], Entries]] = {
    "frames": read_transforms,
    "camera_path": read_camera_path,
    "poseSets": read_supersplat,
    "animTracks": read_supersplat,
}


@checked
def read_cameras(path: str | Path) -> list[Camera]:
    """Read the cameras of a dataset, of a trained scene or of a camera path.

    Parameters
    ----------
    path : str or Path
        A COLMAP sparse model's folder, or one of its files; a dataset's folder with models in
        ``sparse/0``, ``sparse/1`` and so on, or in ``sparse``; a JSON file; or a folder without
        these, but with ``cameras.json``, ``transforms.json``, or ``transforms_train.json`` and
        ``transforms_test.json``, or else with models in ``colmap/sparse/0``, ``dense/0/sparse`` or
        similar. Of several models, the one with the most images is read, and a log message says so.
        A binary model is preferred to a text model. JSON files are recognised by content:
        ``cameras.json`` of the INRIA trainer, transforms of nerfstudio, instant-ngp or Blender's
        datasets, camera paths of nerfstudio, poses of SuperSplat.

    Returns
    -------
    list of Camera
        Cameras from JSON are in the file's order; those from COLMAP are sorted by image name, and
        split into train and test. Cameras of distorted lenses are for undistorted photographs (see
        `Lens`).

    Raises
    ------
    InvalidInput
        If there are no cameras, a file is damaged, or a camera model is not supported.

    Examples
    --------
    >>> [(camera.name, camera.width) for camera in gs_codec.read_cameras("cameras.json")]
    [('00000', 64), ('00001', 64)]
    """
    path = Path(path)
    return cameras_of(path, _entries(path))


def cameras_of(path: Path, entries: Entries) -> list[Camera]:
    """The cameras of the entries of a file. Raises InvalidInput like `read_cameras`."""
    cameras = []
    for where, fields in entries:
        _check_name(where, fields["name"])
        try:
            cameras.append(Camera(**fields))
        except InvalidInput as error:
            raise InvalidInput(f"{where}: {error}") from error
    if not cameras:
        raise InvalidInput(f"{path}: no cameras, expected at least one")
    return cameras


@checked
def write_cameras(path: str | Path, cameras: Iterable[Camera], overwrite: bool = False) -> None:
    """Write cameras in the layout of the INRIA trainer's ``cameras.json``, atomically.

    `read_cameras` returns the same cameras, bit-exactly, but without `Camera.lens`, which the
    layout does not have; a log message says so.

    Parameters
    ----------
    path : str or Path
        The file.
    cameras : iterable of Camera
        At least one.
    overwrite : bool
        Whether to replace an existing file. By default, an existing file is an error.

    Raises
    ------
    InvalidInput
        If the file could not be read again, or cannot be written.

    Examples
    --------
    >>> views = gs_codec.render("scene.ply", "cameras.json", width=32)
    >>> gs_codec.write_cameras("small.json", views.cameras)
    >>> [camera.height for camera in gs_codec.read_cameras("small.json")]
    [22, 22]
    """
    check_writable(path, overwrite)
    cameras = list(cameras)
    if not cameras:
        raise InvalidInput(f"{path}: no cameras, expected at least one")
    for index, camera in enumerate(cameras):
        _check_name(f"camera {index}", camera.name)
    lines = ",\n".join(json.dumps(as_entry(index, camera)) for index, camera in enumerate(cameras))
    data = f"[\n{lines}\n]\n".encode()
    if len(data) > MAX_BYTES:
        raise InvalidInput(
            f"{path}: {counted(len(data), 'byte')} of cameras, expected at most {MAX_BYTES:,}"
        )
    with atomic_writer(path) as file:
        file.write(data)
    distorted = sum(camera.lens is not None for camera in cameras)
    if distorted:
        many = counted(distorted, "camera")
        log.warning("%s: lens distortion of %s not written: use undistorted images", path, many)


def _entries(path: Path) -> Entries:
    # os.path, because the tests of Path raise on names that are too long.
    if os.path.isfile(path):
        if path.suffix.lower() == ".json":
            return _read_json(path)
        if path.name not in _COLMAP_FILES:
            raise InvalidInput(f"{path}: expected a .json file, or a COLMAP model's folder")
        path = path.parent
    elif not os.path.isdir(path):
        raise InvalidInput(f"{path}: no such file or folder, expected cameras")
    model = find_model(path, PLACES)
    if model is not None:
        return move_as_trained(path, read_colmap(model))
    for names in _JSON_FILES:
        found = [path / name for name in names if os.path.isfile(path / name)]
        if found:
            return chain.from_iterable(map(_read_json, found))
    model = find_model(path, DEEPER_PLACES)
    if model is not None:
        return move_as_trained(path, read_colmap(model))
    below = models_below(path)
    others = f"; COLMAP models are in {', '.join(map(short, below[:5]))}" if below else ""
    if os.path.isfile(path / "poses_bounds.npy"):
        others += "; poses_bounds.npy of LLFF is not read"
    raise InvalidInput(
        f"{path}: neither a COLMAP model (cameras and images, both .bin or .txt) nor cameras.json "
        f"nor transforms.json{others}"
    )


def _read_json(path: Path) -> Entries:
    whole = load_json(path)
    if isinstance(whole, list):
        return read_inria(path, whole)
    for key, read in _READERS.items() if isinstance(whole, dict) else ():
        if key in whole:
            return read(path, whole)
    raise InvalidInput(
        f"{path}: {short(whole)}, expected a list of cameras or one of {', '.join(_READERS)}"
    )


def _check_name(where: str, name: str) -> None:
    """Check the name of an image; several cameras may share one."""
    if not 0 < len(name) <= _MAX_NAME:
        raise InvalidInput(
            f"{where}: name of {counted(len(name), 'character')}, expected 1 to {_MAX_NAME}"
        )
    if _UNPRINTABLE.search(name):
        raise InvalidInput(f"{where}: control characters in name {reprlib.repr(name)}")

"""The cameras.json that the INRIA trainer writes next to a scene."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gs_codec.cameras.camera import NEAR, Camera
from gs_codec.cameras.json_fields import (
    as_number,
    as_numbers,
    as_object,
    as_pixels,
    as_rotation,
    as_text,
    get,
    short,
)
from gs_codec.errors import InvalidInput


def read_inria(path: Path, entries: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    """Read cameras in the layout of the trainer's ``camera_to_JSON``.

    The file's rotations are camera to world, and the principal point is the image's centre unless
    an entry has both ``cx`` and ``cy``. Raises InvalidInput if the structure of the file is wrong.

    Parameters
    ----------
    path : Path
    entries : list
        Content of the file.

    Yields
    ------
    tuple of str and dict
        Location of the camera in the file, and the fields of its `Camera`, with ranges unchecked.
    """
    for index, entry in enumerate(entries):
        where = f"{path}: entry {index}"
        yield where, _fields(where, entry)


def as_camera(camera: Camera | Mapping[str, Any]) -> Camera:
    """Convert an entry of ``cameras.json`` to a `Camera`. Raises InvalidInput."""
    if isinstance(camera, Camera):
        return camera
    return Camera(**_fields("camera", camera))


def as_entry(index: int, camera: Camera) -> dict[str, Any]:
    """An entry of ``cameras.json``, without the lens, which the layout does not have.

    The trainer's own keys come first, because its viewers expect that.
    """
    split = {} if camera.split is None else {"split": camera.split}
    near = {} if camera.near == NEAR else {"near": float(camera.near)}
    return {
        "id": index,
        "img_name": camera.name,
        "width": int(camera.width),
        "height": int(camera.height),
        "position": camera.position.tolist(),
        "rotation": camera.rotation.T.tolist(),
        **{key: float(getattr(camera, key)) for key in ("fy", "fx", "cx", "cy")},
        **split,
        **near,
    }


def _fields(where: str, entry: Any) -> dict[str, Any]:
    """Convert an entry of ``cameras.json`` to the fields of a `Camera`; ranges are not checked."""
    entry = as_object(where, entry, "a camera")
    name, split = get(where, entry, "img_name"), entry.get("split")
    # Trainers that generate scenes number their cameras; True is an int in Python.
    name = str(name) if type(name) is int else as_text(where, "img_name", name)
    if split not in ("train", "test", None):
        raise InvalidInput(f"{where}: split {short(split)}, expected 'train' or 'test'")
    width, height = (as_pixels(where, key, get(where, entry, key)) for key in ("width", "height"))
    centre = {"cx": width / 2, "cy": height / 2}
    if "cx" in entry and "cy" in entry:
        centre = {key: as_number(where, key, entry[key]) for key in ("cx", "cy")}
    return {
        "name": name,
        "width": width,
        "height": height,
        "fx": as_number(where, "fx", get(where, entry, "fx")),
        "fy": as_number(where, "fy", get(where, entry, "fy")),
        **centre,
        # Camera to world: the columns are right, down and forward.
        "rotation": as_rotation(where, get(where, entry, "rotation")).T,
        "position": np.array(as_numbers(where, "position", get(where, entry, "position"), 3)),
        "split": split,
        "near": as_number(where, "near", entry.get("near", NEAR)),
    }

"""The cameras.json that the INRIA trainer writes beside a scene."""

from __future__ import annotations

import json
import math
import reprlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gs_codec.errors import InvalidInput
from gs_codec.rendering.camera import Camera
from gs_codec.runtime.mapped import opened

#: Largest file, bytes: some 80,000 cameras. A hostile JSON text takes 30 times that in memory.
_MAX_BYTES = 1 << 25

#: Entries of a rotation are at most 1; much larger ones would overflow in its check.
_MAX_ROTATION = 2.0


def read_inria(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Read cameras in the layout of the trainer's ``camera_to_JSON``.

    The file's rotations are camera to world, and the principal point is the image's centre
    unless an entry has both ``cx`` and ``cy``.

    Yields
    ------
    tuple of str and dict
        Where the camera is, and the fields of its `Camera`, whose ranges are not yet checked.

    Raises
    ------
    InvalidInput
        If the file is not JSON, or of another shape.
    """
    entries = _load(path)
    if not isinstance(entries, list):
        raise InvalidInput(f"{path}: {_short(entries)}, expected a list of cameras")
    for index, entry in enumerate(entries):
        where = f"{path}: entry {index}"
        yield where, _fields(where, entry)


def _load(path: Path) -> Any:
    with opened(path) as data:
        if len(data) > _MAX_BYTES:
            raise InvalidInput(f"{path}: {len(data)} bytes, expected at most {_MAX_BYTES}")
        raw = bytes(data)
    try:
        return json.loads(raw.decode("utf-8-sig"), parse_int=_integer)
    except UnicodeDecodeError as error:
        raise InvalidInput(f"{path}: not UTF-8 text at byte {error.start}") from error
    except json.JSONDecodeError as error:
        raise InvalidInput(f"{path}: not JSON ({error})") from error
    except RecursionError as error:
        raise InvalidInput(f"{path}: lists nested too deeply, expected cameras") from error


def _integer(text: str) -> int | float:
    """Parse an integer; as a float if it is so long that Python may refuse it."""
    return int(text) if len(text) < 16 else float(text)


def as_camera(camera: Camera | Mapping[str, Any]) -> Camera:
    """Convert an entry of ``cameras.json`` to a `Camera`.

    Raises
    ------
    InvalidInput
    """
    if isinstance(camera, Camera):
        return camera
    return Camera(**_fields("camera", camera))


def _fields(where: str, entry: Any) -> dict[str, Any]:
    """Convert an entry of ``cameras.json`` to the fields of a `Camera`; ranges are not checked."""
    if not isinstance(entry, dict):
        raise InvalidInput(f"{where}: {_short(entry)}, expected a camera")
    name, split = _get(where, entry, "img_name"), entry.get("split")
    if not isinstance(name, str):
        raise InvalidInput(f"{where}: img_name {_short(name)}, expected text")
    if split not in ("train", "test", None):
        raise InvalidInput(f"{where}: split {_short(split)}, expected 'train' or 'test'")
    width, height = (_whole(where, entry, key) for key in ("width", "height"))
    centre = {"cx": width / 2, "cy": height / 2}
    if "cx" in entry and "cy" in entry:
        centre = {key: _number(where, key, entry[key]) for key in ("cx", "cy")}
    return {
        "name": name,
        "width": width,
        "height": height,
        "fx": _number(where, "fx", _get(where, entry, "fx")),
        "fy": _number(where, "fy", _get(where, entry, "fy")),
        **centre,
        "rotation": _rotation(where, _get(where, entry, "rotation")).T,
        "position": np.array(_triple(where, "position", _get(where, entry, "position"))),
        "split": split,
    }


def _get(where: str, entry: dict[str, Any], key: str) -> Any:
    if key not in entry:
        raise InvalidInput(f"{where}: no '{key}'")
    return entry[key]


def _whole(where: str, entry: dict[str, Any], key: str) -> int:
    value = _number(where, key, _get(where, entry, key))
    if not value.is_integer() or abs(value) > 1 << 53:
        raise InvalidInput(f"{where}: {key} {value}, expected a whole number of pixels")
    return int(value)


def _number(where: str, key: str, value: Any) -> float:
    # True is an int in Python, but not a number in JSON.
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise InvalidInput(f"{where}: {key} {_short(value)}, expected a finite number")
    return float(value)


def _triple(where: str, key: str, value: Any) -> list[float]:
    if not isinstance(value, list) or len(value) != 3:
        raise InvalidInput(f"{where}: {key} {_short(value)}, expected 3 numbers")
    return [_number(where, key, number) for number in value]


def _rotation(where: str, value: Any) -> np.ndarray:
    """Camera to world: the columns are right, down and forward."""
    if not isinstance(value, list) or len(value) != 3:
        raise InvalidInput(f"{where}: rotation {_short(value)}, expected 3 rows of 3 numbers")
    matrix = np.array([_triple(where, "rotation row", row) for row in value])
    if np.abs(matrix).max() > _MAX_ROTATION:
        raise InvalidInput(f"{where}: rotation holds {np.abs(matrix).max()}, expected -1 to 1")
    return matrix


def _short(value: Any) -> str:
    text = reprlib.repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."

"""transforms.json of nerfstudio and instant-ngp, and transforms_train.json of Blender's datasets.

All contain camera-to-world matrices whose columns are right, up and back (OpenGL). Layouts:
https://docs.nerf.studio/quickstart/data_conventions.html, ``nerf_loader.cu`` of instant-ngp.
"""

from __future__ import annotations

import math
import os
import re
from collections import ChainMap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.image_files import image_size, seek_image
from gs_codec.cameras.json_fields import (
    as_angle,
    as_list,
    as_number,
    as_object,
    as_pixels,
    as_pose,
    as_text,
    get,
    load_json,
    short,
)
from gs_codec.cameras.lens import BROWN, FISHEYE, lens_fields
from gs_codec.errors import InvalidInput

#: Models of nerfstudio without and with a fisheye lens; the former all have the same coefficients.
_MODELS = {
    **dict.fromkeys(("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"), False),
    "OPENCV_FISHEYE": True,
}

#: A number in text, short enough to be parsed quickly.
_NUMBER = re.compile(
    r"\s{0,9}[+-]?[0-9]{1,40}(\.[0-9]{0,40})?([eE][+-]?[0-9]{1,5})?\s{0,9}", re.ASCII
)

#: Fields of lenses that are not supported.
_OTHER_LENSES = ("ftheta_p0", "latlong", "equirectangular", "orthographic", "distortion_params")

#: Splits by their names in fields and files.
_SPLITS = {"train": "train", "val": "test", "test": "test"}

#: File that nerfstudio writes next to a trained scene: how it moved the cameras before training.
_MOVED = "dataparser_transforms.json"

#: How old versions of nerfstudio moved COLMAP's cameras, for files that do not state it.
_OLD_APPLIED = [[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0]]


def read_transforms(path: Path, whole: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Read cameras of a transforms.json.

    If the size of an image is not stated, it is read from the named image file. If
    ``dataparser_transforms.json`` is in the same folder, cameras are moved as nerfstudio moved them
    for training. Raises InvalidInput if the structure of the file is wrong, a lens model is not
    supported, or an image whose size is needed is missing.

    Parameters
    ----------
    path : Path
    whole : dict
        Content of the file.

    Yields
    ------
    tuple of str and dict
        Location of the camera in the file, and the fields of its `Camera`, with ranges unchecked.
    """
    frames = as_list(str(path), "frames", whole["frames"])
    shared = {key: value for key, value in whole.items() if key != "frames"}
    splits = _splits(path, shared)
    move, scale = _moved(path, shared)
    for index, frame in enumerate(frames):
        where = f"{path}: frame {index}"
        frame = as_object(where, frame, "a frame")
        name = _name(where, get(where, frame, "file_path"))
        pose = as_pose(where, "transform_matrix", get(where, frame, "transform_matrix"))
        with np.errstate(over="ignore", invalid="ignore"):
            pose = move @ np.vstack([pose, [0, 0, 0, 1]])
            position = scale * pose[:3, 3]
        # Convert right, up, back to right, down, forward.
        yield (
            where,
            {
                "name": name,
                **_intrinsics(where, path, ChainMap(frame, shared), name),
                "rotation": (pose[:3, :3] * [1, -1, -1]).T,
                "position": position,
                "split": splits.get(name, splits.get("")),
            },
        )


def _name(where: str, value: Any) -> str:
    name = as_text(where, "file_path", value)
    while name.startswith("./"):
        name = name[2:].lstrip("/")
    return name


def _splits(path: Path, shared: Mapping[str, Any]) -> dict[str, str]:
    """The split of each image, by its name; the split of all other images, by an empty name."""
    ending = path.stem.lower().rpartition("_")[2]
    splits = {"": _SPLITS[ending]} if ending in _SPLITS else {}
    for word, split in _SPLITS.items():
        key = f"{word}_filenames"
        for name in as_list(str(path), key, shared.get(key, [])):
            splits[_name(str(path), name)] = split
    return splits


def move_as_trained(
    folder: Path, entries: Iterator[tuple[str, dict[str, Any]]]
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Move COLMAP's cameras as nerfstudio moved them for training, if `folder` has its file."""
    if not os.path.isfile(folder / _MOVED):
        yield from entries
        return
    move, scale = _read_move(folder / _MOVED, 1.0)
    for where, fields in entries:
        with np.errstate(over="ignore", invalid="ignore"):
            position = scale * (move[:3] @ [*fields["position"], 1])
        rotation = fields["rotation"] @ move[:3, :3].T
        yield where, fields | {"rotation": rotation, "position": position}


def _read_move(path: Path, before: float) -> tuple[NDArray[np.float64], float]:
    """Matrix ``(4, 4)`` and scale from COLMAP's world to a scene that nerfstudio trained.

    The scale is relative to `before`, which is in the cameras' positions already.
    """
    where = str(path)
    found = as_object(where, load_json(path), "the transform that nerfstudio applied")
    move = np.eye(4)
    move[:3] = as_pose(where, "transform", get(where, found, "transform"))
    scale = as_number(where, "scale", get(where, found, "scale"))
    if not 0 < scale / before < math.inf:
        raise InvalidInput(f"{where}: scale {scale}, expected a number above 0")
    return move, scale / before


def _moved(path: Path, shared: Mapping[str, Any]) -> tuple[NDArray[np.float64], float]:
    """Matrix ``(4, 4)`` and scale by which nerfstudio moved the file's cameras, if it did."""
    if not os.path.isfile(path.with_name(_MOVED)):
        return np.eye(4), 1.0
    before = as_number(str(path), "applied_scale", shared.get("applied_scale", 1.0))
    if not 0 < before < math.inf:
        raise InvalidInput(f"{path}: applied_scale {before}, expected a number above 0")
    move, scale = _read_move(path.with_name(_MOVED), before)
    # The file's cameras may be in a third world.
    applied = np.eye(4)
    is_old = os.path.isdir(path.parent / "colmap" / "sparse" / "0")
    default = _OLD_APPLIED if is_old else applied[:3].tolist()
    applied[:3] = as_pose(str(path), "applied_transform", shared.get("applied_transform", default))
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            return move @ np.linalg.inv(applied), scale
    except np.linalg.LinAlgError as error:
        raise InvalidInput(f"{path}: applied_transform is singular, expected a rotation") from error


def _intrinsics(where: str, path: Path, fields: Mapping[str, Any], name: str) -> dict[str, Any]:
    """The fields of a `Camera` except its pose; `fields` are the frame's and shared ones."""
    fisheye = _is_fisheye(where, fields)
    width, height = _size(where, path, fields, name)
    fx = _focal(where, fields, "x", width)
    if fx is None:
        raise InvalidInput(f"{where}: no 'fl_x' or 'camera_angle_x'")
    fy = _focal(where, fields, "y", height)
    cx, cy = (
        as_number(where, key, fields.get(key, side / 2))
        for key, side in (("cx", width), ("cy", height))
    )
    names = FISHEYE if fisheye else BROWN
    coefficients = {key: _coefficient(where, key, fields.get(key, 0.0)) for key in names}
    if not fisheye and not ("k5" in fields or "k6" in fields):
        # Only OpenCV's model, which also has k5 and k6, divides by k4.
        coefficients["r8"] = coefficients.pop("k4")
    return lens_fields(where, (width, height, fx, fy or fx, cx, cy), fisheye, coefficients)


def _coefficient(where: str, key: str, value: Any) -> float:
    """A coefficient of a lens, which nerfstudio copies as text from RealityCapture's tables."""
    if isinstance(value, str) and _NUMBER.fullmatch(value):
        value = float(value)
    return as_number(where, key, value)


def _is_fisheye(where: str, fields: Mapping[str, Any]) -> bool:
    for key in _OTHER_LENSES:
        if key in fields:
            raise InvalidInput(
                f"{where}: a lens with {key}, expected k1 to k4, p1, p2 or no distortion"
            )
    model = as_text(where, "camera_model", fields.get("camera_model", "OPENCV"))
    if model not in _MODELS:
        raise InvalidInput(
            f"{where}: camera_model {short(model)}, expected one of {', '.join(_MODELS)}"
        )
    marked = fields.get("is_fisheye", False)
    if not isinstance(marked, bool):
        raise InvalidInput(f"{where}: is_fisheye {short(marked)}, expected true or false")
    # instant-ngp marks lenses as fisheye even if all coefficients are 0, but renders those as
    # pinholes.
    return _MODELS[model] or (marked and any(fields.get(key) for key in FISHEYE))


def _size(where: str, path: Path, fields: Mapping[str, Any], name: str) -> tuple[int, int]:
    if "w" in fields and "h" in fields:
        return as_pixels(where, "w", fields["w"]), as_pixels(where, "h", fields["h"])
    image = seek_image(path.parent, name)
    if image is None:
        raise InvalidInput(
            f"{where}: no w and h, and no image {short(name)} next to the file to give the size"
        )
    return image_size(image)


def _focal(where: str, fields: Mapping[str, Any], axis: str, side: int) -> float | None:
    """A focal length, pixels; None if the file has none for this axis."""
    focal, angle = f"fl_{axis}", f"camera_angle_{axis}"
    if focal in fields:
        return as_number(where, focal, fields[focal])
    if angle in fields:
        return side / 2 / math.tan(as_angle(where, angle, fields[angle], math.pi))
    return None

"""Camera paths: those of nerfstudio's viewer, and the poses of SuperSplat.

nerfstudio's ``camera_path`` has a camera-to-world matrix for each frame, whose columns are right,
up and back. SuperSplat has keyframes, a position and a target each: ``animTracks`` and ``cameras``
in the settings.json of an exported viewer, ``poseSets`` in the document.json of a project. It shows
scenes rotated by 180 degrees about z, with y up; its poses are in that world.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import facing
from gs_codec.cameras.json_fields import (
    as_angle,
    as_list,
    as_numbers,
    as_object,
    as_pixels,
    check_rotation,
    get,
    short,
)
from gs_codec.errors import InvalidInput

#: Image size of SuperSplat's poses, in pixels; the files have none.
WIDTH = 1280
HEIGHT = 720

#: Field of view if an old file has none, in degrees.
FIELD_OF_VIEW = 60.0

#: Converts SuperSplat's world to that of the scene, and back.
_TURN = np.array([-1.0, -1.0, 1.0])

#: Up, in the scene's world.
_UP = np.array([0.0, -1.0, 0.0])


def read_camera_path(path: Path, whole: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Read the frames of a camera path of nerfstudio.

    Raises InvalidInput if the structure of the file is wrong, or a camera is not perspective.

    Yields
    ------
    tuple of str and dict
        Location of the camera in the file, and the fields of its `Camera`, with ranges unchecked.
    """
    kind = whole.get("camera_type", "perspective")
    if kind != "perspective":
        raise InvalidInput(f"{path}: camera_type {short(kind)}, expected 'perspective'")
    keys = ("render_width", "render_height")
    width, height = (as_pixels(str(path), key, get(str(path), whole, key)) for key in keys)
    for index, frame in enumerate(as_list(str(path), "camera_path", whole["camera_path"])):
        where = f"{path}: camera_path {index}"
        frame = as_object(where, frame, "a frame")
        values = as_numbers(where, "camera_to_world", get(where, frame, "camera_to_world"), 16)
        pose = np.reshape(values, (4, 4))
        # Vertical field of view, as in three.js.
        half = as_angle(where, "fov", get(where, frame, "fov"), 180)
        yield (
            where,
            {
                **_view(index, width, height, height / 2 / math.tan(half)),
                "rotation": (check_rotation(where, pose[:3, :3]) * [1, -1, -1]).T,
                "position": pose[:3, 3],
            },
        )


def read_supersplat(path: Path, whole: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Read the poses of SuperSplat: the first view, if the file has it, and the keyframes.

    Raises InvalidInput if the structure of the file is wrong, or a camera is at its own target.

    Yields
    ------
    tuple of str and dict
        Location of the camera in the file, and the fields of its `Camera`, with ranges unchecked.
    """
    focal = max(WIDTH, HEIGHT) / 2
    for index, (where, pose) in enumerate(_poses(path, whole)):
        places = [
            _TURN * as_numbers(where, key, get(where, pose, key), 3)
            for key in ("position", "target")
        ]
        # Field of view along the longer side.
        half = as_angle(where, "fov", pose.get("fov", FIELD_OF_VIEW), 180)
        yield (
            where,
            {
                **_view(index, WIDTH, HEIGHT, focal / math.tan(half)),
                "rotation": _facing(where, *places),
                "position": places[0],
            },
        )


def _poses(path: Path, whole: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Location of each pose, with its position, target and, if present, field of view."""
    camera = whole.get("camera")
    # Settings of version 1, and projects, have one field of view for all poses.
    default = {"fov": camera["fov"]} if isinstance(camera, dict) and "fov" in camera else {}
    for key in ("cameras", "poseSets", "animTracks"):
        for number, entry in enumerate(as_list(str(path), key, whole.get(key, []))):
            where = f"{path}: {key} {number}"
            entry = as_object(where, entry, "an object")
            if key == "cameras":
                yield where, default | as_object(where, get(where, entry, "initial"), "a pose")
            elif key == "poseSets":
                for index, pose in enumerate(as_list(where, "poses", get(where, entry, "poses"))):
                    at = f"{where}: pose {index}"
                    yield at, default | as_object(at, pose, "a pose")
            else:
                for index, keyframe in enumerate(_keyframes(where, entry)):
                    yield f"{where}: keyframe {index}", default | keyframe


def _keyframes(where: str, track: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Keyframes of a track; each field has one list of numbers for all."""
    keyframes = as_object(where, get(where, track, "keyframes"), "keyframes")
    values = as_object(where, get(where, keyframes, "values"), "values of keyframes")
    count = len(as_list(where, "times", get(where, keyframes, "times")))
    lists = {
        key: as_numbers(where, key, get(where, values, key), 3 * count)
        for key in ("position", "target")
    }
    fields = as_numbers(where, "fov", values["fov"], count) if "fov" in values else None
    for i in range(count):
        keyframe: dict[str, Any] = {key: list_[3 * i : 3 * i + 3] for key, list_ in lists.items()}
        yield keyframe | ({} if fields is None else {"fov": fields[i]})


def _view(index: int, width: int, height: int, focal: float) -> dict[str, Any]:
    """Name and intrinsics of a camera; cameras of a path have no photographs."""
    sides: dict[str, Any] = {"name": f"{index:05d}", "width": width, "height": height}
    return {**sides, "fx": focal, "fy": focal, "cx": width / 2, "cy": height / 2}


def _facing(where: str, position: NDArray, target: NDArray) -> NDArray[np.float64]:
    """World-to-camera rotation of an upright view."""
    with np.errstate(over="ignore"):
        direction = target - position
    if not (np.isfinite(direction).all() and direction.any()):
        raise InvalidInput(f"{where}: position and target are equal, expected a direction")
    return facing(direction, _UP)

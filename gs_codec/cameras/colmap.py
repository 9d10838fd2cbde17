"""COLMAP sparse models, binary and text.

Only cameras and images are read; their poses are complete, so the rigs and frames files of COLMAP
3.12 and later are not needed. Layouts: https://colmap.github.io/format.html.
"""

from __future__ import annotations

import locale
import logging
import math
import os
import reprlib
import sys
from codecs import BOM_UTF8
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.lens import BROWN, FISHEYE, lens_fields
from gs_codec.coding.axes import rotation_matrix
from gs_codec.coding.fields import ByteReader
from gs_codec.errors import InvalidInput, TruncatedStream
from gs_codec.runtime.mapped import FileBytes, opened
from gs_codec.runtime.wording import counted

log = logging.getLogger(__name__)

#: Camera models by their number in binary files.
_MODELS = (
    *("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE"),
    *("FULL_OPENCV", "FOV", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE"),
    *("RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION", "DIVISION", "SIMPLE_FISHEYE", "FISHEYE"),
    *("EUCM", "EQUIRECTANGULAR"),
)

#: Parameters of the supported models.
_PARAMETERS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", *BROWN),
    "SIMPLE_RADIAL_FISHEYE": ("f", "cx", "cy", "k1"),
    "RADIAL_FISHEYE": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV_FISHEYE": ("fx", "fy", "cx", "cy", *FISHEYE),
}

#: Folders with models in a capture: the usual ones; and others, tried after JSON files. # is a
#: number.
PLACES = ("", "sparse/#", "sparse")
DEEPER_PLACES = (
    *("colmap/sparse/#", "colmap/sparse", "colmap", "dense/#/sparse", "dense/sparse"),
    *("undistorted/sparse/#", "undistorted/sparse", "distorted/sparse/#", "distorted/sparse"),
)

#: Maximum number of folders searched for models.
_FOLDERS = 1000

#: Every `_HOLDOUT`-th image is a test image, as with ``--eval`` of the INRIA trainer.
_HOLDOUT = 8

#: Maximum length of a name, and of a line other than a line of points, in bytes.
_MAX_NAME = 1 << 12
_MAX_LINE = 1 << 13

T = TypeVar("T")


class _Intrinsics(NamedTuple):
    """A COLMAP camera: width and height in pixels, and the parameters of its model."""

    camera_id: int
    model: str
    width: int
    height: int
    parameters: tuple[float, ...]


class _Image(NamedTuple):
    """A COLMAP image; the pose is world to camera, quaternion (wxyz) and translation."""

    where: str
    pose: tuple[float, ...]
    camera_id: int
    name: bytes


def find_model(folder: Path, places: Sequence[str]) -> Path | None:
    """The folder of the model, in the first of `places` that has one; None if none has.

    Of several numbered models, the one with the most images is used, and a log message says so.
    Raises InvalidInput if images must be counted, and their file is damaged.

    Parameters
    ----------
    folder : Path
        Folder of a capture.
    places : sequence of str
        `PLACES` or `DEEPER_PLACES`.
    """
    for place in places:
        found = folder.glob(place.replace("#", "[0-9]*")) if place else [folder]
        models = sorted(filter(_is_model, found), key=lambda path: (len(str(path)), path))
        if len(models) > 1:
            counts = [len(_images(model)) for model in models]
            most = models[counts.index(max(counts))]
            named = [
                f"{model.relative_to(folder)} {n}" for model, n in zip(models, counts, strict=True)
            ]
            log.warning(
                "%s: %d COLMAP models (images: %s); using %s",
                folder,
                len(models),
                ", ".join(named[:9]),
                most.relative_to(folder),
            )
            return most
        if models:
            return models[0]
    return None


def models_below(folder: Path) -> list[str]:
    """Folders of models below a folder, by name; searches at most `_FOLDERS` folders."""
    walked = islice(os.walk(folder), _FOLDERS)
    return sorted(
        os.path.relpath(below, folder) for below, _, _ in walked if _is_model(Path(below))
    )


def _is_model(folder: Path) -> bool:
    return any(_has_files(folder, suffix) for suffix in (".bin", ".txt"))


def _has_files(folder: Path, suffix: str) -> bool:
    return all(os.path.isfile(folder / (stem + suffix)) for stem in ("cameras", "images"))


def read_colmap(folder: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Read the cameras of a sparse model, sorted by image name; prefer binary files to text.

    Raises InvalidInput if a file is damaged, or a camera model is not in `_PARAMETERS`.

    Yields
    ------
    tuple of str and dict
        Location of the image in the file, and the fields of its `Camera`, with ranges unchecked.
    """
    if _has_files(folder, ".bin"):
        cameras_path = folder / "cameras.bin"
        cameras = _read_binary(cameras_path, _binary_camera, 24)
    else:
        cameras_path = folder / "cameras.txt"
        cameras = _read_text(cameras_path, _text_camera)
    views = _views(cameras_path, cameras)
    images = sorted(((_name(image.name), image) for image in _images(folder)), key=itemgetter(0))
    odd = sum(name.isascii() and name.encode() != image.name for name, image in images)
    if odd:
        many = counted(odd, "image")
        log.warning(
            "%s: names of %s are not UTF-8 text; photographs cannot be found by them", folder, many
        )
    for index, (name, image) in enumerate(images):
        if image.camera_id not in views:
            raise InvalidInput(
                f"{image.where}: camera {image.camera_id}, which is not in {cameras_path.name}"
            )
        rotation, position = _pose(image)
        yield (
            image.where,
            {
                "name": name,
                **views[image.camera_id],
                "rotation": rotation,
                "position": position,
                "split": "train" if index % _HOLDOUT else "test",
            },
        )


def _images(folder: Path) -> list[_Image]:
    if _has_files(folder, ".bin"):
        return _read_binary(folder / "images.bin", _binary_image, 73)
    return _read_text(folder / "images.txt", _text_image)


def _views(path: Path, cameras: list[_Intrinsics]) -> dict[int, dict[str, Any]]:
    """The intrinsic fields of a `Camera`, by camera id."""
    views: dict[int, dict[str, Any]] = {}
    for camera in cameras:
        where = f"{path}: camera {camera.camera_id}"
        if camera.camera_id in views:
            raise InvalidInput(f"{where} occurs twice")
        names = _parameters(where, camera.model)
        if len(camera.parameters) != len(names):
            found = f"{counted(len(camera.parameters), 'parameter')}, expected {len(names):,}"
            raise InvalidInput(f"{where}: {found} of {camera.model}")
        if not all(map(math.isfinite, camera.parameters)):
            raise InvalidInput(f"{where}: parameters {camera.parameters}, expected finite numbers")
        given = dict(zip(names, camera.parameters, strict=True))
        fx, fy = (given.pop(name) for name in names[:2]) if "fx" in given else 2 * [given.pop("f")]
        view = (camera.width, camera.height, fx, fy, given.pop("cx"), given.pop("cy"))
        fisheye = camera.model.endswith("FISHEYE")
        views[camera.camera_id] = lens_fields(where, view, fisheye, given)
    return views


def _parameters(where: str, model: str) -> tuple[str, ...]:
    """Names of a model's parameters."""
    if model not in _PARAMETERS:
        expected = f"{', '.join(_PARAMETERS)} (undistort the images with COLMAP)"
        raise InvalidInput(f"{where}: model {reprlib.repr(model)}, expected one of {expected}")
    return _PARAMETERS[model]


def _pose(image: _Image) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """World-to-camera rotation, and the camera's centre in the world."""
    quaternion, translation = np.array(image.pose[:4]), np.array(image.pose[4:])
    largest = np.abs(quaternion).max()
    if not (np.isfinite(largest) and largest > 0 and np.isfinite(translation).all()):
        raise InvalidInput(
            f"{image.where}: pose {image.pose}, expected a finite rotation and position"
        )
    # Normalised twice, because squares of very large or small floats would overflow or vanish.
    quaternion = quaternion / largest
    rotation = rotation_matrix(quaternion / np.linalg.norm(quaternion))
    with np.errstate(over="ignore", invalid="ignore"):
        return rotation, -rotation.T @ translation


def _system_encoding() -> str:
    if sys.version_info >= (3, 11):
        return locale.getencoding()
    return locale.getpreferredencoding(False)  # UTF-8 in Python's UTF-8 mode


def _name(raw: bytes) -> str:
    """Decode a name: UTF-8 or, as on Windows, the system's code page; other bytes are escaped."""
    for encoding in ("utf-8", _system_encoding()):
        with suppress(UnicodeDecodeError, LookupError):
            return raw.decode(encoding)
    return raw.decode("ascii", "backslashreplace")


def _read_binary(
    path: Path, parse: Callable[[Path, FileBytes, ByteReader], T], smallest: int
) -> list[T]:
    """All entries of a file, each of `smallest` bytes or more."""
    with opened(path) as data:
        reader = ByteReader(data, str(path))
        try:
            (count,) = reader.unpack("Q")
            if count > (len(data) - reader.position) // smallest:
                raise InvalidInput(
                    f"{path}: {counted(count, 'entry')}, too many for {counted(len(data), 'byte')}"
                )
            entries = [parse(path, data, reader) for _ in range(count)]
        except TruncatedStream as error:
            raise InvalidInput(str(error)) from error
        if reader.position < len(data):
            surplus = len(data) - reader.position
            raise InvalidInput(
                f"{path}: {counted(surplus, 'byte')} after the last entry, expected none"
            )
    return entries


def _binary_camera(path: Path, _: FileBytes, reader: ByteReader) -> _Intrinsics:
    camera_id, number, width, height = reader.unpack("IiQQ")
    model = _MODELS[number] if 0 <= number < len(_MODELS) else f"number {number}"
    # The number of parameters is known only for supported models.
    count = len(_parameters(f"{path}: camera {camera_id}", model))
    return _Intrinsics(camera_id, model, width, height, reader.unpack(f"{count}d"))


def _binary_image(path: Path, data: FileBytes, reader: ByteReader) -> _Image:
    image_id, *pose, camera_id = reader.unpack("I7dI")
    where = f"{path}: image {image_id}"
    name = bytes(data[reader.position : reader.position + _MAX_NAME + 1])
    if b"\0" not in name:
        raise InvalidInput(f"{where}: no end of its name in {counted(len(name), 'byte')}")
    name = name[: name.index(b"\0")]
    reader.take(len(name) + 1)
    (points,) = reader.unpack("Q")
    reader.skip(24 * points)
    return _Image(where, tuple(pose), camera_id, name)


class _Lines:
    """The lines of a text file; only short ones are kept in memory."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path = path
        self._file = file
        self._number = 0

    @property
    def where(self) -> str:
        return f"{self._path}: line {self._number}"

    def entry(self) -> bytes:
        """The next line that is neither blank nor a comment; empty at the end of the file."""
        while line := self._file.readline(_MAX_LINE):
            self._number += 1
            if len(line) == _MAX_LINE:
                raise InvalidInput(f"{self.where}: expected less than {_MAX_LINE} bytes")
            # Editors of Windows begin files with this mark.
            line = line.removeprefix(BOM_UTF8 if self._number == 1 else b"").strip()
            if line and not line.startswith(b"#"):
                return line
        return b""

    def skip_points(self) -> None:
        """Skip an image's line of 2D points, which may be empty or, at the end, missing."""
        self._number += 1
        end, words, apart = b"", 0, True
        while part := self._file.readline(1 << 16):
            words += len(part.split()) - (not apart and not part[:1].isspace())
            end, apart = (end + part)[-64:], part[-1:].isspace()
            if part.endswith(b"\n"):
                break
        # If empty lines were lost, this line describes an image: nine numbers and a name.
        for word in end.split()[-1:]:
            if words % 3 or not word.removeprefix(b"-").isdigit():
                raise InvalidInput(
                    f"{self.where}: {counted(words, 'word')}, {word!r} at its end, expected 2D "
                    "points (X Y ID) or none"
                )


def _read_text(path: Path, parse: Callable[[_Lines, bytes], T]) -> list[T]:
    try:
        with open(path, "rb") as file:
            lines = _Lines(path, file)
            return [parse(lines, line) for line in iter(lines.entry, b"")]
    except OSError as error:
        raise InvalidInput(f"{path}: {error.strerror}") from error


def _text_camera(lines: _Lines, line: bytes) -> _Intrinsics:
    fields = line.split()
    if len(fields) < 4:
        raise InvalidInput(
            f"{lines.where}: {counted(len(fields), 'field')}, expected at least 4 of a camera"
        )
    camera_id, width, height = (_parse(lines.where, _whole, fields[i]) for i in (0, 2, 3))
    parameters = tuple(_parse(lines.where, float, field) for field in fields[4:])
    return _Intrinsics(camera_id, fields[1].decode("latin-1"), width, height, parameters)


def _text_image(lines: _Lines, line: bytes) -> _Image:
    # The name comes last and may contain spaces.
    fields = line.split(maxsplit=9)
    where = lines.where
    if len(fields) < 10:
        raise InvalidInput(f"{where}: {counted(len(fields), 'field')}, expected 10 of an image")
    _parse(where, int, fields[0])
    pose = tuple(_parse(where, float, field) for field in fields[1:8])
    lines.skip_points()
    return _Image(where, pose, _parse(where, int, fields[8]), fields[9])


def _parse(where: str, kind: Callable[[bytes], T], field: bytes) -> T:
    try:
        # Python would accept 1_000, and would take very long to parse a long number.
        if b"_" not in field and len(field) <= 64:
            return kind(field)
    except ValueError:
        pass
    expected = "a number" if kind is float else "an integer"
    raise InvalidInput(f"{where}: {reprlib.repr(field)}, expected {expected}")


def _whole(field: bytes) -> int:
    """Parse an integer, which some programs write as a float."""
    if b"." not in field:
        return int(field)
    number = float(field)
    if not (number.is_integer() and abs(number) < 1 << 53):
        raise ValueError(field)
    return int(number)

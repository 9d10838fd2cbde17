"""Files of a SOG scene: images and their pixels, and `meta.json`."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.format_table import STREAMED, UNBUNDLED, ZIP
from gs_codec.formats import images
from gs_codec.formats.limits import DECODED_BYTES, is_file_name, refusing
from gs_codec.formats.zip_file import Archive, only_scene, opened_zip
from gs_codec.runtime.json_text import parse_json
from gs_codec.runtime.mapped import FileBytes, located, total_bytes
from gs_codec.runtime.wording import counted

#: Number of files of each group.
_FILES = {"means": 2, "scales": 1, "quats": 1, "sh0": 1, "shN": 2}

_TABLE = 256
_FLOAT32 = float(np.finfo(np.float32).max)

#: Number of palette rows side by side in its image.
PALETTE_COLUMNS = 64

#: The last byte of a quaternion is this value plus the index of the omitted component.
FIRST_TAG = 252

#: Maximum bytes of a `meta.json`.
_META_BYTES = 1 << 22

#: First bytes of a PNG.
_PNG = b"\x89PNG\r\n\x1a\n"

#: Flag of an animation in an extended WebP file.
_ANIMATION = 2


@dataclass(frozen=True)
class Meta:
    """Contents of `meta.json`.

    Attributes
    ----------
    version : {1, 2}
    count : int
    model : str
        How to render the scene: ``default``, ``antialiased`` or other.
    antialiased : bool
        Whether it uses opacity compensation, stated by `model` or as in the specification.
    files : dict of str to list of str
        Image names of each group that is present.
    means : ndarray, shape (2, 3)
        Lower and upper bounds of the logarithms of centres.
    tables : dict of str to ndarray
        Values of the bytes of ``scales``, ``sh0`` and ``shN``, shape (256, 3); in version 1 ``sh0``
        has a fourth column for opacities.
    bands : int or None
        SH degree; unknown in version 1.
    palette : int
        Number of rows of the SH-AC palette.
    """

    version: int
    count: int
    model: str
    antialiased: bool
    files: dict[str, list[str]]
    means: NDArray[np.float64]
    tables: dict[str, NDArray[np.float32]]
    bands: int | None
    palette: int

    @property
    def stated_size(self) -> tuple[int, int]:
        """Number of Gaussians and SH degree; degree 3 if it is not stated."""
        return self.count, 3 if self.bands is None else self.bands


def parse_meta(data: bytes) -> Meta:
    """Parse and check `meta.json`.

    Raises InvalidInput if it is not JSON, or not of SOG version 1 or 2.
    """
    with refusing(UNBUNDLED):
        meta = parse_json(data)
    if isinstance(meta, dict) and "voxelResolution" in meta:
        raise InvalidInput("voxels for collisions (.voxel.json), without Gaussians")
    version = 1 if not isinstance(meta, dict) else meta.get("version", 1)
    if version not in (1, 2) or isinstance(version, bool | float):
        raise InvalidInput(f"meta.json: version {version!a:.40}, expected 1 or 2")
    means = _member(meta, "means")
    files = {
        name: _names(_member(meta, name), name, number)
        for name, number in _FILES.items()
        if name != "shN" or meta.get("shN") is not None
    }
    if version == 1:
        count = _whole(_list(means, "means", "shape", None)[0], "means.shape")
        bands, palette = (None, 1 << 16) if "shN" in files else (0, 0)
        tables = _lines(meta, files)
    else:
        count = _whole(meta.get("count"), "count")
        bands = palette = 0
        if "shN" in files:
            bands = _whole(meta["shN"].get("bands"), "shN.bands")
            palette = _whole(meta["shN"].get("count"), "shN.count")
        if bands > 3 or palette > 1 << 16:
            raise InvalidInput(
                f"meta.json: shN of {counted(bands, 'band')} and {counted(palette, 'row')}"
            )
        tables = {
            name: np.repeat(_table(meta[name], name)[:, None], 3, axis=1)
            for name in ("scales", "sh0", "shN")
            if name in files
        }
    if bands == 0:
        files.pop("shN", None)
    model = meta.get("model", "default")
    if not isinstance(model, str):
        raise InvalidInput(f"meta.json: model {model!a:.40}, expected a name")
    flag = meta.get("antialias", False)
    if not isinstance(flag, bool):
        raise InvalidInput(f"meta.json: antialias {flag!a:.40}, expected true or false")
    antialiased = flag or model == "antialiased"
    bounds = np.array([_numbers(means, "means", end, 3) for end in ("mins", "maxs")])
    return Meta(version, count, model, antialiased, files, bounds, tables, bands, palette)


def _lines(meta: dict[str, Any], files: dict[str, list[str]]) -> dict[str, NDArray[np.float32]]:
    """Version 1: 256 values between the bounds of each channel."""
    share = (np.arange(_TABLE) / (_TABLE - 1))[:, None]
    tables = {}
    for name, channels in (("scales", 3), ("sh0", 4), ("shN", 1)):
        if name not in files:
            continue
        low, high = (
            np.array(_numbers(meta[name], name, end, channels)) for end in ("mins", "maxs")
        )
        values = (low * (1 - share) + high * share).astype(np.float32)
        tables[name] = np.repeat(values, 3, axis=1) if channels == 1 else values
    return tables


def _table(group: dict[str, Any], name: str) -> NDArray[np.float32]:
    """Version 2: a codebook, at most 256 values."""
    values = _list(group, name, "codebook", None)
    if not 1 <= len(values) <= _TABLE:
        raise InvalidInput(f"meta.json: {name}.codebook of {len(values)}, expected 1 to {_TABLE}")
    table = np.full(_TABLE, np.nan, np.float32)
    table[: len(values)] = [_number(value, f"{name}.codebook") for value in values]
    return table


def _member(parent: Any, name: str) -> dict[str, Any]:
    value = parent.get(name) if isinstance(parent, dict) else None
    if not isinstance(value, dict):
        raise InvalidInput(f"meta.json: no '{name}', not a SOG scene")
    return value


def _list(group: dict[str, Any], name: str, key: str, length: int | None) -> list[Any]:
    value = group.get(key)
    if not isinstance(value, list) or not value or length not in (None, len(value)):
        expected = "a list" if length is None else f"a list of {length}"
        raise InvalidInput(f"meta.json: {name}.{key} is not {expected}")
    return value


def _names(group: dict[str, Any], name: str, number: int) -> list[str]:
    names = _list(group, name, "files", number)
    for item in names:
        if not is_file_name(item):
            raise InvalidInput(f"meta.json: {name}.files has {item!a:.60}, expected a file's name")
    return names


def _numbers(group: dict[str, Any], name: str, key: str, length: int) -> list[float]:
    """A list of `length` numbers; if `length` is 1, a plain number is also accepted."""
    where = f"{name}.{key}"
    if length == 1 and not isinstance(group.get(key), list):
        return [_number(group.get(key), where)]
    return [_number(value, where) for value in _list(group, name, key, length)]


def _number(value: Any, where: str) -> float:
    usable = isinstance(value, int | float) and not isinstance(value, bool)
    if not usable or not abs(value) <= _FLOAT32 or not math.isfinite(value):
        raise InvalidInput(f"meta.json: {where} has {value!a:.40}, expected a float32 number")
    return float(value)


def _whole(value: Any, where: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 1 << 31:
        raise InvalidInput(f"meta.json: {where} is {value!a:.40}, expected a whole number")
    return value


@dataclass(frozen=True)
class Files:
    """The files in a folder, on disk or in a zip.

    Attributes
    ----------
    folder : Path
        Folder; inside the zip, if there is one.
    archive : Archive, optional
    """

    folder: Path | PurePosixPath
    archive: Archive | None = None

    def read(self, name: str, limit: int) -> bytes:
        """The bytes of a file.

        Raises InvalidInput if it is missing, encrypted, or of more than `limit` bytes.
        """
        if self.archive:
            return self.archive.read(str(self.folder / name), limit)
        path = Path(self.folder / name)
        with refusing(f"file {name!a:.60}"):
            if not path.is_file() or path.stat().st_size > limit:
                raise InvalidInput(
                    f"file {name!a:.60}: no file, or of more than {counted(limit, 'byte')}"
                )
            return path.read_bytes()

    def in_folder_of(self, name: str) -> Files:
        """The files in the folder of a file, which may be a subfolder of this one."""
        return Files((self.folder / name).parent, self.archive)

    def paths(self, names: Iterable[str]) -> list[Path]:
        """Paths of these files; none in a zip."""
        return [] if self.archive else [Path(self.folder / name) for name in names]

    def stored_bytes(self, names: Iterable[str]) -> int:
        """Total size of these files, if they exist; 0 in a zip."""
        return total_bytes(self.paths(names))


@dataclass(frozen=True)
class Unit:
    """A SOG scene with only its `meta.json` read.

    Attributes
    ----------
    files : Files
        The files next to its `meta.json`.
    meta : Meta
    images : tuple of str
        Names of its images, among `files`.
    stored_bytes : int
        Size of all its files; 0 in a zip.
    """

    files: Files
    meta: Meta
    images: tuple[str, ...]
    stored_bytes: int


@contextmanager
def opened_files(path: Path, data: memoryview | FileBytes) -> Iterator[tuple[Files, str]]:
    """The files of the scene in a zip or JSON file, and the name of its `meta.json`.

    Raises InvalidInput if the zip is not valid, or does not contain exactly one scene.
    """
    if data[: len(ZIP)] != ZIP:
        yield Files(path.parent), path.name
        return
    with opened_zip(path) as archive:
        yield Files(PurePosixPath(), archive), scene_in(archive)


def scene_in(archive: Archive) -> str:
    """The name of the `meta.json` or `lod-meta.json` of the scene in a zip.

    Raises InvalidInput if there is none, or several scenes could be meant.
    """
    streamed = archive.named(STREAMED)
    folders = tuple(name.removesuffix(STREAMED) for name in streamed)

    def is_part(name: str) -> bool:
        folder = name.removesuffix(UNBUNDLED)
        return folder.startswith(folders) and folder not in folders

    others = [name for name in archive.named(UNBUNDLED) if not is_part(name)]
    return only_scene(streamed + others, f"{UNBUNDLED}, expected a SOG scene; unpack others")


def unit_of(files: Files, name: str) -> Unit:
    """The scene described by a `meta.json` among these files.

    Raises InvalidInput if it is missing or not valid.
    """
    meta, image_files = parse_meta(files.read(name, _META_BYTES)), files.in_folder_of(name)
    images = tuple(chain.from_iterable(meta.files.values()))
    stored = files.stored_bytes([name]) + image_files.stored_bytes(images)
    return Unit(image_files, meta, images, stored)


@contextmanager
def opened_unit(files: Files, name: str) -> Iterator[Unit]:
    """The scene of a JSON file, or of a zip, among these files; raises like `unit_of`."""
    if name.lower().endswith(".json"):
        yield unit_of(files, name)
        return
    # Compressing a zip again hardly shrinks it.
    most = 2 * files.archive.file_bytes if files.archive else DECODED_BYTES
    with opened_zip(io.BytesIO(files.read(name, most))) as archive:
        unit = unit_of(Files(PurePosixPath(), archive), scene_in(archive))
        yield replace(unit, stored_bytes=files.stored_bytes([name]))


def read_pixels(data: bytes, name: str, most: int) -> NDArray[np.uint8]:
    """Pixels ``(height, width, 4)`` of a WebP or PNG image, RGBA.

    Raises InvalidInput if it is neither, is animated, or has more than `most` pixels.
    """

    def check_size(width: int, height: int) -> None:
        if width * height > most:
            raise InvalidInput(f"{width}x{height} pixels, expected at most {most}")

    # Lossy images are accepted: some files of version 1 have them.
    with located(f"image '{name}'"):
        if _is_animated(data):
            raise InvalidInput("an animation, expected a still image")
        if data.startswith(_PNG) and data[24:25] == b"\x10":
            raise InvalidInput("16 bits per channel, expected 8")
        return images.read_pixels(io.BytesIO(data), ("WEBP", "PNG"), check_size)


def _is_animated(data: bytes) -> bool:
    if data.startswith(_PNG):
        return b"acTL" in data.partition(b"IDAT")[0]
    return data[12:16] == b"VP8X" and bool(data[20:21]) and bool(data[20] & _ANIMATION)

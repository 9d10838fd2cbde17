"""Containers of `.rad` files: a description in JSON, and chunks of Gaussians.

A chunk has its own description, and each property of its Gaussians separately, mostly as a deflate
stream. Chunks follow the description, or are `.radc` files next to the `.rad`. A `.radc` alone is a
part of a scene.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.format_table import RAD
from gs_codec.formats.limits import refusing
from gs_codec.runtime.json_text import parse_json
from gs_codec.runtime.mapped import FileBytes, located, opened
from gs_codec.runtime.wording import counted
from gs_codec.scene import SH_COEFFICIENTS

MAGIC, CHUNK_MAGIC = RAD.signatures
VERSION = 1

#: Descriptions and lengths are padded to multiples of this.
UNIT = 8

#: Maximum bytes of a description.
_META_BYTES = 1 << 22

_FLOATS = ("f32", "f16")
_PLANES = (*_FLOATS, "f32_lebytes", "f16_lebytes")
_SH = (*_FLOATS, "r8", "r8_delta", "s8", "s8_delta")

#: Number of values per Gaussian, and possible encodings, of each property.
PROPERTIES = {
    "center": (3, _PLANES),
    "alpha": (1, (*_FLOATS, "r8")),
    "rgb": (3, (*_FLOATS, "r8", "r8_delta")),
    "scales": (3, ("f32", "ln_0r8", "ln_f16")),
    "orientation": (3, (*_FLOATS, "oct88r8")),
    **{f"sh{band}{code}": (6 * band + 3, _SH) for band in (1, 2, 3) for code in ("", "_code")},
    "sh_label": (1, ("u16", "u32")),
    "child_count": (1, ("u16",)),
    "child_start": (1, ("u32",)),
}

#: Types of stored values, whatever their order; others are bytes.
_TYPES = {"f32": "<f4", "f16": "<f2", "ln_f16": "<f2", "s8": "i1", "u16": "<u2", "u32": "<u4"}
_ORDERS = re.compile("_(lebytes|delta)$")


class Values(NamedTuple):
    """Stored values of a property, one row each: ``(rows, N)``; their encoding and bounds."""

    numbers: NDArray
    encoding: str
    low: float
    high: float

    def scaled(self) -> NDArray[np.float32]:
        """The values; bytes are relative to the bounds."""
        with np.errstate(over="ignore", invalid="ignore"):
            if self.encoding.startswith("r8"):
                share = self.numbers / np.float32(255)
                return share * np.float32(self.high - self.low) + np.float32(self.low)
            if self.encoding.startswith("s8"):
                return self.numbers / np.float32(127) * np.float32(self.high)
            return self.numbers.astype(np.float32, copy=False)


@dataclass(frozen=True)
class Chunk:
    """A chunk with only its description read.

    Attributes
    ----------
    data : FileBytes
    count : int
        Number of Gaussians.
    sh_degree : int
    properties : mapping of str to mapping
        Descriptions of properties.
    start : int
        Where the data of properties begin.
    """

    data: FileBytes
    count: int
    sh_degree: int
    properties: dict[str, dict[str, Any]]
    start: int

    def read(self, name: str, most: int | None = None) -> Values:
        """The values of a property.

        With `most`, as many as there are, but at most this number of bytes; else one for each
        Gaussian. Raises InvalidInput if there are fewer or more, or the property is missing.
        """
        with located(f"property '{name}'"):
            if name not in self.properties:
                raise InvalidInput("missing")
            about, (rows, known) = self.properties[name], PROPERTIES[name]
            encoding = about.get("encoding")
            if encoding not in known:
                raise InvalidInput(f"encoding {encoding!a:.40}, expected {', '.join(known)}")
            dtype = np.dtype(_TYPES.get(_ORDERS.sub("", encoding), "u1"))
            wanted = rows * self.count * dtype.itemsize if most is None else most
            raw = self._unpacked(about, wanted)
            if len(raw) % (rows * dtype.itemsize) or (most is None and len(raw) != wanted):
                raise InvalidInput(f"{counted(len(raw), 'byte')}, expected {wanted:,}")
            bounds = (_number(about, end) for end in _ends(encoding))
            return Values(_rows(raw, encoding, dtype, rows), encoding, *bounds)

    def _unpacked(self, about: dict[str, Any], most: int) -> bytes:
        """The bytes of a property, up to one more than `most`."""
        offset, size = whole(about, "offset"), whole(about, "bytes")
        if self.start + offset + size > len(self.data):
            raise InvalidInput(
                f"{counted(size, 'byte')} at {self.start + offset}, of a chunk of "
                f"{len(self.data):,}"
            )
        data = self.data[self.start + offset : self.start + offset + size]
        compression = about.get("compression")
        if compression not in (None, "gz"):
            raise InvalidInput(f"compression {compression!a:.40}, expected gz")
        if compression is None:
            return bytes(data[: most + 1])
        with refusing("deflate stream"):
            inflater = zlib.decompressobj(-15)
            raw = inflater.decompress(data, most + 1)
        if len(raw) <= most and not inflater.eof:
            raise InvalidInput("deflate stream: cut off")
        return raw


def _rows(raw: bytes, encoding: str, dtype: np.dtype, rows: int) -> NDArray:
    if encoding == "oct88r8":
        return np.frombuffer(raw, np.uint8).reshape(-1, 3).T
    if encoding.endswith("lebytes"):
        planes = np.frombuffer(raw, np.uint8).reshape(dtype.itemsize, -1)
        return np.ascontiguousarray(planes.T).view(dtype).reshape(rows, -1)
    if encoding.endswith("delta"):
        sums = np.frombuffer(raw, np.uint8).reshape(rows, -1).cumsum(axis=1, dtype=np.uint8)
        return sums.view(dtype)
    return np.frombuffer(raw, dtype).reshape(rows, -1)


def _ends(encoding: str) -> tuple[str | None, str | None]:
    """The bounds that an encoding needs."""
    if encoding in ("r8", "r8_delta", "ln_0r8"):
        return "min", "max"
    return None, "max" if encoding.startswith("s8") else None


def _number(about: dict[str, Any], key: str | None) -> float:
    """A bound; 0 without a key."""
    value = 0 if key is None else about.get(key)
    limit = float(np.finfo(np.float32).max)
    if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) <= limit:
        raise InvalidInput(f"{key} {value!a:.40}, expected a float32 number")
    return float(value)


def whole(about: dict[str, Any], key: str, default: int | None = None) -> int:
    """A whole number of a description."""
    value = about.get(key, default)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 1 << 40:
        raise InvalidInput(f"{key} {value!a:.40}, expected a whole number")
    return value


def _described(data: FileBytes, magic: bytes) -> tuple[dict[str, Any], int]:
    """A description, and where the rest of the data begins."""
    head = bytes(data[:UNIT])
    size = int.from_bytes(head[4:], "little")
    if head[:4] != magic or len(head) < UNIT:
        raise InvalidInput(f"begins with {head[:4]!a}, expected {magic!a} (.rad)")
    if not 0 < size <= min(_META_BYTES, len(data) - UNIT):
        raise InvalidInput(f"description of {counted(size, 'byte')}, of {len(data):,}")
    with refusing("description"):
        about = parse_json(bytes(data[UNIT : UNIT + size]))
    version = about.get("version") if isinstance(about, dict) else None
    if version != VERSION or isinstance(version, bool | float):
        raise InvalidInput(f"version {version!a:.40}, expected {VERSION}")
    return about, UNIT + size + -size % UNIT


def _degree(about: dict[str, Any]) -> int:
    degree = whole(about, "maxSh", 0)
    if degree >= len(SH_COEFFICIENTS):
        raise InvalidInput(f"SH degree {degree}, expected 0 to {len(SH_COEFFICIENTS) - 1}")
    return degree


def _chunk(data: FileBytes) -> Chunk:
    about, start = _described(data, CHUNK_MAGIC)
    found = about.get("properties")
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise InvalidInput("properties: expected a list")
    properties = {str(each.get("property")): each for each in found}
    if len(properties) < len(found):
        raise InvalidInput("properties: two with the same name")
    return Chunk(data, whole(about, "count"), _degree(about), properties, start + UNIT)


@dataclass(frozen=True)
class RadFile:
    """A `.rad` file with only its description read, or a `.radc` file.

    Attributes
    ----------
    path : Path
    data : FileBytes
    about : mapping, optional
        The description; None in a `.radc`.
    start : int
        Where chunks begin.
    """

    path: Path
    data: FileBytes
    about: dict[str, Any] | None
    start: int

    @classmethod
    def of(cls, path: Path, data: FileBytes) -> RadFile:
        """Read the description; `InvalidInput` if it is not valid."""
        if bytes(data[: len(MAGIC)]) == CHUNK_MAGIC:
            return cls(path, data, None, 0)
        about, start = _described(data, MAGIC)
        if about.get("type") != "gsplat":
            raise InvalidInput(f"type {about.get('type')!a:.40}, expected gsplat")
        return cls(path, data, about, start)

    @property
    def stated_size(self) -> tuple[int, int]:
        """Number of Gaussians of all levels, and SH degree."""
        if self.about is None:
            only = _chunk(self.data)
            return only.count, only.sh_degree
        return whole(self.about, "count"), _degree(self.about)

    def _ranges(self) -> Sequence[dict[str, Any]]:
        ranges = [] if self.about is None else self.about.get("chunks")
        if not isinstance(ranges, list) or not all(isinstance(each, dict) for each in ranges):
            raise InvalidInput("chunks: expected a list")
        return ranges

    @property
    def others(self) -> list[Path]:
        """The `.radc` files next to a `.rad`."""
        names = [each["filename"] for each in self._ranges() if "filename" in each]
        for name in names:
            plain = isinstance(name, str) and name.isprintable() and not set(name) & set("/\\:")
            if not plain or name.strip(".") == "" or len(name) > 255:
                raise InvalidInput(f"chunk {name!a:.60}, expected a file's name")
        if len(set(names)) < len(names):
            raise InvalidInput("chunks: two in the same file")
        return [self.path.with_name(name) for name in names]

    def chunks(self) -> Iterator[Chunk]:
        """All chunks, each open until the next; `InvalidInput` if one is not valid."""
        if self.about is None:
            yield _chunk(self.data)
        others = iter(self.others)
        for number, each in enumerate(self._ranges()):
            with located(f"chunk {number}"):
                if "filename" in each:
                    with opened(next(others)) as data:
                        yield _chunk(data)
                else:
                    yield _chunk(self._window(whole(each, "offset"), whole(each, "bytes")))

    def _window(self, offset: int, size: int) -> FileBytes:
        if self.start + offset + size > len(self.data):
            raise InvalidInput(
                f"chunk of {counted(size, 'byte')} at {self.start + offset}, of a file of "
                f"{len(self.data):,}"
            )
        return self.data.window(self.start + offset, size)

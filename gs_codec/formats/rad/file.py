"""Containers of `.rad` files: a description in JSON, and chunks of Gaussians.

A chunk has its own description, and each property of its Gaussians separately, mostly as a deflate
stream. Chunks follow the description, or are `.radc` files next to the `.rad`. A `.radc` alone is a
part of a scene.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.format_table import RAD
from gs_codec.formats.limits import is_file_name, refusing
from gs_codec.runtime.json_text import parse_json
from gs_codec.runtime.mapped import FileBytes, located, opened
from gs_codec.runtime.wording import counted
from gs_codec.scene import SH_COEFFICIENTS

MAGIC, CHUNK_MAGIC = RAD.signatures
VERSION = 1

#: Descriptions and lengths are padded to multiples of this.
UNIT = 8

#: Maximum bytes of a description. LichtFeld Studio writes 8 MB for 137 million Gaussians, in chunks
#: of 2,048.
_META_BYTES = 1 << 24

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

#: Encodings of values between two bounds.
_BOUNDED = ("r8", "r8_delta", "s8", "s8_delta", "ln_0r8")


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


class Chunk:
    """A chunk with only its description read: a number of Gaussians, and their properties."""

    def __init__(self, data: FileBytes) -> None:
        about, start = _described(data, CHUNK_MAGIC)
        self.data, self.start, self.count = data, start + UNIT, _whole(about, "count")
        found = _dictionaries(about, "properties")
        self.properties = {str(each.get("property")): each for each in found}
        if len(self.properties) < len(found):
            raise InvalidInput("properties: two with the same name")

    def read(self, name: str, most: int | None = None) -> Values:
        """The values of a property: one for each Gaussian or, with `most`, up to so many bytes.

        Raises InvalidInput if the property is missing, or not valid.
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
            bounds = (about.get("min", 0), about.get("max")) if encoding in _BOUNDED else (0, 0)
            return Values(_rows(raw, encoding, dtype, rows), encoding, *map(_number, bounds))

    def _unpacked(self, about: dict[str, Any], most: int) -> bytes:
        """The bytes of a property, up to one more than `most`."""
        data = _part(self.data, self.start + _whole(about, "offset"), _whole(about, "bytes"))
        compression = about.get("compression")
        if compression not in (None, "gz"):
            raise InvalidInput(f"compression {compression!a:.40}, expected gz")
        if compression is None:
            return bytes(data[: most + 1])
        with refusing("deflate stream"):
            inflater = zlib.decompressobj(-15)
            raw = inflater.decompress(data[:], most + 1)
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


def _number(value: Any) -> float:
    limit = float(np.finfo(np.float32).max)
    if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) <= limit:
        raise InvalidInput(f"bound {value!a:.40}, expected a float32 number")
    return float(value)


def _whole(about: dict[str, Any], key: str) -> int:
    value = about.get(key, 0)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 1 << 40:
        raise InvalidInput(f"{key} {value!a:.40}, expected a whole number")
    return value


def _dictionaries(about: dict[str, Any], key: str) -> list[dict[str, Any]]:
    found = about.get(key)
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise InvalidInput(f"{key}: expected a list")
    return found


def _part(data: FileBytes, start: int, size: int) -> FileBytes:
    if start + size > len(data):
        raise InvalidInput(f"{counted(size, 'byte')} at {start}, of {len(data):,}")
    return data.window(start, size)


def _described(data: FileBytes, magic: bytes) -> tuple[dict[str, Any], int]:
    """A description, and where the rest of the data begins."""
    head = bytes(data[:UNIT])
    size = int.from_bytes(head[4:], "little")
    if head[:4] != magic or not 0 < size <= min(_META_BYTES, len(data) - UNIT):
        raise InvalidInput(f"begins with {head!a}, expected {magic!a} and a description (.rad)")
    with refusing("description"):
        about = parse_json(bytes(data[UNIT : UNIT + size]))
    version = about.get("version") if isinstance(about, dict) else None
    if version != VERSION or isinstance(version, bool | float):
        raise InvalidInput(f"version {version!a:.40}, expected {VERSION}")
    return about, UNIT + size + -size % UNIT


class RadFile:
    """A `.rad` or `.radc` file with only its description read; `InvalidInput` if it is not valid.

    `stated_size` has the number of Gaussians of all levels and the SH degree, `others` the `.radc`
    files next to a `.rad`.
    """

    def __init__(self, path: Path, data: FileBytes) -> None:
        self.data, self.is_part = data, bytes(data[: len(MAGIC)]) == CHUNK_MAGIC
        about, self.start = _described(data, CHUNK_MAGIC if self.is_part else MAGIC)
        if not self.is_part and about.get("type") != "gsplat":
            raise InvalidInput(f"type {about.get('type')!a:.40}, expected gsplat")
        _, degree = self.stated_size = _whole(about, "count"), _whole(about, "maxSh")
        if degree >= len(SH_COEFFICIENTS):
            raise InvalidInput(f"SH degree {degree}, expected 0 to {len(SH_COEFFICIENTS) - 1}")
        self.ranges = [] if self.is_part else _dictionaries(about, "chunks")
        own = [_whole(each, "bytes") for each in self.ranges if "filename" not in each]
        if sum(own) > len(data):  # reading them would take long
            raise InvalidInput(f"chunks of {counted(sum(own), 'byte')}, of {len(data):,}")
        names = [each["filename"] for each in self.ranges if "filename" in each]
        if not all(map(is_file_name, names)) or len(set(names)) < len(names):
            raise InvalidInput(f"chunks in {names[0]!a:.60}..., expected names of different files")
        self.others = [path.with_name(name) for name in names]

    def chunks(self) -> Iterator[Chunk]:
        """All chunks, each open until the next; `InvalidInput` if one is not valid."""
        if self.is_part:
            yield Chunk(self.data)
        others = iter(self.others)
        for number, each in enumerate(self.ranges):
            with located(f"chunk {number}"):
                if "filename" in each:
                    with opened(next(others)) as data:
                        yield Chunk(data)
                else:
                    start = self.start + _whole(each, "offset")
                    yield Chunk(_part(self.data, start, _whole(each, "bytes")))

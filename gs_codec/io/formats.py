"""Formats of scenes beside `.egs`, told apart by content first and by suffix second."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from gs_codec.errors import InvalidInput
from gs_codec.io import packed_ply, sog, spz
from gs_codec.io.limits import float_bytes
from gs_codec.io.mapped import located, opened
from gs_codec.io.packed_ply import is_packed
from gs_codec.io.ply import read_ply
from gs_codec.io.ply_header import PlyHeader, read_header
from gs_codec.io.sog import read_sog, sog_bytes
from gs_codec.io.sog_files import ZIP
from gs_codec.io.splat import RECORD, read_splat
from gs_codec.io.spz import GZIP, MAGIC, read_spz
from gs_codec.scene import Scene

Format = Literal["ply", "splat", "spz", "sog"]

_BY_SUFFIX: dict[str, Format] = {
    ".ply": "ply",
    ".splat": "splat",
    ".spz": "spz",
    ".sog": "sog",
    ".json": "sog",
}

_BY_CONTENT: tuple[tuple[bytes, Format], ...] = (
    (b"ply\n", "ply"),
    (b"ply\r", "ply"),
    (MAGIC, "spz"),
    (ZIP, "sog"),
)

#: So few bytes that a `.splat`, which begins with a number, may begin with them.
_BY_LITTLE: tuple[tuple[bytes, Format], ...] = ((GZIP, "spz"), (b"{", "sog"))


def tell_format(path: str | Path) -> Format:
    """The format of a file that is no `.egs`.

    Raises
    ------
    InvalidInput
        If it cannot be opened, or is none that is read.
    """
    with opened(path) as data:
        head = bytes(data[:16])
    suffix = Path(path).suffix.lower()
    known = _BY_CONTENT if suffix == ".splat" else _BY_CONTENT + _BY_LITTLE
    for begin, name in known:
        if head.startswith(begin):
            return name
    if suffix not in _BY_SUFFIX:
        raise InvalidInput(
            f"{path}: begins with {head[:4]!a}, expected .egs, {', '.join(_BY_SUFFIX)} of a scene"
        )
    return _BY_SUFFIX[suffix]


def stored_bytes(path: str | Path) -> int:
    """Size of a scene: of its file, or of all its files."""
    return sog_bytes(path) if tell_format(path) == "sog" else Path(path).stat().st_size


def stated_bytes(path: str | Path) -> int:
    """Bytes of floats that a file that is no `.egs` says it holds; nothing else of it is read.

    Raises
    ------
    InvalidInput
        If it does not say so.
    """
    sizes = {"spz": spz.stated_size, "sog": sog.stated_size}
    name = tell_format(path)
    if name in sizes:
        return float_bytes(*sizes[name](path))
    with opened(path) as data, located(path):
        if name == "splat":
            return float_bytes(len(data) // RECORD, 0)
        header = read_header(np.frombuffer(data, np.uint8))
        if is_packed(header):
            return float_bytes(*packed_ply.stated_size(header))
        return sum(4 * e.count * len(e.types) for e in header.elements if e.name == "vertex")


def is_read_in_parts(path: str | Path) -> bool:
    """Whether a file that is no `.egs` can be read without all of it being in memory."""
    return not is_compressed(path) and bool(_header_of(path).byte_order)


def is_compressed(path: str | Path) -> bool:
    """Whether a file that is no `.egs` has anything but plain numbers of a PLY."""
    return tell_format(path) != "ply" or is_packed(_header_of(path))


def _header_of(path: str | Path) -> PlyHeader:
    with opened(path) as data, located(path):
        return read_header(np.frombuffer(data, np.uint8))


def read_foreign(
    path: str | Path,
    extra: Literal["error", "keep", "drop"] = "error",
    max_bytes: int | None = None,
) -> Scene:
    """Read a scene of any format but `.egs`; of `extra` and `max_bytes` see `read_ply`.

    Raises
    ------
    InvalidInput
        If it is not a sound file of a format that is read.
    """
    readers = {"splat": read_splat, "spz": read_spz, "sog": read_sog}
    name = tell_format(path)
    return read_ply(path, extra, max_bytes) if name == "ply" else readers[name](path, max_bytes)

"""Sections besides the Gaussians: comments, extra properties, version lines of programs."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.fields import ByteReader
from gs_codec.egs.egs_file import (
    EgsFile,
    Section,
    SectionId,
    file_parts,
    in_file_order,
    section_sizes,
)
from gs_codec.egs.header import Header
from gs_codec.errors import CorruptStream, InvalidInput
from gs_codec.report import ChannelCost, EncodeReport, StageTimes
from gs_codec.runtime.arrays import empty
from gs_codec.runtime.wording import counted
from gs_codec.scene import Scene, gather, is_extra_name, other_comments

_DTYPES = tuple(np.dtype(t) for t in ("i1", "u1", "<i2", "<u2", "<i4", "<u4", "<f4", "<f8"))
_LEVEL = 6
_COMMENT_BYTES = 1 << 20
_EXTRA = "section 'extra'"

#: Maximum length of a program's version line.
MAX_LENGTH = 200


def pack_scene(
    scene: Scene,
    header: Header,
    sections: list[Section],
    order: NDArray[np.integer],
    times: StageTimes,
    costs: Sequence[ChannelCost] = (),
    rectified: int = 0,
) -> tuple[list[bytes | memoryview], EncodeReport]:
    """Assemble a file from coded sections and the scene's comments and extra properties."""
    with times.stage("container"):
        sections = in_file_order([*sections, *carried_sections(scene, order)])
        parts = file_parts(header, sections)
    return parts, EncodeReport(
        count=scene.count,
        raw_bytes=scene.float_bytes,
        section_bytes=section_sizes([(each.id, len(each.data)) for each in sections]),
        costs=list(costs),
        rectified=rectified,
        seconds=times.seconds,
        sh_degree=scene.sh_degree,
    )


def carried_sections(scene: Scene, order: NDArray[np.integer]) -> list[Section]:
    """The sections `comments` and `extra` of a scene, with Gaussians in the given order.

    Comments on coordinates and antialiasing are omitted, because the header has them.
    """
    sections = []
    if comments := other_comments(scene.comments):
        sections.append(Section(SectionId.COMMENTS, 0, write_comments(comments)))
    if scene.extra:
        sections.append(Section(SectionId.EXTRA, 0, write_extra(scene.extra, order)))
    return sections


def write_comments(comments: Iterable[str]) -> bytes:
    """Serialise comment lines."""
    text = "\n".join(comments).encode()
    if not _is_text(text):
        raise InvalidInput("comments: control or non-ASCII characters, expected plain text")
    if len(text) > _COMMENT_BYTES:
        raise InvalidInput(
            f"comments: {counted(len(text), 'byte')}, at most {_COMMENT_BYTES} can be kept"
        )
    return text


def read_comments(data: memoryview) -> tuple[str, ...]:
    """The inverse of `write_comments`."""
    text = bytes(data[: _COMMENT_BYTES + 1])
    if len(text) > _COMMENT_BYTES or not _is_text(text):
        raise CorruptStream("section 'comments': too long, or not ASCII text")
    lines = tuple(text.decode("ascii").split("\n"))
    if other_comments(lines) != lines:
        raise CorruptStream("section 'comments': coordinates or antialiasing, which the header has")
    return lines


def _is_text(data: bytes) -> bool:
    """Whether all bytes are printable ASCII, tabs, or line feeds."""
    return all(32 <= byte < 127 or byte in (9, 10) for byte in data)


def write_extra(extra: Mapping[str, NDArray], order: NDArray[np.integer]) -> bytes:
    """Serialise columns ``(N,)`` in the given order: byte planes, deflated."""
    out = bytearray(struct.pack("<H", len(extra)))
    for name, column in extra.items():
        label = name.encode()
        ordered = gather(column[None], order)[0]
        planes = empty((column.dtype.itemsize, len(ordered)), np.uint8)
        planes[:] = ordered.view(np.uint8).reshape(-1, column.dtype.itemsize).T
        packed = zlib.compress(planes.data, _LEVEL)
        kind = _DTYPES.index(column.dtype)
        out += struct.pack("<B", len(label)) + label + struct.pack("<BQ", kind, len(packed))
        out += packed
    return bytes(out)


def read_extra(data: memoryview, count: int) -> dict[str, NDArray]:
    """The inverse of `write_extra` for `count` Gaussians, in stream order."""
    packed = _unpack(data)
    return {name: _inflate(planes, count, dtype) for name, (dtype, planes) in packed.items()}


def extra_bytes(data: memoryview, count: int) -> int:
    """Number of bytes that `read_extra` would return, without inflating anything."""
    return count * sum(dtype.itemsize for dtype, _ in _unpack(data).values())


def _unpack(data: memoryview) -> dict[str, tuple[np.dtype, memoryview]]:
    """Type and deflated planes of each property."""
    reader = ByteReader(data, _EXTRA)
    packed: dict[str, tuple[np.dtype, memoryview]] = {}
    (number,) = reader.unpack("H")
    if number == 0:
        raise CorruptStream(f"{_EXTRA}: no properties, expected at least one")
    for _ in range(number):
        label = bytes(reader.take(reader.unpack("B")[0]))
        kind, size = reader.unpack("BQ")
        name = label.decode("ascii", "replace")
        if not is_extra_name(name) or name in packed:
            raise CorruptStream(f"{_EXTRA}: {name!a} is not a valid name, or occurs twice")
        if kind >= len(_DTYPES):
            raise CorruptStream(f"{_EXTRA}: type {kind}, expected 0-{len(_DTYPES) - 1}")
        packed[name] = _DTYPES[kind], reader.take(size)
    if len(reader.rest()):
        raise CorruptStream(f"{_EXTRA}: bytes after the last property")
    return packed


def _inflate(packed: memoryview, count: int, dtype: np.dtype) -> NDArray:
    rows, rest = empty((count, dtype.itemsize), np.uint8), bytes(packed)
    inflater = zlib.decompressobj()
    filled = 0
    try:
        for plane in rows.T if count else ():
            found = inflater.decompress(rest, count)
            rest = inflater.unconsumed_tail
            if len(found) < count:
                break
            plane[:] = np.frombuffer(found, np.uint8)
            filled += count
        # Only the stream's checksum may follow the last value.
        surplus = inflater.decompress(rest, 1) or inflater.unused_data or inflater.unconsumed_tail
    except zlib.error as error:
        raise CorruptStream(f"{_EXTRA}: {error}") from None
    if filled < rows.size or surplus or not inflater.eof:
        raise CorruptStream(f"{_EXTRA}: a property is not {counted(rows.size, 'byte')}")
    return rows.reshape(-1).view(dtype)


def write_line(version: str) -> bytes:
    """Serialise a version line of 1-200 printable ASCII characters."""
    return version.encode("ascii")


def read_line(file: EgsFile, section: SectionId) -> str | None:
    """The version line in section `tool` or `coder`; None if the section is missing."""
    data = file.sections.get((section, 0))
    if data is None:
        return None
    text = bytes(data[: MAX_LENGTH + 1])
    if not 1 <= len(text) <= MAX_LENGTH or any(not 32 <= byte < 127 for byte in text):
        raise CorruptStream(
            f"section '{section.label}': {counted(len(data), 'byte')}, expected "
            f"1-{MAX_LENGTH} of printable ASCII"
        )
    return text.decode("ascii")

"""Containers of `.spz` files: header, and the bytes of each attribute.

Up to version 3 a file is one gzip stream, or its content without gzip; in version 4 each attribute
is a zstd stream. Spark writes levels of detail into version 2, as a tree of Gaussians.
"""

from __future__ import annotations

import logging
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gs_codec.config import Effort
from gs_codec.errors import InvalidInput
from gs_codec.format_table import SPZ
from gs_codec.formats.extra_properties import say_degree_4, say_left_out
from gs_codec.formats.limits import check_count, refusing
from gs_codec.runtime.arrays import empty
from gs_codec.runtime.mapped import located
from gs_codec.runtime.threads import run_all
from gs_codec.runtime.wording import counted
from gs_codec.scene import DEGREE_4, SH_COEFFICIENTS

log = logging.getLogger(__name__)

#: Data of attributes; slices of a memoryview are not copies.
Bytes = bytes | memoryview

MAGIC = SPZ.signatures[0]
GZIP = SPZ.short_signatures[0]

_HEADER = struct.Struct("<4sIIBBBB")
_ZSTD_HEADER = struct.Struct("<4sIIBBBBI12x")

#: Flag of an antialiased scene.
ANTIALIASED = 1

#: Flag of a file with extensions.
_EXTENSIONS = 2

#: Flag of a file with levels of detail.
LEVELS = 0x80
_FRACTION_BITS = 24

#: Bytes per Gaussian in a tree of levels of detail.
_NODE = 6

#: Adobe's extension for coordinate systems other than the format's; its values start at 1.
_SYSTEM_EXTENSION = 0xADBE0003
SYSTEM = SPZ.system
_SYSTEMS = (
    *("LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"),
    *("LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU"),
)

#: Bytes of a gzip stream that are inflated at once.
_PIECE = 1 << 20

#: Compression levels of gzip: 0.7, 2.5 and 10 seconds of processor time per million Gaussians.
GZIP_LEVELS: Mapping[Effort, int] = {"fast": 1, "normal": 6, "high": 9}

#: The same of zstd: 0.1, 3 and 30 seconds.
_ZSTD_LEVELS: Mapping[Effort, int] = {"fast": 1, "normal": 12, "high": 19}


@dataclass(frozen=True)
class SpzHeader:
    """What the header of a file states.

    Attributes
    ----------
    version : int
        1 to 4.
    count, sh_degree : int
    fraction_bits : int
        Fraction bits of a centre.
    flags : int
        Flags: antialiased, extensions follow, and tree of levels of detail.
    """

    version: int
    count: int
    sh_degree: int
    fraction_bits: int
    flags: int

    @property
    def read_degree(self) -> int:
        """SH degree of the scene that is read."""
        return min(self.sh_degree, len(SH_COEFFICIENTS) - 1)

    @property
    def unknown(self) -> int:
        """Unknown flags."""
        return self.flags & ~(ANTIALIASED | _EXTENSIONS | (LEVELS if self.has_tree else 0))

    @property
    def has_tree(self) -> bool:
        """Whether a tree of levels of detail follows; never in version 4."""
        return bool(self.flags & LEVELS) and self.version < 4

    @property
    def sizes(self) -> tuple[int, ...]:
        """Bytes per Gaussian of centres, opacities, colours, scales, rotations and SH."""
        coefficients = (*SH_COEFFICIENTS, DEGREE_4)[self.sh_degree]
        position = 6 if self.version == 1 else 9
        return position, 1, 3, 3, 3 if self.version < 3 else 4, 3 * coefficients


def read_streams(
    path: Path, view: memoryview, max_bytes: int | None
) -> tuple[SpzHeader, list[Bytes], str]:
    """Header, bytes of each attribute, and coordinate system of a file.

    Raises InvalidInput if it is not a valid file, or decodes to more than `max_bytes`.
    """
    start = bytes(view[:8])
    if start.startswith(MAGIC) and int.from_bytes(start[4:], "little") > 3:
        header, streams, extensions = _decompress(view, max_bytes)
    elif start.startswith((GZIP, MAGIC)):
        header, streams, extensions = _read_one_stream(view, max_bytes)
    else:
        raise InvalidInput(f"begins with {start[:4]!a}, expected {MAGIC!a} or gzip (.spz)")
    if header.unknown:
        say_left_out(path, others=[f"unknown flags {header.unknown:#x}"])
    if header.sh_degree == len(SH_COEFFICIENTS):
        say_degree_4(path)
    if header.has_tree:
        size = _NODE * header.count
        tree, extensions = extensions[:size], extensions[size:]
        header, streams = _leaves(path, header, streams, tree)
    return header, streams, _read_extensions(path, extensions)


def pack_streams(header: SpzHeader, streams: Sequence[NDArray[np.uint8]], effort: Effort) -> bytes:
    """The bytes of a file of version 3 or 4, from the bytes of each attribute."""
    fields = header.count, header.sh_degree, header.fraction_bits, header.flags
    if header.version < 4:
        # Without a date, so that the same scene gives the same bytes.
        packer = zlib.compressobj(GZIP_LEVELS[effort], zlib.DEFLATED, 31)
        head = _HEADER.pack(MAGIC, header.version, *fields, 0)
        parts = [packer.compress(head), *(packer.compress(each.data) for each in streams)]
        return b"".join([*parts, packer.flush()])
    import zstandard

    filled = [stream for stream in streams if stream.size]

    def compress(stream: NDArray[np.uint8]) -> bytes:
        return zstandard.ZstdCompressor(level=_ZSTD_LEVELS[effort]).compress(stream.data)

    packed = run_all(compress, filled)
    head = _ZSTD_HEADER.pack(MAGIC, 4, *fields, len(filled), _ZSTD_HEADER.size)
    table = [struct.pack("<QQ", len(a), b.nbytes) for a, b in zip(packed, filled, strict=True)]
    return b"".join([head, *table, *packed])


def _check_header(
    version: int, fields: tuple[int, ...], file_bytes: int, max_bytes: int | None
) -> SpzHeader:
    header = SpzHeader(version, *fields)
    if header.sh_degree > len(SH_COEFFICIENTS):
        raise InvalidInput(f"SH degree {header.sh_degree}, expected 0 to 3")
    if header.fraction_bits > _FRACTION_BITS:
        raise InvalidInput(
            f"{header.fraction_bits} fractional bits, expected at most {_FRACTION_BITS}"
        )
    check_count(header.count, header.read_degree, file_bytes, max_bytes)
    return header


def stated_size(path: Path, view: memoryview) -> tuple[int, int]:
    """Number of Gaussians and SH degree stated in the header; raises like `read_spz`."""
    with located(path):
        head, _ = _head_of(view[:1024])
        _, version, *fields, _ = _HEADER.unpack(head)
        header = _check_header(version, tuple(fields), len(view), None)
        return header.count, header.read_degree


class _Inflater:
    """Inflates a gzip stream piece by piece, so that neither form of it is copied as a whole."""

    def __init__(self, data: memoryview) -> None:
        self._data, self._fed = data, 0
        self._object = zlib.decompressobj(wbits=31)

    def inflate(self, most: int) -> memoryview:
        """At most this number of further bytes; fewer only at the end."""
        inflated, size = empty((most,), np.uint8), 0
        with refusing("gzip stream"):
            while size < most and not self._object.eof:
                piece: bytes | memoryview = self._object.unconsumed_tail
                if not piece:
                    piece = self._data[self._fed : self._fed + _PIECE]
                    self._fed += len(piece)
                found = self._object.decompress(piece, most - size)
                if not found and self._fed == len(self._data):
                    break
                inflated[size : size + len(found)] = np.frombuffer(found, np.uint8)
                size += len(found)
        return inflated[:size].data

    @property
    def ended(self) -> bool:
        """Whether the stream is complete, and ends with the data."""
        whole = self._fed == len(self._data) and not self._object.unused_data
        return self._object.eof and whole


def _head_of(data: memoryview) -> tuple[bytes, _Inflater | None]:
    """The plain header; or the one in a gzip stream, and the inflater for the rest."""
    inflater = None if data[: len(MAGIC)] == MAGIC else _Inflater(data)
    head = bytes(inflater.inflate(_HEADER.size) if inflater else data[: _HEADER.size])
    if not head.startswith(MAGIC) or (inflater and len(head) < _HEADER.size):
        begin = f"{head[:4]!a}, expected {MAGIC!a}"
        raise InvalidInput(f"a gzip stream that begins with {begin} of an .spz: unpack other files")
    if len(head) < _HEADER.size:
        raise InvalidInput(f"{counted(len(head), 'byte')}, expected a header of {_HEADER.size}")
    return head, inflater


def _read_one_stream(
    data: memoryview, max_bytes: int | None
) -> tuple[SpzHeader, list[Bytes], bytes]:
    """Header, attributes and trailing data of versions 1 to 3, from a gzip stream or plain."""
    head, inflater = _head_of(data)
    _, version, *fields, _ = _HEADER.unpack(head)
    if not 1 <= version <= 3:
        where = " in a gzip stream" if inflater else ""
        raise InvalidInput(f"version {version}{where}, expected 1 to 3")
    header = _check_header(version, tuple(fields), len(data), max_bytes)
    bounds = np.cumsum([0, *(size * header.count for size in header.sizes)]).tolist()
    least = bounds[-1] + (_NODE * header.count if header.has_tree else 0)
    limit = least + (1 << 20 if header.flags & _EXTENSIONS else 0)
    body, ended = data[_HEADER.size :], True
    if inflater:
        body = inflater.inflate(limit + 1)
        while header.unknown and inflater.inflate(_PIECE):
            pass
        ended = inflater.ended
    if len(body) < least:
        raise InvalidInput(f"{counted(len(body), 'byte')} of attributes, expected {least:,}")
    if not ended or (len(body) > limit and not header.unknown):
        raise InvalidInput(
            f"bytes left over, or cut off, after {counted(least, 'byte')} of attributes"
        )
    streams: list[Bytes] = [body[a:b] for a, b in zip(bounds[:-1], bounds[1:], strict=True)]
    return header, streams, bytes(body[bounds[-1] : limit])


def _leaves(
    path: Path, header: SpzHeader, streams: list[Bytes], tree: bytes
) -> tuple[SpzHeader, list[Bytes]]:
    """The leaves of Spark's tree; other nodes are coarser versions of their descendants.

    The tree has a number of children for each Gaussian, then the index of its first child.
    Opacities, up to 2 in the tree, are in units of 2/255.
    """
    number = np.frombuffer(tree, "<u2", header.count)
    first = np.frombuffer(tree, "<u4", header.count, 2 * header.count)
    leaves = number == 0
    count = int(leaves.sum())
    if header.count and not count:
        raise InvalidInput(f"a tree of {counted(header.count, 'Gaussian')} without leaves")
    if (number + first.astype(np.int64) > header.count).any():
        log.warning("%s: one of several files; the others contain the rest of the scene", path)
    of_all = f"{count:,} of {counted(header.count, 'Gaussian')}"
    log.warning("%s: levels of detail: only the leaves were read, %s", path, of_all)
    kept = [
        np.frombuffer(stream, np.uint8).reshape(header.count, size)[leaves]
        for stream, size in zip(streams, header.sizes, strict=True)
    ]
    kept[1] = 2 * np.minimum(kept[1], 127) + (kept[1] > 127)
    return replace(header, count=count), [rows.data.cast("B") for rows in kept]


def _decompress(data: memoryview, max_bytes: int | None) -> tuple[SpzHeader, list[Bytes], bytes]:
    """Header, attributes and extensions of version 4."""
    if len(data) < _ZSTD_HEADER.size:
        raise InvalidInput(
            f"{counted(len(data), 'byte')}, expected a header of {_ZSTD_HEADER.size}"
        )
    _, version, *fields, number, table = _ZSTD_HEADER.unpack_from(data)
    if version != 4:
        raise InvalidInput(f"version {version}, expected 1 to 4")
    header = _check_header(version, tuple(fields), len(data), max_bytes)
    sizes = [size * header.count for size in header.sizes]
    wanted = sum(size > 0 for size in sizes)
    if number < wanted or (number > wanted and not header.unknown):
        raise InvalidInput(f"{counted(number, 'stream')}, expected {wanted:,}")
    offset = table + 16 * number
    if not _ZSTD_HEADER.size <= table <= offset <= len(data):
        raise InvalidInput(f"table of streams at byte {table}, of a file of {len(data)}")
    # Python before 3.12.7 crashes when it collects an error whose frames hold an iterator over a
    # memoryview.
    entries = iter(struct.iter_unpack("<QQ", bytes(data[table:offset])))
    streams: list[Bytes] = []
    for name, size in zip(_STREAMS, sizes, strict=True):
        packed, stated = next(entries) if size else (0, 0)
        if stated != size or packed > len(data) - offset:
            raise InvalidInput(
                f"stream '{name}': {counted(packed, 'byte')} packed, {stated:,} unpacked; "
                f"expected at most {len(data) - offset:,} and {size:,}"
            )
        streams.append(_decompress_stream(data[offset : offset + packed], name, size))
        offset += packed
    offset += sum(packed for packed, _ in entries)  # possible data of unknown flags
    if offset != len(data):
        raise InvalidInput(f"{counted(len(data) - offset, 'byte')} left over after the last stream")
    return header, streams, bytes(data[_ZSTD_HEADER.size : table])


_STREAMS = ("positions", "opacities", "colours", "scales", "rotations", "SH")


def _decompress_stream(packed: memoryview, name: str, size: int) -> bytes:
    """Decompress one zstd frame; check its stated size, if any, before allocating memory."""
    if not size:
        return b""
    import zstandard

    with refusing(f"stream '{name}'", zstandard.ZstdError):
        stated = zstandard.frame_content_size(packed)
        if stated not in (-1, size):
            raise InvalidInput(
                f"stream '{name}': a frame of {counted(stated, 'byte')}, expected {size:,}"
            )
        decompressor = zstandard.ZstdDecompressor()
        unpacked = decompressor.decompress(packed, max_output_size=size, allow_extra_data=False)
    if len(unpacked) != size:
        raise InvalidInput(f"stream '{name}': {counted(len(unpacked), 'byte')}, expected {size:,}")
    return unpacked


def _read_extensions(path: Path, data: bytes) -> str:
    """The coordinate system from the extensions; unknown extensions cause a warning."""
    system, offset = SYSTEM, 0
    while offset < len(data):
        if len(data) - offset < 8:
            raise InvalidInput(
                f"{counted(len(data) - offset, 'byte')} left over after the extensions"
            )
        kind, size = struct.unpack_from("<II", data, offset)
        payload = data[offset + 8 : offset + 8 + size]
        if len(payload) != size:
            raise InvalidInput(
                f"extension {kind:#010x}: {counted(len(payload), 'byte')}, expected {size:,}"
            )
        if kind == _SYSTEM_EXTENSION and size == 4:
            (value,) = struct.unpack("<I", payload)
            if value > len(_SYSTEMS):
                raise InvalidInput(f"coordinate system {value}, expected 0 to {len(_SYSTEMS)}")
            system = _SYSTEMS[value - 1] if value else SYSTEM
        else:
            say_left_out(path, others=[f"extension {kind:#010x} of {counted(size, 'byte')}"])
        offset += 8 + size
    return system

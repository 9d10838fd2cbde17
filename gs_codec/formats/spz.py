"""Niantic's `.spz` files, versions 1 to 4.

Up to version 3 a file is one gzip stream; in version 4 each attribute is a zstd stream. Centres
are 24-bit fixed point (version 1: float16). Opacities, colours, log-scales and SH are a byte per
value. Quaternions xyzw are stored as their first three components, a byte each; from version 3, as
the index of the largest component and the other three in 10 bits each.
"""

from __future__ import annotations

import logging
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.formats.limits import check_count, refusing
from gs_codec.formats.packed_values import largest_restored, opacities_of, planes_of
from gs_codec.runtime.mapped import located
from gs_codec.scene import SH_COEFFICIENTS, Scene, stated_comments

log = logging.getLogger(__name__)

#: Data of attributes; parts of a memoryview are not copies.
Bytes = bytes | memoryview

MAGIC = b"NGSP"
GZIP = b"\x1f\x8b\x08"

_HEADER = struct.Struct("<4sIIBBBB")
_ZSTD_HEADER = struct.Struct("<4sIIBBBBI12x")
_ANTIALIASED, _EXTENSIONS = 1, 2
_FRACTION_BITS = 24
_COLOUR_SCALE = 0.15

#: Adobe's extension for other coordinate systems than the format's own; its values start at 1.
_SYSTEM_EXTENSION = 0xADBE0003
_SYSTEM = "RUB"
_SYSTEMS = (
    *("LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"),
    *("LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU"),
)


@dataclass(frozen=True)
class _Header:
    version: int
    count: int
    sh_degree: int
    fraction_bits: int
    flags: int

    @property
    def sizes(self) -> tuple[int, ...]:
        """Bytes per Gaussian of centres, opacities, colours, scales, rotations and SH."""
        coefficients = SH_COEFFICIENTS[self.sh_degree]
        position = 6 if self.version == 1 else 9
        return position, 1, 3, 3, 3 if self.version < 3 else 4, 3 * coefficients


def read_spz(path: Path, view: memoryview, max_bytes: int | None) -> Scene:
    """Read the bytes of an `.spz` file; see `SceneFile.scene`.

    A comment of the scene names its coordinate system.
    """
    with located(path):
        data = bytes(view)
        if data.startswith(GZIP):
            header, streams, extensions = _inflate(data, max_bytes)
        elif data.startswith(MAGIC):
            header, streams, extensions = _decompress(data, max_bytes)
        else:
            raise InvalidInput(f"begins with {data[:4]!a}, expected {MAGIC!a} or gzip (.spz)")
        system = _read_extensions(path, extensions)
        return _scene_of(path, header, streams, system)


def _check_header(
    version: int, fields: tuple[int, ...], file_bytes: int, max_bytes: int | None
) -> _Header:
    header = _Header(version, *fields)
    if header.sh_degree >= len(SH_COEFFICIENTS):
        raise InvalidInput(f"SH degree {header.sh_degree}, expected 0 to 3")
    if header.fraction_bits > _FRACTION_BITS:
        raise InvalidInput(
            f"{header.fraction_bits} fractional bits, expected at most {_FRACTION_BITS}"
        )
    if header.flags > _ANTIALIASED | _EXTENSIONS:
        raise InvalidInput(f"flags {header.flags:#x}, expected at most 0x3")
    check_count(header.count, header.sh_degree, file_bytes, max_bytes)
    return header


def stated_size(path: Path, view: memoryview) -> tuple[int, int]:
    """Number of Gaussians and SH degree that the header states; raises as `read_spz` does."""
    with located(path):
        if view[: len(MAGIC)] == MAGIC:
            head = bytes(view[: _HEADER.size])
        else:
            head = _unzipped_head(zlib.decompressobj(wbits=31), bytes(view[:1024]))
        if len(head) < _HEADER.size:
            raise InvalidInput(f"{len(head)} bytes, expected a header of {_HEADER.size}")
        _, version, *fields, _ = _HEADER.unpack(head)
        header = _check_header(version, tuple(fields), len(view), None)
        return header.count, header.sh_degree


def _unzipped_head(inflater: zlib._Decompress, data: bytes) -> bytes:
    with refusing("gzip stream"):
        head = inflater.decompress(data, _HEADER.size)
    if len(head) < _HEADER.size or not head.startswith(MAGIC):
        raise InvalidInput(f"a gzip stream that begins with {head[:4]!a}, expected {MAGIC!a}")
    return head


def _inflate(data: bytes, max_bytes: int | None) -> tuple[_Header, list[Bytes], bytes]:
    """Header, attributes and extensions of versions 1 to 3."""
    inflater = zlib.decompressobj(wbits=31)
    head = _unzipped_head(inflater, data)
    _, version, *fields, _ = _HEADER.unpack(head)
    if not 1 <= version <= 3:
        raise InvalidInput(f"version {version} in a gzip stream, expected 1 to 3")
    header = _check_header(version, tuple(fields), len(data), max_bytes)
    bounds = np.cumsum([0, *(size * header.count for size in header.sizes)]).tolist()
    limit = bounds[-1] + (1 << 20 if header.flags & _EXTENSIONS else 0)
    with refusing("gzip stream"):
        body = memoryview(inflater.decompress(inflater.unconsumed_tail, limit + 1))
    if len(body) < bounds[-1]:
        raise InvalidInput(f"{len(body)} bytes of attributes, expected {bounds[-1]}")
    if len(body) > limit or not inflater.eof or inflater.unused_data:
        raise InvalidInput(f"bytes left over, or cut off, after {bounds[-1]} bytes of attributes")
    streams: list[Bytes] = [body[a:b] for a, b in zip(bounds[:-1], bounds[1:], strict=True)]
    return header, streams, bytes(body[bounds[-1] :])


def _decompress(data: bytes, max_bytes: int | None) -> tuple[_Header, list[Bytes], bytes]:
    """Header, attributes and extensions of version 4."""
    if len(data) < _ZSTD_HEADER.size:
        raise InvalidInput(f"{len(data)} bytes, expected a header of {_ZSTD_HEADER.size}")
    _, version, *fields, number, table = _ZSTD_HEADER.unpack_from(data)
    if version != 4:
        raise InvalidInput(f"version {version}, expected 4 (1 to 3 are gzip streams)")
    header = _check_header(version, tuple(fields), len(data), max_bytes)
    sizes = [size * header.count for size in header.sizes]
    wanted = sum(size > 0 for size in sizes)
    if number != wanted:
        raise InvalidInput(f"{number} streams, expected {wanted}")
    offset = table + 16 * number
    if not _ZSTD_HEADER.size <= table <= offset <= len(data):
        raise InvalidInput(f"table of streams at byte {table}, of a file of {len(data)}")
    entries = iter(struct.iter_unpack("<QQ", data[table:offset]))
    streams: list[Bytes] = []
    for name, size in zip(_STREAMS, sizes, strict=True):
        packed, stated = next(entries) if size else (0, 0)
        if stated != size or packed > len(data) - offset:
            raise InvalidInput(
                f"stream '{name}': {packed} bytes packed, {stated} unpacked; expected at most "
                f"{len(data) - offset} and {size}"
            )
        streams.append(_decompress_stream(data[offset : offset + packed], name, size))
        offset += packed
    if offset < len(data):
        raise InvalidInput(f"{len(data) - offset} bytes left over after the last stream")
    return header, streams, data[_ZSTD_HEADER.size : table]


_STREAMS = ("positions", "opacities", "colours", "scales", "rotations", "SH")


def _decompress_stream(packed: bytes, name: str, size: int) -> bytes:
    """Decompress one zstd frame; check the size that it may state before memory is allocated."""
    if not size:
        return b""
    import zstandard

    with refusing(f"stream '{name}'", zstandard.ZstdError):
        stated = zstandard.frame_content_size(packed)
        if stated not in (-1, size):
            raise InvalidInput(f"stream '{name}': a frame of {stated} bytes, expected {size}")
        decompressor = zstandard.ZstdDecompressor()
        unpacked = decompressor.decompress(packed, max_output_size=size, allow_extra_data=False)
    if len(unpacked) != size:
        raise InvalidInput(f"stream '{name}': {len(unpacked)} bytes, expected {size}")
    return unpacked


def _read_extensions(path: Path, data: bytes) -> str:
    """The coordinate system from the extensions; unknown extensions give a warning."""
    system, offset = _SYSTEM, 0
    while offset < len(data):
        if len(data) - offset < 8:
            raise InvalidInput(f"{len(data) - offset} bytes left over after the extensions")
        kind, size = struct.unpack_from("<II", data, offset)
        payload = data[offset + 8 : offset + 8 + size]
        if len(payload) != size:
            raise InvalidInput(f"extension {kind:#010x}: {len(payload)} bytes, expected {size}")
        if kind == _SYSTEM_EXTENSION and size == 4:
            (value,) = struct.unpack("<I", payload)
            if value > len(_SYSTEMS):
                raise InvalidInput(f"coordinate system {value}, expected 0 to {len(_SYSTEMS)}")
            system = _SYSTEMS[value - 1] if value else _SYSTEM
        else:
            log.warning("%s: extension %#010x of %d bytes not kept", path, kind, size)
        offset += 8 + size
    return system


def _scene_of(path: Path, header: _Header, streams: list[Bytes], system: str) -> Scene:
    count = header.count
    positions, alphas, colours, scales, rotations, sh = (
        np.frombuffer(stream, np.uint8).reshape(count, size).T
        for stream, size in zip(streams, header.sizes, strict=True)
    )
    rotate = _first_three if header.version < 3 else _smallest_three
    return Scene(
        planes_of(3, count, lambda some: _positions(positions[:, some], header)),
        planes_of(3, count, lambda some: (colours[:, some] / 255 - 0.5) / _COLOUR_SCALE),
        planes_of(len(sh), count, lambda some: _f_rest(sh[:, some])),
        opacities_of(path, alphas[0]),
        planes_of(3, count, lambda some: scales[:, some] / np.float32(16) - 10),
        planes_of(4, count, lambda some: rotate(rotations[:, some])),
        comments=stated_comments(system, bool(header.flags & _ANTIALIASED)),
    )


def _f_rest(rows: NDArray[np.uint8]) -> NDArray[np.float32]:
    """SH-AC ``(3 * K, n)``, reordered: all coefficients of one colour channel after another."""
    by_colour = rows.reshape(len(rows) // 3, 3, rows.shape[1]).transpose(1, 0, 2)
    return (by_colour.reshape(rows.shape).astype(np.float32) - 128) / 128


def _positions(rows: NDArray[np.uint8], header: _Header) -> NDArray[np.float32]:
    if header.version == 1:
        with np.errstate(invalid="ignore"):  # signalling NaN
            return np.ascontiguousarray(rows.T).view("<f2").T.astype(np.float32, order="C")
    low, middle, high = (rows[i::3].astype(np.int32) for i in range(3))
    fixed = low | middle << 8 | (high ^ 128) - 128 << 16
    return (fixed * 2.0**-header.fraction_bits).astype(np.float32)


def _first_three(rows: NDArray[np.uint8]) -> NDArray[np.float32]:
    xyz = rows / 127.5 - 1
    return largest_restored(xyz, np.zeros(rows.shape[1], np.int64))


def _smallest_three(rows: NDArray[np.uint8]) -> NDArray[np.float32]:
    packed = np.ascontiguousarray(rows.T).view("<u4")[:, 0]
    fields = np.stack([(packed >> shift) & 1023 for shift in (20, 10, 0)]).astype(np.int64)
    three = np.where(fields & 512, -1.0, 1.0) * (fields & 511) * (np.sqrt(0.5) / 511)
    return largest_restored(three, (packed >> 30).astype(np.int64))[[3, 0, 1, 2]]

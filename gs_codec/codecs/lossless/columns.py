"""Convert float columns to bytes and back, bit-exactly. FORMAT.md, "Columns".

Only pcodec's classic mode is used, with or without consecutive deltas, so that no stream can demand
more memory than its values.

Columns are coded one by one. They may be split into classes by the sign and exponent of another
column (the guide). For quaternions, w is coded as the difference from the w of a unit quaternion.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from pcodec import ChunkConfig, DeltaSpec, ModeSpec, PagingSpec
from pcodec.wrapped import FileCompressor, FileDecompressor

from gs_codec.coding.fields import ByteReader
from gs_codec.errors import CorruptStream
from gs_codec.runtime.wording import counted

_SIGN = np.uint32(1 << 31)

_LEVEL = 10
_FORMAT = 4
_CONSECUTIVE = 1

#: Number of values of a column that are coded both ways, to decide whether to code differences.
TRIED = 2048

#: Values as they are, and differences of consecutive ones.
_DELTAS = (DeltaSpec.no_op(), DeltaSpec.try_consecutive(1))

Bits = NDArray[np.uint32]

_PLAIN, _UNIT = range(2)


def to_ordered(bits: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Map bit patterns of floats, one to one, to integers in the order of the floats."""
    return np.where(bits & _SIGN, ~bits, bits | _SIGN)


def from_ordered(ordered: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """The inverse of `to_ordered`."""
    return np.where(ordered & _SIGN, ordered ^ _SIGN, ~ordered)


def write_integers(values: NDArray[np.uint32], tried: int = TRIED) -> bytes:
    """Code values ``(n,)``, n >= 1, or their differences, whichever takes fewer bytes.

    To find out, `tried` of the values are coded both ways; 0 means that differences do not pay.
    """
    if not tried:
        return _write(values, _DELTAS[0])
    middle = max(values.size - tried, 0) // 2
    written = [_write(values[middle : middle + tried], delta) for delta in _DELTAS]
    smallest = written.index(min(written, key=len))
    return written[smallest] if values.size <= tried else _write(values, _DELTAS[smallest])


def _write(values: NDArray[np.uint32], delta: DeltaSpec) -> bytes:
    config = ChunkConfig(
        compression_level=_LEVEL,
        mode_spec=ModeSpec.classic(),
        delta_spec=delta,
        paging_spec=PagingSpec.exact_page_sizes([values.size]),
    )
    file = FileCompressor()
    chunk = file.chunk_compressor(np.ascontiguousarray(values), config)
    return file.write_header() + chunk.write_meta() + chunk.write_page(0)


def read_integers(data: memoryview, count: int, where: str) -> NDArray[np.uint32]:
    """The inverse of `write_integers` for `count` values, at least one. Raises CorruptStream."""
    if len(data) < 3 or data[0] != _FORMAT or data[2] & 15 or data[2] >> 4 > _CONSECUTIVE:
        raise CorruptStream(f"{where}: not a supported pcodec stream")
    packed = bytes(data)
    values = np.empty(count, np.uint32)
    try:
        file, size = FileDecompressor.new(packed)
        chunk, used = file.chunk_decompressor(packed[size:], "u32")
        size += used
        progress, used = chunk.read_page_into(packed[size:], count, values)
    except RuntimeError as error:
        raise CorruptStream(f"{where}: {' '.join(str(error).split())}") from None
    if progress.n_processed != count or not progress.finished or size + used != len(packed):
        raise CorruptStream(
            f"{where}: {counted(len(packed), 'byte')}, not exactly {counted(count, 'value')}"
        )
    return values


def _classes(guide: Bits) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Stable sort of ``guide (n,)`` by class: indices, and the size of each class.

    A class is a sign and an exponent, clamped to 2^-11 ... 2^4.
    """
    classes = np.clip((guide >> 23) & 255, 116, 131) - 116 + 16 * (guide >> 31)
    return np.argsort(classes.astype(np.uint8), kind="stable"), np.bincount(classes, minlength=32)


def write_mask(mask: Bits) -> bytes:
    """Code small integers ``(n,)``."""
    return _pack(_code([mask], TRIED))


def read_mask(reader: ByteReader, count: int, top: int) -> Bits:
    """The inverse of `write_mask`, for integers of 0 to `top`."""
    mask = _read_parts(reader, [count])[0]
    if mask.max(initial=0) > top:
        raise CorruptStream(f"{reader.where}: mask {mask.max()}, expected at most {top}")
    return mask


def write_stack(columns: Bits, tried: int) -> bytes:
    """Code the bit patterns ``(C, n)`` of floats column by column; see `write_integers`."""
    return _pack(_code(to_ordered(columns), tried))


def read_stack(reader: ByteReader, shape: tuple[int, ...]) -> Bits:
    """The inverse of `write_stack`."""
    return from_ordered(_read_columns(reader, shape))


def write_guided(columns: Bits, guide: Bits, tried: int) -> bytes:
    """Code ``(C, n)`` given ``guide (C, n)``, which the decoder already has; like `write_stack`."""
    order, sizes = _classes(guide.ravel())
    grouped = to_ordered(columns).ravel()[order]
    return _pack(_code(np.split(grouped, np.cumsum(sizes)[:-1]), tried))


def read_guided(reader: ByteReader, guide: Bits) -> Bits:
    """The inverse of `write_guided`."""
    order, sizes = _classes(guide.ravel())
    values = np.empty(guide.size, np.uint32)
    values[order] = np.concatenate(_read_parts(reader, sizes.tolist()))
    return from_ordered(values.reshape(guide.shape))


def write_quaternions(columns: Bits, tried: int) -> bytes:
    """Code the components ``(4, n)`` w, x, y, z; see `write_integers`."""
    ordered = to_ordered(columns)
    residual = ordered[0] - to_ordered(_unit_w(columns[1:])) + _SIGN
    w, of_unit, *rest = _code([ordered[0], residual, *ordered[1:]], tried)
    if len(of_unit) < len(w):
        return bytes([_UNIT]) + _pack([of_unit, *rest])
    return bytes([_PLAIN]) + _pack([w, *rest])


def read_quaternions(reader: ByteReader, count: int) -> Bits:
    """The inverse of `write_quaternions`."""
    kind = reader.unpack("B")[0]
    if kind not in (_PLAIN, _UNIT):
        raise CorruptStream(f"{reader.where}: quaternions of kind {kind}, expected 0 or 1")
    ordered = _read_columns(reader, (4, count))
    if kind == _UNIT:
        ordered[0] += to_ordered(_unit_w(from_ordered(ordered[1:]))) - _SIGN
    return from_ordered(ordered)


def _unit_w(columns: Bits) -> Bits:
    """The w >= 0 that makes x, y, z ``(3, n)`` a unit quaternion; 0 if there is none."""
    with np.errstate(invalid="ignore", over="ignore"):
        x, y, z = columns.view(np.float32).astype(np.float64)
        square = 1.0 - x * x - y * y - z * z
        w = np.sqrt(np.where(square > 0, square, 0.0))
    return w.astype(np.float32).view(np.uint32)


def _code(parts: Iterable[Bits], tried: int) -> list[bytes]:
    return [write_integers(part, tried) if part.size else b"" for part in parts]


def _pack(coded: list[bytes]) -> bytes:
    sizes = struct.pack(f"<{len(coded)}I", *(len(part) for part in coded))
    return b"".join([sizes, *coded])


def _read_columns(reader: ByteReader, shape: tuple[int, ...]) -> Bits:
    return np.stack(_read_parts(reader, [shape[1]] * shape[0]))


def _read_parts(reader: ByteReader, counts: list[int]) -> list[Bits]:
    sizes = reader.unpack(f"{len(counts)}I")
    parts = []
    for size, count in zip(sizes, counts, strict=True):
        data = reader.take(size)
        if not count and size:
            raise CorruptStream(f"{reader.where}: {counted(size, 'byte')} for no values")
        parts.append(read_integers(data, count, reader.where) if count else np.empty(0, np.uint32))
    return parts

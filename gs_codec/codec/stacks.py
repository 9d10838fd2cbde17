"""Stacks of float columns to bytes and back, bit-exactly. FORMAT.md, "Columns".

Columns are coded one by one; or split into classes by sign and exponent of another column (the
guide); or, for quaternions, with w as its difference from the w of a unit quaternion.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from gs_codec.container.bytes import ByteReader
from gs_codec.entropy.pco import read_integers, write_integers
from gs_codec.errors import CorruptStream
from gs_codec.kernels import inlined, kernel
from gs_codec.transform.float_bits import from_ordered, to_ordered

Bits = NDArray[np.uint32]

_PLAIN, _UNIT = range(2)
_CLASS_COUNT = 32
_HALF = np.uint32(1 << 31)


@inlined
def _class_of(guide):
    """Sign, and exponent within the 16 that matter: 2^-11 to 2^4."""
    return min(max((guide >> 23) & 255, 116), 131) - 116 + 16 * (guide >> 31)


@kernel
def _count(guide, counts):
    for i in range(guide.size):
        counts[_class_of(guide[i])] += 1


@kernel
def _split(values, guide, places, grouped):
    for i in range(guide.size):
        group = _class_of(guide[i])
        grouped[places[group]] = values[i]
        places[group] += 1


@kernel
def _merge(grouped, guide, places, values):
    for i in range(guide.size):
        group = _class_of(guide[i])
        values[i] = grouped[places[group]]
        places[group] += 1


def _class_bounds(guide: Bits) -> NDArray[np.int64]:
    """Where each class begins among the values sorted by class, and the end of the last."""
    counts = np.zeros(_CLASS_COUNT, np.int64)
    _count(guide, counts)
    return np.concatenate([np.zeros(1, np.int64), np.cumsum(counts)])


def write_mask(mask: Bits) -> bytes:
    """Code small integers ``(n,)``."""
    return _pack(_code([mask]))


def read_mask(reader: ByteReader, count: int, top: int, where: str) -> Bits:
    """The inverse of `write_mask`, for integers of 0 to `top`."""
    mask = _read_parts(reader, [count], where)[0]
    if mask.max(initial=0) > top:
        raise CorruptStream(f"{where}: mask {mask.max()}, expected at most {top}")
    return mask


def write_stack(columns: Bits) -> bytes:
    """Code the bit patterns ``(C, n)`` of floats column by column."""
    return _pack(_code(to_ordered(columns)))


def read_stack(reader: ByteReader, shape: tuple[int, int], where: str) -> Bits:
    """The inverse of `write_stack`."""
    return from_ordered(_read_columns(reader, shape, where))


def write_guided(columns: Bits, guide: Bits) -> bytes:
    """Code ``(C, n)`` given ``guide (C, n)``, which the decoder has already."""
    values, flat = to_ordered(columns).ravel(), np.ascontiguousarray(guide).ravel()
    bounds = _class_bounds(flat)
    grouped = np.empty(flat.size, np.uint32)
    _split(values, flat, bounds[:-1].copy(), grouped)
    return _pack(_code(np.split(grouped, bounds[1:-1])))


def read_guided(reader: ByteReader, guide: Bits, where: str) -> Bits:
    """The inverse of `write_guided`."""
    flat = np.ascontiguousarray(guide).ravel()
    bounds = _class_bounds(flat)
    parts = _read_parts(reader, [int(size) for size in np.diff(bounds)], where)
    values = np.empty(flat.size, np.uint32)
    _merge(np.concatenate(parts), flat, bounds[:-1].copy(), values)
    return from_ordered(values.reshape(guide.shape))


def write_quaternions(columns: Bits) -> bytes:
    """Code the components ``(4, n)`` w, x, y, z."""
    ordered = to_ordered(columns)
    residual = ordered[0] - to_ordered(_unit_w(columns[1:])) + _HALF
    w, of_unit, *rest = _code([ordered[0], residual, *ordered[1:]])
    if len(of_unit) < len(w):
        return bytes([_UNIT]) + _pack([of_unit, *rest])
    return bytes([_PLAIN]) + _pack([w, *rest])


def read_quaternions(reader: ByteReader, count: int, where: str) -> Bits:
    """The inverse of `write_quaternions`."""
    kind = reader.unpack("B")[0]
    if kind not in (_PLAIN, _UNIT):
        raise CorruptStream(f"{where}: quaternions of kind {kind}, expected 0 or 1")
    ordered = _read_columns(reader, (4, count), where)
    if kind == _UNIT:
        ordered[0] += to_ordered(_unit_w(from_ordered(ordered[1:]))) - _HALF
    return from_ordered(ordered)


def _unit_w(columns: Bits) -> Bits:
    """The w >= 0 that makes x, y, z ``(3, n)`` a unit quaternion; 0 if there is none."""
    with np.errstate(invalid="ignore", over="ignore"):
        x, y, z = columns.view(np.float32).astype(np.float64)
        square = 1.0 - x * x - y * y - z * z
        w = np.sqrt(np.where(square > 0, square, 0.0))
    return w.astype(np.float32).view(np.uint32)


def _code(parts: Iterable[Bits]) -> list[bytes]:
    return [write_integers(part) if part.size else b"" for part in parts]


def _pack(coded: list[bytes]) -> bytes:
    sizes = struct.pack(f"<{len(coded)}I", *(len(part) for part in coded))
    return b"".join([sizes, *coded])


def _read_columns(reader: ByteReader, shape: tuple[int, ...], where: str) -> Bits:
    return np.stack(_read_parts(reader, [shape[1]] * shape[0], where))


def _read_parts(reader: ByteReader, counts: list[int], where: str) -> list[Bits]:
    sizes = reader.unpack(f"{len(counts)}I")
    parts = []
    for size, count in zip(sizes, counts, strict=True):
        data = reader.take(size)
        if not count and size:
            raise CorruptStream(f"{where}: {size} bytes for no values")
        parts.append(read_integers(data, count, where) if count else np.empty(0, np.uint32))
    return parts

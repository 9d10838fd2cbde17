"""Integers of known widths: little-endian bytes with bounds checks, and raw bits."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.binary import read_raw
from gs_codec.errors import CorruptStream, TruncatedStream
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.mapped import FileBytes
from gs_codec.runtime.wording import counted


class ByteReader:
    """Cursor over bytes that names the section in its errors."""

    def __init__(self, data: memoryview | FileBytes, where: str) -> None:
        self._data = data
        self.where = where
        self.position = 0

    def unpack(self, layout: str) -> tuple:
        """Read fields of a `struct` layout (little-endian)."""
        return struct.unpack("<" + layout, self.take(struct.calcsize("<" + layout)))

    def take(self, size: int) -> memoryview:
        """Return the next `size` bytes."""
        self.skip(size)
        return self._data[self.position - size : self.position]

    def skip(self, size: int) -> None:
        """Skip the next `size` bytes."""
        left = len(self._data) - self.position
        if size > left:
            raise TruncatedStream(
                f"{self.where}: {counted(left, 'byte')} left at {self.position}, expected {size:,}"
            )
        self.position += size

    def rest(self) -> memoryview:
        """Return all remaining bytes."""
        return self.take(len(self._data) - self.position)


@kernel
def _write_raw(values, widths, position, bits):
    at, filled = position >> 3, position & 7
    # The last bits written, of which `filled` are not in a whole byte.
    last = np.int64(bits[at]) >> (8 - filled) if filled else 0
    for i in range(len(values)):
        left, value = np.int64(widths[i]), abs(values[i])
        while left > 0:
            take = min(left, 32)
            left -= take
            last = (last & 255) << take | ((value >> left) & ((1 << take) - 1))
            filled += take
            while filled >= 8:
                filled -= 8
                bits[at] = (last >> filled) & 255
                at += 1
    if filled:
        bits[at] = (last << (8 - filled)) & 255
    return 8 * at + filled


@kernel
def _read_fields(widths, position, bits, values):
    for i in range(len(widths)):
        values[i] = read_raw(bits, position, widths[i])
        position += widths[i]
    return position


class BitWriter:
    """Collects the raw bits of a section, most significant bit of a byte first."""

    def __init__(self) -> None:
        self.parts: list[tuple[NDArray[np.int64], NDArray[np.uint8]]] = []

    def add(self, values: NDArray[np.int64], widths: NDArray[np.uint8]) -> None:
        """Append the ``widths (n,)`` low bits of the magnitudes of ``values (n,)``."""
        self.parts.append((values, widths))

    def finish(self) -> bytes:
        """Return all bits, padded with zeros to a whole byte."""
        total = sum(int(widths.sum(dtype=np.int64)) for _, widths in self.parts)
        bits = np.zeros((total + 7) // 8, np.uint8)
        position = 0
        for values, widths in self.parts:
            position = _write_raw(values, widths, position, bits)
        return bits.tobytes()


class BitReader:
    """Reads what `BitWriter` wrote."""

    def __init__(self, data: memoryview, where: str) -> None:
        self.bits = np.frombuffer(data, np.uint8)
        self.position = 0
        self.where = where

    def fields(self, widths: NDArray[np.int64]) -> NDArray[np.int64]:
        """Read numbers ``(n,)`` of ``widths (n,)`` bits."""
        values = np.empty(len(widths), np.int64)
        self.position = _read_fields(widths, self.position, self.bits, values)
        return values

    def close(self) -> None:
        """Check that only zero padding remains."""
        if self.bits.size != (self.position + 7) // 8:
            raise CorruptStream(
                f"{self.where}: {self.bits.size} raw bytes, expected {(self.position + 7) // 8}"
            )
        if self.position % 8 and self.bits[-1] & (0xFF >> self.position % 8):
            raise CorruptStream(f"{self.where}: padding bits that are not 0")

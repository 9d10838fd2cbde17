"""Little-endian fields read with bounds checked."""

from __future__ import annotations

import struct

from gs_codec.errors import TruncatedStream


class ByteReader:
    """Cursor over bytes that names the section in its errors."""

    def __init__(self, data: memoryview, where: str) -> None:
        self._data = data
        self._where = where
        self.position = 0

    def unpack(self, layout: str) -> tuple:
        """Fields of a `struct` layout (little-endian)."""
        return struct.unpack("<" + layout, self.take(struct.calcsize("<" + layout)))

    def take(self, size: int) -> memoryview:
        """The next `size` bytes."""
        left = len(self._data) - self.position
        if size > left:
            raise TruncatedStream(
                f"{self._where}: {left} bytes left at {self.position}, expected {size}"
            )
        self.position += size
        return self._data[self.position - size : self.position]

    def rest(self) -> memoryview:
        """Everything that is left."""
        return self.take(len(self._data) - self.position)

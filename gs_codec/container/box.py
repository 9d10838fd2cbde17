"""The ``box`` section: the box of a scene whose quantisers do not tell it."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import CorruptStream

_LAYOUT = "<6f"

Box = tuple[tuple[float, ...], tuple[float, ...]]


def write_box(positions: NDArray[np.float32]) -> bytes:
    """Serialise the box of the finite coordinates of ``positions (3, N)``; zeros without any."""
    finite = [row[np.isfinite(row)] for row in positions]
    # Adding 0 turns -0 into 0: which of the two is the minimum depends on the machine.
    low = [row.min() + np.float32(0) if row.size else 0.0 for row in finite]
    high = [row.max() + np.float32(0) if row.size else 0.0 for row in finite]
    return struct.pack(_LAYOUT, *low, *high)


def read_box(data: memoryview) -> Box:
    """Lowest and highest x, y, z.

    Raises
    ------
    CorruptStream
    """
    if len(data) != struct.calcsize(_LAYOUT):
        size = struct.calcsize(_LAYOUT)
        raise CorruptStream(f"section 'box': {len(data)} bytes, expected {size}")
    values = struct.unpack(_LAYOUT, data)
    low, high = values[:3], values[3:]
    if not np.isfinite(values).all() or any(a > b for a, b in zip(low, high, strict=True)):
        raise CorruptStream(f"section 'box': {low} to {high} is no box")
    return low, high

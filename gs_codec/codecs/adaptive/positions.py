"""Positions of unequal precision: Morton codes whose low bits may be dropped."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.morton import bit_layout, decode_morton

_LARGEST = float(np.finfo(np.float32).max)


def centres(
    codes: NDArray[np.int64], dropped: NDArray[np.int64], bits: tuple[int, int, int]
) -> NDArray[np.int64]:
    """Centres ``(3, n)``, in half steps, of the cells of codes whose low bits are dropped.

    Parameters
    ----------
    codes : ndarray, shape (n,), int64
        Morton codes, 0 in the bits that are dropped.
    dropped : ndarray, shape (n,), int64
        Number of low bits that are dropped.
    bits : tuple of int
        Bits of x, y, z.
    """
    widths = np.zeros((3, sum(bits) + 1), np.int64)
    for bit, axis in enumerate(bit_layout(bits)[::-1]):
        widths[:, bit + 1] = widths[:, bit]
        widths[axis, bit + 1] += 1
    cells = 2 * decode_morton(codes, bits).astype(np.int64)
    return cells + (np.int64(1) << widths[:, dropped])


def to_grid(
    positions: NDArray[np.float32], origin: NDArray[np.float64], step: float, bits: tuple[int, ...]
) -> NDArray[np.uint32]:
    """Cells ``(3, N)`` of positions ``(3, N)``."""
    cells = np.empty(positions.shape, np.uint32)
    for axis, row in enumerate(positions):
        levels = np.floor((row.astype(np.float64) - origin[axis]) / step)
        cells[axis] = np.clip(levels, 0, (1 << bits[axis]) - 1)
    return cells


def from_grid(
    half_steps: NDArray[np.int64], origin: NDArray[np.float64], step: float
) -> NDArray[np.float32]:
    """Positions ``(3, N)`` of grid positions in half steps, clamped to what float32 holds."""
    positions = origin[:, None] + half_steps * (0.5 * step)
    return np.clip(positions, -_LARGEST, _LARGEST, out=positions).astype(np.float32)

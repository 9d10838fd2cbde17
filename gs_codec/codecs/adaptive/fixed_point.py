"""Values as multiples of 2**-20, on lattices whose step is a unit times a power of two.

Whatever a decoder decides from values, it decides from these integers: rounding of floats could
differ between machines.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.runtime.kernels import kernel

#: Fraction bits of a fixed-point value.
FRACTION_BITS = 20

#: Values beyond this are clamped to it.
LARGEST = 400.0

#: No encoder writes values of this magnitude or more.
TOO_LARGE = 4 * LARGEST


@kernel
def _to_lattice(values, centre, unit, shifts, limit, levels):
    clamped = 0
    for i in range(len(values)):
        value = np.float64(values[i])
        if abs(value) > limit:
            value = limit if value > 0.0 else -limit
            clamped += 1
        step = unit << shifts[i]
        offset = np.int64(np.floor(value * (1 << FRACTION_BITS) + 0.5)) - centre
        levels[i] = (2 * offset + step) // (2 * step)
    return clamped


def to_lattice(
    values: NDArray, centre: int, unit: int, shifts: NDArray[np.int64], limit: float = LARGEST
) -> tuple[NDArray[np.int64], int]:
    """Nearest levels ``(n,)`` of values ``(n,)``, and how many were clamped to `limit`."""
    levels = np.empty(len(values), np.int64)
    clamped = _to_lattice(values, centre, unit, shifts, limit, levels)
    return levels, clamped


def from_lattice(
    levels: NDArray[np.int64], centre: int, unit: int, shifts: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Fixed-point values ``(n,)`` of levels: ``centre + level * (unit << shift)``."""
    return centre + levels * (unit << shifts)


def to_float(fixed: NDArray[np.int64]) -> NDArray[np.float64]:
    """Exact float64 of fixed-point values."""
    return fixed / float(1 << FRACTION_BITS)

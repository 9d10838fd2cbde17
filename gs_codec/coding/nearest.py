"""The nearest of the preceding points in Morton order."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.runtime.kernels import inlined, kernel

WINDOW = 8
NEIGHBOURS = 4

_LANES = WINDOW // NEIGHBOURS
_AGE_BITS = WINDOW.bit_length() - 1

#: Squared distances are clamped to this, so that weights fit into 53 bits.
_FARTHEST = (1 << 44) - 1


@inlined
def _ordered(first, second):
    """Return the lesser and the greater, without a branch, which would often be mispredicted."""
    less = first < second
    return (first if less else second), (second if less else first)


@inlined
def _lesser(first, second):
    return first if first < second else second


@inlined
def _sort_lanes(keys):
    """Sort the four keys of each lane."""
    for lane in range(_LANES):
        a, b = _ordered(keys[lane], keys[lane + _LANES])
        c, d = _ordered(keys[lane + 2 * _LANES], keys[lane + 3 * _LANES])
        a, c = _ordered(a, c)
        b, d = _ordered(b, d)
        b, c = _ordered(b, c)
        keys[lane], keys[lane + _LANES] = a, b
        keys[lane + 2 * _LANES], keys[lane + 3 * _LANES] = c, d


@inlined
def _merge_lanes(keys):
    """Leave the four smallest keys of all lanes, sorted, in the first lane."""
    other = _LANES
    while other > 1:
        other >>= 1
        for lane in range(other):
            # The elementwise minimum of one lane and the other reversed is bitonic: it rises, then
            # falls.
            a = _lesser(keys[lane], keys[lane + other + 3 * _LANES])
            b = _lesser(keys[lane + _LANES], keys[lane + other + 2 * _LANES])
            c = _lesser(keys[lane + 2 * _LANES], keys[lane + other + _LANES])
            d = _lesser(keys[lane + 3 * _LANES], keys[lane + other])
            a, c = _ordered(a, c)
            b, d = _ordered(b, d)
            a, b = _ordered(a, b)
            c, d = _ordered(c, d)
            keys[lane], keys[lane + _LANES] = a, b
            keys[lane + 2 * _LANES], keys[lane + 3 * _LANES] = c, d


@inlined
def find_nearest(points, i, near, distances, row, keys):
    """Fill a row of `near` with the indices of the nearest points before `i`; return their number.

    There are at most `NEIGHBOURS`; ties go to the later point. The row of `distances` gets squared
    distances in position steps, at most 2**44 - 1, exact if ``points (3, n)`` are below 2**23.
    ``keys (WINDOW,)`` float64 is scratch memory.
    """
    known = min(i, WINDOW)
    x, y, z = np.float64(points[0, i]), np.float64(points[1, i]), np.float64(points[2, i])
    for j in range(known):
        dx = np.float64(points[0, i - known + j]) - x
        dy = np.float64(points[1, i - known + j]) - y
        dz = np.float64(points[2, i - known + j]) - z
        # The squared distance; the low bits say how many points back the point is.
        keys[j] = (dx * dx + dy * dy + dz * dz) * WINDOW + np.float64(known - 1 - j)
    for j in range(known, WINDOW):
        keys[j] = np.inf
    _sort_lanes(keys)
    _merge_lanes(keys)
    found = min(known, NEIGHBOURS)
    for k in range(found):
        key = np.int64(keys[k * _LANES])
        distances[row, k] = min(key >> _AGE_BITS, _FARTHEST)
        near[row, k] = i - 1 - (key & (WINDOW - 1))
    return found


@kernel
def _find_all(points, near, distances):
    keys = np.empty(WINDOW)
    for i in range(len(near)):
        find_nearest(points, i, near, distances, i, keys)


class Nearest(NamedTuple):
    """The nearest points before each point, and squared distances, both ``(n, NEIGHBOURS)``.

    Missing neighbours are 0.
    """

    near: NDArray[np.int32]
    distances: NDArray[np.int64]


def find_all_nearest(points: NDArray[np.int64]) -> Nearest:
    """Find the nearest preceding points of all points ``(3, n)``, in position steps below 2**23."""
    near = np.zeros((points.shape[1], NEIGHBOURS), np.int32)
    distances = np.zeros(near.shape, np.int64)
    _find_all(points, near, distances)
    return Nearest(near, distances)

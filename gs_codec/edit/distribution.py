"""Order statistics and histograms of many values, without sorting or copying them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gs_codec.runtime.kernels import kernel

#: Bits of a float that are told apart in one pass.
_DIGIT = 16

_LARGEST = float(np.finfo(np.float64).max)

#: Bits of a value that is not finite, by its bytes.
_EXPONENTS = {4: 0x7F80_0000, 8: 0x7FF0_0000_0000_0000}


def ranked(planes: Sequence[NDArray], ranks: Sequence[int]) -> list[float]:
    """The finite values of all planes that have these ranks.

    The first digit of a value is where a running sum of the numbers of each digit passes its rank;
    the next one is found among the values with that digit.

    Parameters
    ----------
    planes : sequence of ndarray, each shape (N,)
        All float32 or all float64.
    ranks : sequence of int
        From 0, the rank of the lowest finite value, to the number of finite values less one.
    """
    size = planes[0].itemsize
    bits = [np.ascontiguousarray(plane).view(f"i{size}") for plane in planes]
    sums: dict[tuple[int, int], NDArray[np.int64]] = {}
    keys = []
    for rank in ranks:
        key = 0
        for shift in range(8 * size - _DIGIT, -1, -_DIGIT):
            if (shift, key) not in sums:
                sums[shift, key] = np.cumsum(_digits(bits, shift, key))
            before = sums[shift, key]
            digit = int(np.searchsorted(before, rank, side="right"))
            rank -= int(before[digit - 1]) if digit else 0
            # The first digit has the sign.
            key |= (digit - (1 << _DIGIT - 1) if shift + _DIGIT == 8 * size else digit) << shift
        keys.append(key)
    mask = (1 << 8 * size - 1) - 1
    found = np.array([key ^ (mask if key < 0 else 0) for key in keys], f"i{size}")
    return found.view(f"f{size}").astype(np.float64).tolist()


def _digits(bits: Sequence[NDArray], shift: int, key: int) -> NDArray[np.int64]:
    """How many values have each digit at `shift`, of those with the digits of `key` above it."""
    size = bits[0].itemsize
    first = shift + _DIGIT == 8 * size
    counts = np.zeros(1 << _DIGIT, np.int64)
    for plane in bits:
        above = 0 if first else -1 << shift + _DIGIT
        _count_digits(plane, _EXPONENTS[size], (1 << 8 * size - 1) - 1, shift, above, key, counts)
    return np.roll(counts, 1 << _DIGIT - 1) if first else counts


@kernel
def _count_digits(bits, exponent, mask, shift, above, key, counts):
    last = len(counts) - 1
    for i in range(len(bits)):
        own = np.int64(bits[i])
        if own & exponent == exponent:
            continue
        # Integers in the order of the floats.
        own ^= (own >> 63) & mask
        if (own ^ key) & above == 0:
            counts[(own >> shift) & last] += 1


def even_edges(low: float, high: float, bins: int) -> NDArray[np.float64]:
    """Edges ``(bins + 1,)`` of even bins, around a single value too."""
    if low == high:
        half = 0.5 * (abs(low) or 1.0)
        low, high = max(low - half, -_LARGEST), min(high + half, _LARGEST)
    # Halves: the difference of two finite numbers may be infinite.
    return 2 * np.linspace(0.5 * low, 0.5 * high, bins + 1)


def histogram(planes: Sequence[NDArray], edges: NDArray[np.float64]) -> NDArray[np.int64]:
    """Number of finite values below all bins, in each, and above all, ``(len(edges) + 1,)``.

    A bin holds its lower edge; the last one its upper edge too.

    Parameters
    ----------
    planes : sequence of ndarray, each shape (N,)
        Float32 or float64.
    edges : ndarray
        About evenly spaced.
    """
    counts = np.zeros(len(edges) + 1, np.int64)
    for plane in planes:
        _count(np.ascontiguousarray(plane), edges, counts)
    return counts


@kernel
def _count(values, edges, counts):
    bins = len(edges) - 1
    low, high = edges[0], edges[bins]
    factor = bins / (0.5 * high - 0.5 * low)
    for i in range(len(values)):
        value = np.float64(values[i])
        if not np.isfinite(value):
            continue
        if value < low:
            counts[0] += 1
        elif value > high:
            counts[bins + 1] += 1
        else:
            guess = (0.5 * value - 0.5 * low) * factor
            place = np.int64(guess) if 0.0 <= guess < bins else 0
            while place > 0 and value < edges[place]:
                place -= 1
            while place < bins - 1 and value >= edges[place + 1]:
                place += 1
            counts[place + 1] += 1

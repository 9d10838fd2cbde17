"""Order statistics and histograms of finite values."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_LARGEST = float(np.finfo(np.float64).max)


def finite_values(planes: Sequence[NDArray]) -> NDArray:
    """The finite values ``(n,)`` of all planes, each ``(N,)``."""
    values = np.concatenate(planes)
    finite = np.isfinite(values)
    return values if finite.all() else values[finite]


def ranked(values: NDArray, ranks: Sequence[int]) -> list[float]:
    """The values of these ranks, counted from 0; ties in any order."""
    return np.partition(values, sorted(set(ranks)))[list(ranks)].astype(np.float64).tolist()


def histogram(
    values: NDArray, low: float, high: float, bins: int
) -> tuple[list[int], NDArray[np.float64]]:
    """Counts of values below all bins, in each bin, and above all bins; and the edges.

    Bins have equal widths, and surround the value if `low` equals `high`. A bin includes its lower
    edge; the last one also its upper edge.
    """
    values = values.astype(np.float64)
    below, above = np.count_nonzero(values < low), np.count_nonzero(values > high)
    if low == high:
        half = 0.5 * (abs(low) or 1.0)
        low, high = max(low - half, -_LARGEST), min(high + half, _LARGEST)
    # Halve first, because the difference of two finite numbers may be infinite.
    counts, edges = np.histogram(0.5 * values, bins, (0.5 * low, 0.5 * high))
    return [int(below), *counts.tolist(), int(above)], 2 * edges

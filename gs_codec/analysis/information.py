"""Normalised mutual information between channels (paper, Section 3.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.threads import run_all

#: Bins of equal counts, or of equal widths.
Bins = Literal["counts", "widths"]
BINS: tuple[Bins, ...] = ("counts", "widths")

# Quantiles that bound bins of equal widths; outliers would leave most values in one bin.
_INNER = (0.001, 0.999)

#: Maximum number of bins per channel; and values per pair of bins expected for independent
#: channels.
MAX_BINS = 32
_VALUES_A_CELL = 50

# Number of values counted at a time, so that those of several channels stay in the cache.
_CHUNK = 1 << 14


#: Threshold relative to the channel's mean magnitude. Quantised formats may not represent zero, and
#: store several values near it. With a Laplace distribution, one value in a hundred is below it,
#: but never all of a colour.
_SHARE = 0.01


@dataclass(frozen=True)
class Information:
    """Normalised mutual information of channels with others.

    Attributes
    ----------
    corrected : ndarray, shape (A, B)
        `raw` corrected for `bias`: ``(raw - bias) / (1 - bias)``. About 0 for independent
        channels, 1 for equal ones.
    raw : ndarray, shape (A, B)
        ``2 I(X; Y) / (H(X) + H(Y))`` of the binned values; 0 if a channel is constant.
    bias : ndarray, shape (A, B)
        The same with the second channel shuffled: the value for independent channels at this sample
        size.
    """

    corrected: NDArray[np.float64]
    raw: NDArray[np.float64]
    bias: NDArray[np.float64]


def bin_count(samples: int) -> int:
    """Number of bins for a sample of this size, 2 to `MAX_BINS`."""
    return int(np.clip(math.isqrt(samples // _VALUES_A_CELL), 2, MAX_BINS))


def into_bins(planes: NDArray[np.floating], bins: int, kind: Bins = "counts") -> NDArray[np.int8]:
    """Bins ``(C, N)`` of channels ``(C, N)``; equal values share a bin.

    ``counts``: about equally many values in each bin; a frequent value that fills several bins
    leaves some empty. ``widths``: equally wide bins from the 0.1 % quantile to the 99.9 % quantile;
    the outermost also contain all values beyond. If the two quantiles are equal, the bins reach
    from the lowest value to the highest. A constant channel has one bin of either kind.
    """
    codes = np.zeros(planes.shape, np.int8)
    edges_of = _equal_counts if kind == "counts" else _equal_widths

    def work(row: int) -> None:
        codes[row] = np.searchsorted(edges_of(planes[row], bins), planes[row], side="left")

    if planes.shape[1]:
        run_all(work, range(len(planes)))
    return codes


def _equal_counts(values: NDArray[np.floating], bins: int) -> NDArray[np.floating]:
    """Inner edges of the bins; a value on an edge is in the bin below."""
    return np.unique(np.quantile(values, np.arange(1, bins) / bins, method="lower"))


def _equal_widths(values: NDArray[np.floating], bins: int) -> NDArray[np.float64]:
    low, high = np.quantile(values, _INNER, method="nearest").astype(np.float64)
    if low == high:
        low, high = float(values.min()), float(values.max())
    return np.linspace(low, high, bins + 1)[1:-1]


def mutual_information(
    first: NDArray[np.int8], second: NDArray[np.int8], bins: int, rng: np.random.Generator
) -> Information:
    """Normalised mutual information of binned channels ``(A, N)`` with others ``(B, N)``.

    It is normalised by the mean entropy of the two channels.
    """
    raw = _normalised(first, second, bins)
    shuffled = np.ascontiguousarray(second[:, rng.permutation(second.shape[1])])
    bias = _normalised(first, shuffled, bins)
    # With a bias of 1, the sample is too small to show anything, and the result is 0.
    room = np.where(bias < 1.0, 1.0 - bias, np.inf)
    return Information((raw - bias) / room, raw, bias)


def _normalised(
    first: NDArray[np.int8], second: NDArray[np.int8], bins: int
) -> NDArray[np.float64]:
    from scipy.stats import entropy

    result = np.zeros((len(first), len(second)))
    if not first.shape[1]:
        return result

    def work(row: int) -> None:
        tables = np.zeros((len(second), bins, bins), np.int64)
        _count_pairs(first[row], second, tables)
        of_first = entropy(tables.sum(axis=2), axis=1)
        of_second = entropy(tables.sum(axis=1), axis=1)
        together = entropy(tables.reshape(len(second), -1), axis=1)
        known = (of_first > 0) & (of_second > 0)
        both = np.where(known, of_first + of_second, 1.0)
        result[row] = np.where(known, np.clip(2.0 * (both - together) / both, 0.0, 1.0), 0.0)

    run_all(work, range(len(first)))
    return result


@kernel
def _count_pairs(first, second, tables):
    for start in range(0, first.size, _CHUNK):
        stop = min(start + _CHUNK, first.size)
        for k in range(len(second)):
            for i in range(start, stop):
                tables[k, first[i], second[k, i]] += 1


def is_zero(planes: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which values of channels ``(..., N)`` are at most 1/100 of the channel's mean magnitude."""
    if not planes.size:
        return np.zeros(planes.shape, bool)
    magnitude = np.abs(planes)
    return magnitude <= _SHARE * magnitude.mean(axis=-1, keepdims=True, dtype=np.float64)

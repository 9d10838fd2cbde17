"""Integer frequency tables made from weights, and the code lengths they give."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.linear import dot
from gs_codec.runtime.kernels import inlined, kernel

#: Minimum base-2 logarithm of a table's sum.
MIN_PRECISION = 8

#: Maximum base-2 logarithm of a table's sum. With states of 16 to 32 bits, 16 would cost rANS
#: 0.1 %.
MAX_PRECISION = 15


@dataclass(frozen=True)
class FrequencyTable:
    """Integer frequencies ``(A,)`` that sum to ``2**precision``; frequency 0 means impossible."""

    frequencies: NDArray[np.uint32]
    precision: int

    @property
    def starts(self) -> NDArray[np.uint32]:
        """Cumulative frequency before each symbol, ``(A,)``."""
        return (np.cumsum(self.frequencies) - self.frequencies).astype(np.uint32)

    @property
    def spans(self) -> NDArray[np.uint32]:
        """Start << 16 | frequency of each symbol, ``(A,)``."""
        return (self.starts << np.uint32(16)) | self.frequencies

    @property
    def slots(self) -> NDArray[np.uint16]:
        """Symbol of each slot, ``(2**precision,)``."""
        return np.repeat(np.arange(self.frequencies.size, dtype=np.uint16), self.frequencies)

    def code_length(self, histogram: NDArray[np.int64]) -> float:
        """Bits of symbols with this histogram; infinite if one of them has frequency 0."""
        occurring = histogram > 0
        if np.any(self.frequencies[occurring] == 0):
            return np.inf
        bits = self.precision - np.log2(self.frequencies[occurring])
        return dot(histogram[occurring], bits)


def normalise(weights: NDArray[np.int64], precision: int) -> FrequencyTable:
    """Frequencies proportional to `weights`, at least 1 where the weight is above 0.

    Shares are rounded down. If the sum is too low, the largest remainders get 1 each (ties: the
    lower symbol); if it is too high, 1 is taken from the largest frequency (ties: the lower
    symbol) until it fits. FORMAT.md, section "Frequency tables".

    Parameters
    ----------
    weights : ndarray, shape (A,), int64
        0 to 2**46, not all 0; at most ``2**precision`` of them above 0.
    precision : int
        Base-2 logarithm of the sum of the frequencies, 8-15.
    """
    frequencies = np.empty(len(weights), np.int64)
    _normalise(weights, precision, frequencies)
    return FrequencyTable(frequencies.astype(np.uint32), precision)


@inlined
def _raise(frequencies, remainders, missing):
    """Add 1 to the `missing` largest remainders (ties: the lower symbol), in place."""
    # Find the lowest level with at most `missing` remainders above it.
    low, high = np.int64(0), np.int64(1) << 62
    while low < high:
        level, above = (low + high) // 2, 0
        for remainder in remainders:
            above += np.int64(remainder > level)
        if above <= missing:
            high = level
        else:
            low = level + 1
    for i in range(len(frequencies)):
        if remainders[i] > high:
            frequencies[i] += 1
            missing -= 1
    for i in range(len(frequencies)):
        if remainders[i] == high and missing > 0:
            frequencies[i] += 1
            missing -= 1


@inlined
def _lower(frequencies, surplus):
    """Take `surplus` in units of 1 from the largest (ties: the lower symbol), in place."""
    # Find the lowest level to which all larger frequencies can be cut without exceeding the
    # surplus.
    low, high = np.int64(0), np.int64(1) << 62
    while low < high:
        level, above = (low + high) // 2, 0
        for frequency in frequencies:
            above += max(frequency - level, 0)
        if above <= surplus:
            high = level
        else:
            low = level + 1
    for i in range(len(frequencies)):
        surplus -= max(frequencies[i] - high, 0)
        frequencies[i] = min(frequencies[i], high)
    for i in range(len(frequencies)):
        if frequencies[i] == high and surplus > 0:
            frequencies[i] -= 1
            surplus -= 1


@kernel
def _normalise(weights, precision, frequencies):
    total = 0
    for weight in weights:
        total += weight
    remainders, missing = np.empty(len(weights), np.int64), np.int64(1) << precision
    for i in range(len(weights)):
        scaled = weights[i] << precision
        share = scaled // total
        frequencies[i] = max(share, np.int64(weights[i] > 0))
        remainders[i] = scaled - share * total if share > 0 else -1
        missing -= frequencies[i]
    if missing > 0:
        _raise(frequencies, remainders, missing)
    elif missing < 0:
        _lower(frequencies, -missing)


def shannon_bits(histogram: NDArray[np.int64]) -> float:
    """Entropy of a histogram times its number of symbols, in bits."""
    counts = histogram[histogram > 0].astype(np.float64)
    return dot(counts, np.log2(counts.sum() / counts))

"""Integer frequency tables made from weights, their code lengths, and how they are transmitted.

Transmitted tables are counts with a short mantissa, coded by the binary coder. A weight is coded as
its bit length, relative to the previous one, and up to `mantissa` bits below its leading one.
FORMAT.md, section "Sent tables".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.binary import bit_length, code_bit, decode_binary, encode_binary, new_contexts
from gs_codec.coding.exact_math import dot
from gs_codec.errors import CorruptStream
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


#: Bit length of the largest weight.
MAX_EXPONENT = 32
MAX_MANTISSA = 15


_STEPS = MAX_EXPONENT + 1
_SAME = 0  # contexts of 'length unchanged', by the previous such decision and the alphabet
_SIGN = 6
_SIZE = 12
_MANTISSA = _SIZE + 2 * _STEPS
_CONTEXTS = _MANTISSA + MAX_MANTISSA + 1


@dataclass(frozen=True)
class SentModel:
    """Weights ``(A,)`` below 2**32 whose bits after the first `mantissa` + 1 are 0."""

    kind: ClassVar[str] = "table"
    weights: NDArray[np.int64]
    mantissa: int
    precision: int

    @classmethod
    def fit(cls, histogram: NDArray[np.int64], mantissa: int, precision: int) -> SentModel:
        """Round counts to `mantissa` bits after the leading one."""
        excess = max(int(histogram.max()).bit_length() - MAX_EXPONENT + 1, 0)
        counts = np.where(histogram > 0, np.maximum(histogram >> excess, 1), 0)
        lengths = np.frexp(counts.astype(np.float64))[1]
        shifts = np.maximum(lengths - 1 - mantissa, 0)
        weights = (counts + ((1 << shifts) >> 1)) >> shifts << shifts
        return cls(weights, mantissa, precision)

    def frequencies(self, alphabet: int) -> FrequencyTable:
        """Table of `alphabet` symbols; symbols of weight 0 cannot occur."""
        return normalise(self.weights, self.precision)

    def describe(self) -> dict[str, int]:
        """Number of symbols in use and mantissa bits, for reports."""
        return {"symbols": int(np.count_nonzero(self.weights)), "mantissa": self.mantissa}


@kernel
def _decide(state, data, contexts, context, bit):
    """`code_bit`, compiled once for all its calls in `_walk`."""
    return code_bit(state, data, contexts, context, bit)


@kernel
def _walk(weights, mantissa, state, data, contexts, encoding):
    """Code the weights of one table; return False if a length is outside 0..MAX_EXPONENT."""
    before = 0
    changed = 1
    large = 1 if weights.size > 32 else 0
    for symbol in range(weights.size):
        weight = weights[symbol]
        length = bit_length(weight) if encoding else 0
        kind = 3 * large + (2 if before == 0 else changed)
        if _decide(state, data, contexts, _SAME + kind, length == before):
            length = before
            changed = 0
        else:
            shrinks = _decide(state, data, contexts, _SIGN + kind, length < before)
            size = abs(length - before)
            known = 1
            while known < _STEPS:
                context = _SIZE + _STEPS * large + known - 1
                if not _decide(state, data, contexts, context, size > known):
                    break
                known += 1
            length = before - known if shrinks else before + known
            changed = 1
        if length < 0 or length > MAX_EXPONENT:
            return False
        before = length
        if length == 0:
            weights[symbol] = 0
            continue
        value = 1
        for shift in range(length - 2, -1, -1):
            rank = length - 2 - shift
            bit = 0
            if rank < mantissa:
                given = (weight >> shift) & 1 == 1
                bit = 1 if _decide(state, data, contexts, _MANTISSA + rank, given) else 0
            value = 2 * value + bit
        weights[symbol] = value
    return True


def encode_tables(weights: list[NDArray[np.int64]], mantissas: list[int]) -> bytes:
    """Code the weights of several tables into one stream."""

    def model(state: NDArray, data: NDArray) -> None:
        contexts = new_contexts(_CONTEXTS)
        for table, mantissa in zip(weights, mantissas, strict=True):
            _walk(table.copy(), mantissa, state, data, contexts, True)

    return encode_binary(model, 0)


def decode_tables(
    data: memoryview, alphabets: list[int], mantissas: list[int], where: str
) -> list[NDArray[np.int64]]:
    """Invert `encode_tables`.

    Raises CorruptStream if the size of the stream does not match the tables, or a table has no
    symbol.
    """
    weights = [np.zeros(alphabet, np.int64) for alphabet in alphabets]

    def model(state: NDArray, stream: NDArray) -> None:
        contexts = new_contexts(_CONTEXTS)
        for table, mantissa in zip(weights, mantissas, strict=True):
            if not _walk(table, mantissa, state, stream, contexts, False):
                raise CorruptStream(f"{where}: a weight of more than {MAX_EXPONENT} bits")
            if not table.any():
                raise CorruptStream(f"{where}: a table without symbols")

    decode_binary(model, data, where)
    return weights

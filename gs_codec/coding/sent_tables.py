"""Transmitted frequency tables: counts with a short mantissa, coded by the binary coder.

A weight is coded as its bit length, relative to the previous one, and up to `mantissa` bits below
its leading one. FORMAT.md, section "Sent tables".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.binary import bit_length, code_bit, decode_binary, encode_binary, new_contexts
from gs_codec.coding.frequency_table import FrequencyTable, normalise
from gs_codec.errors import CorruptStream
from gs_codec.runtime.kernels import kernel

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

    Raises
    ------
    CorruptStream
        If the size of the stream does not match the tables, or a table has no symbol.
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

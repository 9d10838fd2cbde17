"""Integers as tokens of a small alphabet and raw low bits (after JPEG XL's hybrid integers).

Magnitudes below 16 are tokens of their own; of larger ones the token tells the bit length and
the two bits below the first, and the rest is raw. FORMAT.md, section "Tokens".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.entropy.binary import code_raw
from gs_codec.entropy.passes import LANES, PassReader, pull
from gs_codec.errors import CorruptStream
from gs_codec.kernels import inlined, kernel

_DIRECT = 16
_DIRECT_BITS = 4
_KEPT_BITS = 2

#: Magnitudes have at most this many bits.
MAX_BITS = 30

#: Number of tokens.
ALPHABET = 2 * (_DIRECT + ((MAX_BITS - _DIRECT_BITS) << _KEPT_BITS))


@inlined
def _bit_length(value):
    length = 0
    while value > 0:
        value >>= 1
        length += 1
    return length


@inlined
def token_of(value):
    """Token of an integer: twice that of its magnitude, plus 1 if it is negative."""
    size = abs(value)
    if size >= _DIRECT:
        length = _bit_length(size)
        rest = length - 1 - _KEPT_BITS
        size = _DIRECT + ((length - 1 - _DIRECT_BITS) << _KEPT_BITS) + ((size >> rest) & 3)
    return 2 * size + (1 if value < 0 else 0)


@inlined
def raw_width(token):
    """Number of raw bits that complete a token."""
    size = token >> 1
    if size < _DIRECT:
        return 0
    return ((size - _DIRECT) >> _KEPT_BITS) + _DIRECT_BITS - _KEPT_BITS


@inlined
def value_of(token, rest):
    """The integer of a token and its raw bits."""
    size = token >> 1
    if size >= _DIRECT:
        width = ((size - _DIRECT) >> _KEPT_BITS) + _DIRECT_BITS - _KEPT_BITS
        size = ((4 + ((size - _DIRECT) & 3)) << width) | rest
    return -size if token & 1 else size


@kernel
def _tokenise(values, tokens, widths):
    total = 0
    for i in range(len(values)):
        token = token_of(values[i])
        tokens[i] = token
        widths[i] = raw_width(token)
        total += widths[i]
    return total


@kernel
def _write_raw(values, widths, position, bits):
    for i in range(len(values)):
        if widths[i]:
            code_raw(bits, position, widths[i], abs(values[i]), True)
            position += widths[i]
    return position


@kernel
def _read_fields(widths, position, bits, values):
    for i in range(len(widths)):
        values[i] = code_raw(bits, position, widths[i], 0, False)
        position += widths[i]
    return position


@kernel
def _read_values(
    words, position, end, states, spans, slots, rows, contexts, bits, used, values
):  # fmt: skip
    """Decode a pass into `values`; positions after what is read of words (-1: beyond) and bits.

    `words` is padded by a row of zeros, so that a row needs no check of its own.
    """
    for first in range(0, len(values), LANES):
        if position > end:
            return -1, used
        for i in range(first, min(first + LANES, len(values))):
            row = rows[contexts[i]]
            token, position = pull(words, position, states, i & (LANES - 1), spans[row], slots[row])
            rest = 0
            if token >= 2 * _DIRECT:
                width = raw_width(token)
                rest = code_raw(bits, used, width, 0, False)
                used += width
            values[i] = value_of(token, rest)
    return position, used


def tokenise(values: NDArray[np.int64]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Tokens ``(n,)`` of integers below 2**30 in magnitude, and the widths of their raw bits."""
    tokens = np.empty(len(values), np.uint8)
    widths = np.empty(len(values), np.uint8)
    _tokenise(values, tokens, widths)
    return tokens, widths


class BitWriter:
    """Raw bits of a section, first bit of a byte first."""

    def __init__(self) -> None:
        self.parts: list[tuple[NDArray[np.int64], NDArray[np.uint8]]] = []

    def add(self, values: NDArray[np.int64], widths: NDArray[np.uint8]) -> None:
        """Append the ``widths (n,)`` low bits of the magnitudes of ``values (n,)``."""
        self.parts.append((values, widths))

    def finish(self) -> bytes:
        """All bits, padded with zeros to a byte."""
        total = sum(int(widths.sum(dtype=np.int64)) for _, widths in self.parts)
        bits = np.zeros((total + 7) // 8, np.uint8)
        position = 0
        for values, widths in self.parts:
            position = _write_raw(values, widths, position, bits)
        return bits.tobytes()


class BitReader:
    """Reads what `BitWriter` wrote."""

    def __init__(self, data: memoryview, where: str) -> None:
        self.bits = np.frombuffer(data, np.uint8)
        self.position = 0
        self.where = where

    def fields(self, widths: NDArray[np.int64]) -> NDArray[np.int64]:
        """Numbers ``(n,)`` of so many bits."""
        values = np.empty(len(widths), np.int64)
        self.position = _read_fields(widths, self.position, self.bits, values)
        return values

    def close(self) -> None:
        """Check that just the padding is left, and is 0."""
        if self.bits.size != (self.position + 7) // 8:
            raise CorruptStream(
                f"{self.where}: {self.bits.size} raw bytes, expected {(self.position + 7) // 8}"
            )
        if self.position % 8 and self.bits[-1] & (0xFF >> self.position % 8):
            raise CorruptStream(f"{self.where}: padding bits that are not 0")


def read_pass(
    reader: PassReader, bits: BitReader, rows: NDArray[np.int64], contexts: NDArray[np.int64]
) -> NDArray[np.int64]:
    """The integers ``(n,)`` of a pass, whose tables are ``rows[contexts]``.

    Raises
    ------
    CorruptStream
        If there are fewer words than symbols.
    """
    values = np.empty(len(contexts), np.int64)
    tables = (reader.tables.spans, reader.tables.slots)
    position, bits.position = _read_values(
        reader.words, reader.position, reader.end, reader.states, *tables, rows, contexts,
        bits.bits, bits.position, values,
    )  # fmt: skip
    reader.advance(position)
    return values

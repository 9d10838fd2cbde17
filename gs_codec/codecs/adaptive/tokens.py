"""Integers as tokens of a small alphabet and raw low bits (after JPEG XL's hybrid integers).

Each magnitude below 16 has a token of its own. The token of a larger one gives its bit length and
the two bits below the first; the rest is raw. FORMAT.md, section "Tokens".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.binary import bit_length, code_raw
from gs_codec.coding.context_rans import PRECISION, PassReader
from gs_codec.coding.fields import BitReader
from gs_codec.coding.rans import LANES, pull
from gs_codec.runtime.kernels import inlined, kernel

_DIRECT = 16
_DIRECT_BITS = 4
_KEPT_BITS = 2

#: Magnitudes have at most this many bits.
MAX_BITS = 30

#: Number of tokens.
ALPHABET = 2 * (_DIRECT + ((MAX_BITS - _DIRECT_BITS) << _KEPT_BITS))


@inlined
def token_of(value):
    """Token of an integer: twice that of its magnitude, plus 1 if it is negative."""
    size = abs(value)
    if size >= _DIRECT:
        length = bit_length(size)
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
def magnitude_of(size, width, rest):
    """The magnitude of the token of one, from 16 up, and its raw bits."""
    return ((4 + ((size - _DIRECT) & 3)) << width) | rest


@inlined
def flipped(value, minus):
    """The value, or the negative one if `minus` is -1 and not 0, without a branch."""
    return (value ^ minus) - minus


@inlined
def value_of(token, rest):
    """The integer of a token and its raw bits."""
    size = token >> 1
    if size >= _DIRECT:
        size = magnitude_of(size, raw_width(token), rest)
    return flipped(size, -(token & 1))


@inlined
def read_token(words, position, states, lane, spans, slots, bits, used):
    """Decode an integer under a table; returns it and the positions after it in words and bits."""
    token, position = pull(words, position, states, lane, spans, slots, PRECISION)
    size = token >> 1
    if size >= _DIRECT:
        width = raw_width(token)
        size = magnitude_of(size, width, code_raw(bits, used, width, 0, False))
        used += width
    return flipped(size, -(token & 1)), position, used


@kernel
def _tokenise(values, tokens, widths):
    for i in range(len(values)):
        token = token_of(np.int64(values[i]))
        tokens[i] = token
        widths[i] = raw_width(token)


@kernel
def _read_values(
    words, position, end, states, spans, slots, rows, bits, used, contexts, indices, values
):  # fmt: skip
    """Decode a pass into `values[indices]`; returns the positions reached in words and bits.

    The position in words is -1 if they end too early.
    """
    tokens = np.empty(LANES, np.uint8)
    for first in range(0, len(contexts), LANES):
        if position > end:
            return -1, used
        count = min(LANES, len(contexts) - first)
        for lane in range(count):
            row = np.uint64(rows[contexts[first + lane]])
            tokens[lane], position = pull(
                words, position, states, lane, spans[row], slots[row], PRECISION
            )
        for lane in range(count):
            token = np.int64(tokens[lane])
            rest = 0
            if token >= 2 * _DIRECT:
                width = raw_width(token)
                rest = code_raw(bits, used, width, 0, False)
                used += width
            values[np.uint64(indices[first + lane])] = value_of(token, rest)
    return position, used


def tokenise(
    values: NDArray[np.integer],
) -> tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.uint8]]:
    """Tokens ``(n,)`` of integers below 2**30 in magnitude, and those with raw bits.

    The latter are the integers whose tokens need raw bits, in order, and the number of these bits.
    """
    tokens, widths = np.empty((2, len(values)), np.uint8)
    _tokenise(values, tokens, widths)
    raw = np.flatnonzero(widths)
    return tokens, values[raw].astype(np.int64), widths[raw]


def read_pass(
    reader: PassReader,
    bits: BitReader,
    rows: NDArray[np.int64],
    contexts: NDArray[np.integer],
    indices: NDArray[np.integer],
    values: NDArray[np.integer],
) -> None:
    """Read the integers of a pass, whose tables are ``rows[contexts]``, into ``values[indices]``.

    Raises
    ------
    CorruptStream
        If there are fewer words than symbols.
    """
    reader.decode(_read_values, rows, bits, contexts, indices, values)

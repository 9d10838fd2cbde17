"""Integers as tokens of a small alphabet and raw low bits (after JPEG XL's hybrid integers).

Each magnitude below 16 has its own token. The token of a larger one gives its bit length and the
two bits below the leading one; the other bits are raw. FORMAT.md, section "Tokens".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.binary import bit_length
from gs_codec.coding.context_rans import PRECISION, RUN_BITS, SPAN_BITS
from gs_codec.coding.rans import LANES, pull
from gs_codec.runtime.kernels import inlined, kernel

DIRECT = 16
DIRECT_BITS = 4
KEPT_BITS = 2

#: Maximum bits of a magnitude.
MAX_BITS = 30

#: Number of tokens.
ALPHABET = 2 * (DIRECT + ((MAX_BITS - DIRECT_BITS) << KEPT_BITS))

#: Number of raw bits that follow each token.
RAW_WIDTHS = np.array(
    [
        0 if size < DIRECT else ((size - DIRECT) >> KEPT_BITS) + DIRECT_BITS - KEPT_BITS
        for size in np.arange(ALPHABET) // 2
    ]
)


@inlined
def token_of(value):
    """Token of an integer: twice the token of its magnitude, plus 1 if it is negative."""
    size = abs(value)
    if size >= DIRECT:
        length = bit_length(size)
        rest = length - 1 - KEPT_BITS
        size = DIRECT + ((length - 1 - DIRECT_BITS) << KEPT_BITS) + ((size >> rest) & 3)
    return 2 * size + (1 if value < 0 else 0)


@inlined
def flipped(value, minus):
    """Negate `value` if `minus` is -1 rather than 0, without a branch."""
    return (value ^ minus) - minus


@inlined
def read_token(words, position, states, symbol, spans, slots, row, bits, used, rarely):
    """Decode an integer, symbol number `symbol` of a pass, with table number `row`.

    If `rarely`, few tokens have raw bits, so a branch on them is predicted well. Returns the
    integer and the positions after it in words and bits.
    """
    token, position = pull(
        words, position, states, symbol & (LANES - 1),
        spans, slots, np.int64(row) << SPAN_BITS, np.int64(row) << (PRECISION - RUN_BITS),
        PRECISION, RUN_BITS,
    )  # fmt: skip
    size = token >> 1
    # Before the branch: an array that is used only inside it would be reference-counted.
    at = used >> 3
    window = np.int64(bits[np.uint64(at)]) << 32 | np.int64(bits[np.uint64(at + 1)]) << 24
    window |= np.int64(bits[np.uint64(at + 2)]) << 16 | np.int64(bits[np.uint64(at + 3)]) << 8
    window |= np.int64(bits[np.uint64(at + 4)])
    if not rarely or size >= DIRECT:
        beyond = size - DIRECT
        large = ~(beyond >> 63)
        width = ((beyond >> KEPT_BITS) + DIRECT_BITS - KEPT_BITS) & large
        rest = (window >> (40 - (used & 7) - width)) & ((1 << width) - 1)
        size = (size & ~large) | (((4 + (beyond & 3)) << width) & large) | rest
        used += width
    return flipped(size, -(token & 1)), position, used


@kernel
def _tokenise(values, tokens):
    """Fill ``tokens (n,)``; return the number of integers with raw bits."""
    number = 0
    for i in range(len(values)):
        token = token_of(np.int64(values[i]))
        tokens[i] = token
        number += np.int64(token >= 2 * DIRECT)
    return number


@kernel
def _list_raw(values, tokens, symbols, levels, widths):
    found = 0
    for i in range(len(values)):
        if tokens[i] >= 2 * DIRECT:
            symbols[found], levels[found] = i, values[i]
            widths[found] = RAW_WIDTHS[tokens[i]]
            found += 1


def tokenise(
    values: NDArray[np.integer],
) -> tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.int64], NDArray[np.uint8]]:
    """Convert integers below 2**30 in magnitude to tokens ``(n,)`` and raw bits.

    The other three arrays describe the integers with raw bits: their indices, ascending; the
    integers themselves; and their numbers of raw bits.
    """
    tokens = np.empty(len(values), np.uint8)
    number = _tokenise(values, tokens)
    raw, levels = np.empty((2, number), np.int64)
    widths = np.empty(number, np.uint8)
    _list_raw(values, tokens, raw, levels, widths)
    return tokens, raw, levels, widths

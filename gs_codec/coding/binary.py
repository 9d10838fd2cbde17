"""Adaptive binary arithmetic coder: one model function both encodes and decodes.

A model is a kernel that calls `code_bit` for each decision. When encoding, `code_bit` codes the
decision and returns it; when decoding, it ignores the argument and returns the decision it reads.
Encoder and decoder share one model, so they cannot differ. FORMAT.md, section "Binary coder", is
the normative text.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import CorruptStream
from gs_codec.runtime.kernels import inlined

# Fields of a coder's state. Signed arithmetic throughout: numba turns a mix of signed and
# unsigned integers into floats, which made this coder five times slower.
_LOW, _HIGH, _CODE, _POSITION, _ENCODING = range(5)

_MASK = 0xFFFFFFFF
_TOP = 0xFF000000

#: Adaptation rate after n occurrences of a context, in 1/65536: about 1 / (n + 1.5).
_RATES = np.array([131072 // (2 * n + 3) for n in range(256)], np.int64)


@inlined
def code_bit(state, data, contexts, context, bit):
    """Code one decision under `context`; return it."""
    low = state[_LOW]
    high = state[_HIGH]
    packed = contexts[context]
    chance = np.int64(packed >> 8)
    seen = packed & 255
    middle = low + (((high - low) * chance) >> 16)
    if state[_ENCODING] == 0:
        bit = state[_CODE] <= middle
    if bit:
        high = middle
        chance += ((65536 - chance) * _RATES[seen]) >> 16
    else:
        low = middle + 1
        chance -= (chance * _RATES[seen]) >> 16
    contexts[context] = (chance << 8) | min(seen + 1, 255)
    while (low ^ high) & _TOP == 0:
        position = state[_POSITION]
        if state[_ENCODING] != 0:
            if position < data.size:
                data[position] = high >> 24
        else:
            byte = np.int64(data[position]) if position < data.size else 0
            state[_CODE] = ((state[_CODE] << 8) | byte) & _MASK
        state[_POSITION] = position + 1
        low = (low << 8) & _MASK
        high = ((high << 8) & _MASK) | 255
    state[_LOW] = low
    state[_HIGH] = high
    return bit


@inlined
def read_raw(bits, position, width):
    """Read `width` bits, most significant first, starting at bit `position`."""
    at = position
    left = width
    read = 0
    while left > 0:
        take = min(8 - (at & 7), left)
        shift = 8 - (at & 7) - take
        field = (1 << take) - 1
        if at >> 3 < bits.size:
            read = (read << take) | ((np.int64(bits[at >> 3]) >> shift) & field)
        else:
            read <<= take
        at += take
        left -= take
    return read


@inlined
def bit_length(value):
    """Number of bits of an integer >= 0; 0 for 0."""
    length = 0
    while value > 0:
        value >>= 1
        length += 1
    return length


@inlined
def code_integer(state, data, contexts, base, magnitudes, value):
    """Code a signed integer with a bit length below `magnitudes`; return it.

    Its bit length (unary), its sign, then the bits below the leading one, under ``4 * magnitudes``
    contexts from `base` on.
    """
    size = abs(value)
    length = bit_length(size)
    known = 0
    while known < magnitudes - 1:
        if not code_bit(state, data, contexts, base + known, length > known):
            break
        known += 1
    if known == 0:
        return 0
    negative = code_bit(state, data, contexts, base + magnitudes, value < 0)
    found = 1
    for shift in range(known - 2, -1, -1):
        rank = min(known - 2 - shift, 2)
        context = base + (1 + rank) * magnitudes + known
        bit = code_bit(state, data, contexts, context, (size >> shift) & 1)
        found = 2 * found + (1 if bit else 0)
    return -found if negative else found


#: A fresh context: probability of a 1 in 1/65536, shifted by 8, and number of occurrences.
FRESH = 32768 << 8


def new_contexts(count: int) -> NDArray[np.int32]:
    """Make `count` fresh contexts."""
    return np.full(count, FRESH, np.int32)


def encode_binary(model: Callable[[NDArray, NDArray], None], capacity: int) -> bytes:
    """Run ``model(state, data)`` as an encoder and return its bytes.

    `capacity` is the expected number of bytes; if it is too low, the model runs again.
    """
    capacity += 1024
    while True:
        data = np.zeros(capacity, np.uint8)
        state = np.array([0, _MASK, 0, 0, 1], np.int64)
        model(state, data)
        position = int(state[_POSITION])
        if position + 4 <= capacity:
            break
        capacity = position + 4
    low, high = int(state[_LOW]), int(state[_HIGH])
    kept = _flush_length(low, high)
    return data[:position].tobytes() + high.to_bytes(4, "big")[:kept]


def decode_binary(
    model: Callable[[NDArray, NDArray], None], data: bytes | memoryview, where: str
) -> None:
    """Run ``model(state, data)`` as a decoder and check that it consumed exactly `data`."""
    stream = np.frombuffer(data, np.uint8).copy()
    code = int.from_bytes(bytes(data[:4]).ljust(4, b"\0"), "big")
    state = np.array([0, _MASK, code, 4, 0], np.int64)
    model(state, stream)
    check_end(int(state[_LOW]), int(state[_HIGH]), int(state[_POSITION]), stream.size, where)


def check_end(low: int, high: int, position: int, size: int, where: str) -> None:
    """Check that a decoder in state `low`, `high`, `position` has consumed exactly `size` bytes."""
    used = position - 4 + _flush_length(low, high)
    if used != size:
        raise CorruptStream(f"{where}: {size} coded bytes, expected {used}")


def _flush_length(low: int, high: int) -> int:
    """Smallest number of leading bytes of `high` that, padded with zeros, lie in [low, high]."""
    for kept in range(4):
        if high >> (32 - 8 * kept) << (32 - 8 * kept) >= low:
            return kept
    return 4

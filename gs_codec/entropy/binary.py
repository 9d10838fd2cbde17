"""Adaptive binary arithmetic coder: one function walks a model in both directions.

A model is a kernel that calls `code_bit` for each decision. Encoding, `code_bit` takes the
decision and returns it; decoding, it ignores the argument and returns what the stream says.
So a model is written once and cannot differ between encoder and decoder. FORMAT.md, section
"Binary coder", is the normative text.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import CorruptStream
from gs_codec.kernels import inlined

# Fields of a coder's state, a uint64 array.
_LOW, _HIGH, _CODE, _POSITION, _ENCODING = range(5)
_STATE_SIZE = 5

_MASK = np.uint64(0xFFFFFFFF)
_TOP = np.uint64(0xFF000000)
_EIGHT = np.uint64(8)
_SIXTEEN = np.uint64(16)

#: Adaptation rate after n occurrences of a context, in 1/65536: about 1 / (n + 1.5).
_RATES = np.array([131072 // (2 * n + 3) for n in range(256)], np.uint64)
_SMALLEST, _LARGEST = 32, 65536 - 32


@inlined
def code_bit(state, data, contexts, hits, context, bit):
    """Code one decision under `context`; returns it."""
    low = state[_LOW]
    high = state[_HIGH]
    chance = np.uint64(contexts[context])
    middle = low + (((high - low) * chance) >> _SIXTEEN)
    if state[_ENCODING] == 0:
        bit = state[_CODE] <= middle
    rate = _RATES[hits[context]]
    if bit:
        high = middle
        chance += ((np.uint64(65536) - chance) * rate) >> _SIXTEEN
    else:
        low = middle + np.uint64(1)
        chance -= (chance * rate) >> _SIXTEEN
    contexts[context] = min(max(chance, np.uint64(_SMALLEST)), np.uint64(_LARGEST))
    if hits[context] < 255:
        hits[context] += 1
    while (low ^ high) & _TOP == 0:
        position = state[_POSITION]
        if state[_ENCODING] != 0:
            if position < data.size:
                data[position] = high >> np.uint64(24)
        else:
            byte = np.uint64(data[position]) if position < data.size else np.uint64(0)
            state[_CODE] = ((state[_CODE] << _EIGHT) | byte) & _MASK
        state[_POSITION] = position + np.uint64(1)
        low = (low << _EIGHT) & _MASK
        high = ((high << _EIGHT) | np.uint64(255)) & _MASK
    state[_LOW] = low
    state[_HIGH] = high
    return bit


@inlined
def code_raw(bits, position, width, value, encoding):
    """Code the `width` low bits of `value`, most significant first, at bit `position`."""
    if encoding:
        for i in range(width):
            at = position + i
            if (value >> np.uint64(width - 1 - i)) & np.uint64(1):
                bits[at >> 3] |= np.uint8(128 >> (at & 7))
        return value
    value = np.uint64(0)
    at = position
    end = position + width
    while at < end:
        take = min(8 - (at & 7), end - at)
        byte = np.uint64(bits[at >> 3]) if (at >> 3) < bits.size else np.uint64(0)
        field = (byte >> np.uint64(8 - (at & 7) - take)) & np.uint64((1 << take) - 1)
        value = (value << np.uint64(take)) | field
        at += take
    return value


def new_contexts(count: int) -> tuple[NDArray[np.uint16], NDArray[np.uint8]]:
    """Probability (of a 1, in 1/65536) and occurrence count of `count` fresh contexts."""
    return np.full(count, 32768, np.uint16), np.zeros(count, np.uint8)


def encode_binary(model: Callable[[NDArray, NDArray], None], capacity: int) -> bytes:
    """Run ``model(state, data)`` as an encoder and return its bytes.

    `capacity` is a guess of their number; the model runs once more if it was too low.
    """
    capacity += 1024
    while True:
        data = np.zeros(capacity, np.uint8)
        state = np.array([0, _MASK, 0, 0, 1], np.uint64)
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
    """Run ``model(state, data)`` as a decoder and check that it used exactly `data`."""
    stream = np.frombuffer(data, np.uint8).copy()
    code = int.from_bytes(bytes(data[:4]).ljust(4, b"\0"), "big")
    state = np.array([0, _MASK, code, 4, 0], np.uint64)
    model(state, stream)
    used = int(state[_POSITION]) - 4 + _flush_length(int(state[_LOW]), int(state[_HIGH]))
    if used != stream.size:
        raise CorruptStream(f"{where}: {stream.size} coded bytes, expected {used}")


def _flush_length(low: int, high: int) -> int:
    """Fewest leading bytes of `high` that, followed by zeros, lie in [low, high]."""
    for kept in range(4):
        if high >> (32 - 8 * kept) << (32 - 8 * kept) >= low:
            return kept
    return 4

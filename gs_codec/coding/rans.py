"""Static rANS, 32 interleaved lanes, 32-bit states, 16-bit renormalisation.

The symbol of row r and lane l of a channel is symbol ``32 r + l`` of that channel; a
decoder reads the 16-bit words of a row in lane order, as a GPU warp would with a ballot.
FORMAT.md, section "rANS".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.frequency_table import FrequencyTable
from gs_codec.errors import CorruptStream
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.wording import counted

LANES = 32
LOWEST = 1 << 16

#: Appended to the words before decoding, so that one bounds check per row of lanes is enough.
PADDING = np.zeros(LANES, np.uint16)


def read_states(data: memoryview, lanes: int, where: str) -> NDArray[np.int64]:
    """Read initial states ``(LANES,)``, the first `lanes` in use; reject damaged ones."""
    if len(data) != 4 * lanes:
        raise CorruptStream(
            f"{where}: {counted(len(data), 'byte')} of states, expected {4 * lanes:,}"
        )
    states = np.full(LANES, LOWEST, np.int64)
    states[:lanes] = np.frombuffer(data, "<u4")
    if np.any(states < LOWEST):
        raise CorruptStream(f"{where}: a rANS state below {LOWEST}")
    return states


def read_words(data: memoryview, where: str) -> NDArray[np.uint16]:
    """Read the 16-bit words of a section; reject an odd number of bytes."""
    if len(data) % 2:
        raise CorruptStream(f"{where}: an odd number of bytes, expected 16-bit words")
    return np.frombuffer(data, "<u2")


def check_final(states: NDArray[np.int64], where: str) -> None:
    """Check that the states after the last symbol are the encoder's initial states."""
    if np.any(states != LOWEST):
        raise CorruptStream(f"{where}: the rANS states do not end where they must")


@dataclass(frozen=True)
class TableSet:
    """Tables of the channels of one stream, packed for the kernels."""

    precisions: NDArray[np.int64]
    spans: NDArray[np.uint32]  # (C, A): start << 16 | frequency
    slots: NDArray[np.uint16]  # symbol of each slot, channel after channel
    offsets: NDArray[np.int64]  # where a channel's slots begin

    @classmethod
    def pack(cls, tables: list[FrequencyTable]) -> TableSet:
        """Pack `tables`; there may be none."""
        precisions = np.array([t.precision for t in tables], np.int64)
        alphabet = max((t.frequencies.size for t in tables), default=0)
        spans = np.zeros((len(tables), alphabet), np.uint32)
        for row, table in zip(spans, tables, strict=True):
            row[: table.frequencies.size] = table.spans
        slots = np.concatenate([np.zeros(0, np.uint16), *(table.slots for table in tables)])
        sizes = 1 << precisions
        return cls(precisions, spans, slots, np.cumsum(sizes) - sizes)


@inlined
def push(words, position, states, lane, span, precision):
    """Code one symbol backwards, given its span; return the new start of the words."""
    frequency = span & 0xFFFF
    state = states[lane]
    full = np.int64(state >= frequency << (32 - precision))
    words[position - 1] = state & 0xFFFF  # kept only if the state overflows; avoids a branch
    position -= full
    state >>= full << 4
    # Exact: both are below 2**32, so the quotient is not rounded up to an integer.
    quotient = np.int64(np.float64(state) / np.float64(frequency))
    states[lane] = (quotient << precision) + state - quotient * frequency + (span >> 16)
    return position


@inlined
def pull(words, position, states, lane, spans, slots, of_span, of_slot, precision, run_bits):
    """Decode one symbol with the table whose spans and slots begin at these offsets.

    ``slots`` holds the symbol of the first of every ``2**run_bits`` slots. Returns the symbol and
    the position after the words it read. Arrays are not sliced per symbol: that would cost
    reference counting.
    """
    # Unsigned, because numba tests a signed index for < 0.
    state = states[np.uint64(lane)]
    slot = state & ((1 << precision) - 1)
    symbol = np.int64(slots[np.uint64(of_slot + (slot >> run_bits))])
    span = np.int64(spans[np.uint64(of_span + symbol)])
    if run_bits > 0:
        # Few runs of slots have several symbols, so this branch is well predicted.
        while slot - (span >> 16) >= span & 0xFFFF:
            symbol += 1
            span = np.int64(spans[np.uint64(of_span + symbol)])
    state = (span & 0xFFFF) * (state >> precision) + slot - (span >> 16)
    short = np.int64(state < LOWEST)
    # Branch-free: a branch would often be mispredicted.
    word = np.int64(words[np.uint64(position)]) & -short
    states[np.uint64(lane)] = (state << (short << 4)) | word
    return symbol, position + short


@kernel
def _encode(symbols, start, stop, precisions, spans, states, words, firsts):
    """Code symbols[:, start:stop] backwards, from the end of `words`; fill `firsts`."""
    position = words.size
    for channel in range(symbols.shape[0] - 1, -1, -1):
        precision = precisions[channel]
        for i in range(stop - start - 1, -1, -1):
            span = np.int64(spans[channel, symbols[channel, start + i]])
            position = push(words, position, states, i & (LANES - 1), span, precision)
        firsts[channel] = position


@kernel
def _decode(words, bounds, closed, states, precisions, spans, slots, offsets, symbols):
    """Fill `symbols` (C, n); return the first channel that does not end at its bound, or C."""
    position = 0
    count, alphabet = symbols.shape[1], spans.shape[1]
    flat = spans.ravel()
    for channel in range(symbols.shape[0]):
        precision, of_slot = precisions[channel], offsets[channel]
        of_span = channel * alphabet
        out = symbols[channel]
        for first in range(0, count, LANES):
            if position > bounds[channel]:
                return channel
            for i in range(first, min(first + LANES, count)):
                lane = i & (LANES - 1)
                out[i], position = pull(
                    words, position, states, lane, flat, slots, of_span, of_slot, precision, 0
                )
        if position > bounds[channel] or (closed[channel] and position != bounds[channel]):
            return channel
    return symbols.shape[0]


def encode_symbols(
    symbols: NDArray[np.uint16], start: int, stop: int, tables: TableSet
) -> tuple[bytes, list[bytes]]:
    """Code ``symbols[:, start:stop]``, channel by channel.

    Every symbol must have a frequency above 0 in its channel's table.

    Returns
    -------
    states : bytes
        Initial states of the decoder, uint32, one for each lane in use.
    words : list of bytes
        16-bit words of each channel.
    """
    channels, count = len(symbols), stop - start
    states = np.full(LANES, LOWEST, np.int64)
    words = np.empty(1 + channels * count, np.uint16)
    firsts = np.full(channels + 1, words.size, np.int64)
    _encode(symbols, start, stop, tables.precisions, tables.spans, states, words, firsts)
    words = words.astype("<u2")
    parts = [words[a:b].tobytes() for a, b in zip(firsts[:-1], firsts[1:], strict=True)]
    return states[: min(LANES, count)].astype("<u4").tobytes(), parts


def decode_symbols(
    states: memoryview,
    groups: list[tuple[int, memoryview]],
    count: int,
    tables: TableSet,
    where: str,
    whole: bool = True,
) -> NDArray[np.uint16]:
    """Decode symbols ``(C, count)`` of consecutive groups of channels.

    Raises TruncatedStream or CorruptStream if the number of words does not match a group's symbols,
    or the final states are not the encoder's initial states.

    Parameters
    ----------
    states : memoryview
        Initial states from `encode_symbols`.
    groups : list of (int, memoryview)
        Number of channels of each group, and the words that they share.
    count : int
        Symbols of each channel.
    tables : TableSet
        Tables of all channels.
    where : str
        Name of the block in errors.
    whole : bool
        Whether `groups` are all the groups that were coded.
    """
    lanes = read_states(states, min(LANES, count), where)
    words = [read_words(data, where) for _, data in groups]
    members = [channels for channels, _ in groups]
    bounds = np.repeat(np.cumsum([len(part) for part in words]), members)
    closed = np.zeros(bounds.size, np.bool_)
    closed[np.cumsum(members) - 1] = True
    symbols = np.empty((bounds.size, count), np.uint16)
    packed = (tables.precisions, tables.spans, tables.slots, tables.offsets)
    padded = np.concatenate([*words, PADDING])
    decoded = _decode(padded, bounds, closed, lanes, *packed, symbols)
    if decoded < bounds.size:
        raise CorruptStream(f"{where}: channel {decoded} does not end where its words do")
    if whole:
        check_final(lanes, where)
    return symbols

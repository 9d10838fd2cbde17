"""Context-adaptive rANS: symbols decoded before select the table of each symbol.

The coder is that of `rans`: 32 lanes, 32-bit states, 16-bit words. A pass is a sequence of symbols;
symbol i of a pass is coded in lane i mod 32. A pass may have several streams, each with its own
words and raw bits. FORMAT.md, section "Passes".
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.fields import BitReader, BitWriter, ByteReader
from gs_codec.coding.frequency_table import FrequencyTable
from gs_codec.coding.rans import LANES, LOWEST, PADDING, check_final, push, read_states, read_words
from gs_codec.errors import CorruptStream
from gs_codec.runtime.kernels import kernel

PRECISION = 12

#: Zero bytes appended to the raw bits, because a kernel may read the bits of up to `LANES` extra
#: symbols.
MORE_BITS = 8 + 4 * LANES

#: Base-2 logarithm of the number of spans in a table.
SPAN_BITS = 8

#: Base-2 logarithm of the number of slots that share an entry, so that tables fit into the caches.
RUN_BITS = 4

#: Faults that a kernel can report.
FAULTS = (
    "",
    "more symbols than words",
    "a class out of range",
    "a value out of range",
    "a level of SH-AC beyond its sum",
)
OUT_OF_WORDS, BAD_CLASS, BAD_VALUE, BAD_SUM = 1, 2, 3, 4


@dataclass(frozen=True)
class PassTables:
    """Tables of all passes, concatenated.

    ``spans`` holds start << 16 | frequency of each symbol, ``2**SPAN_BITS`` entries per table.
    ``slots`` holds the symbol of the first of every ``2**RUN_BITS`` slots.
    """

    spans: NDArray[np.uint32]
    slots: NDArray[np.uint8]

    @classmethod
    def pack(cls, tables: Sequence[FrequencyTable]) -> PassTables:
        """Pack tables of precision `PRECISION`."""
        spans = np.zeros((len(tables), 1 << SPAN_BITS), np.uint32)
        slots = np.zeros((len(tables), 1 << (PRECISION - RUN_BITS)), np.uint8)
        for span, slot, table in zip(spans, slots, tables, strict=True):
            _pack(table.frequencies, span, slot)
        return cls(spans.ravel(), slots.ravel())


@kernel
def _pack(frequencies, spans, slots):
    start = 0
    for symbol in range(len(frequencies)):
        frequency = np.int64(frequencies[symbol])
        spans[symbol] = (start << 16) | frequency
        first, start = start, start + frequency
        slots[-(-first >> RUN_BITS) : -(-start >> RUN_BITS)] = symbol


@dataclass(frozen=True)
class CodedPass:
    """A pass to encode: tokens and the contexts that select their tables, both ``(n,)``.

    ``rows (contexts,)`` are the table numbers of the contexts. Symbol i belongs to stream ``cycle[i
    % len(cycle)]``. ``raw_symbols`` are the indices of the symbols that have raw bits;
    ``raw_levels`` and ``raw_widths`` are their values and bit counts.
    """

    streams: Sequence[str]
    cycle: NDArray[np.int64]
    rows: NDArray[np.uint16]
    tokens: NDArray[np.uint8]
    contexts: NDArray[np.uint16]
    raw_symbols: NDArray[np.int64]
    raw_levels: NDArray[np.int64]
    raw_widths: NDArray[np.uint8]


@kernel
def _push_all(tokens, contexts, rows, cycle, spans, states, words, begins):
    """Code a pass backwards; `begins` changes from the end to the start of each stream's words."""
    turn = len(tokens) % len(cycle)
    for i in range(len(tokens) - 1, -1, -1):
        turn = (turn if turn > 0 else len(cycle)) - 1
        stream = cycle[turn]
        span = np.int64(spans[(np.int64(rows[contexts[i]]) << SPAN_BITS) + tokens[i]])
        begins[stream] = push(words, begins[stream], states, i & (LANES - 1), span, PRECISION)


def encode_passes(
    passes: Sequence[CodedPass], tables: PassTables
) -> tuple[bytes, dict[str, bytes]]:
    """Code the passes of a block, each with its own streams.

    Returns
    -------
    states : bytes
        Initial states of the decoder.
    sections : dict of str to bytes
        Bytes of each stream, in order: the size of its words, the words, and its raw bits.
    """
    states = np.full(LANES, LOWEST, np.int64)
    sections: dict[str, bytes] = {}
    for item in reversed(passes):
        room = 1 + len(item.tokens)
        words = np.empty(room * len(item.streams), np.uint16)
        ends = room * np.arange(1, len(item.streams) + 1)
        begins, coded_by = ends.copy(), (item.tokens, item.contexts, item.rows, item.cycle)
        _push_all(*coded_by, tables.spans, states, words, begins)
        of_stream = item.cycle[item.raw_symbols % len(item.cycle)]
        for number in reversed(range(len(ends))):
            packed = words[begins[number] : ends[number]].astype("<u2").tobytes()
            widths = item.raw_widths * (of_stream == number)
            sections[item.streams[number]] = stream_bytes(packed, item.raw_levels, widths)
    return states.astype("<u4").tobytes(), dict(reversed(sections.items()))


def stream_bytes(words: bytes, levels: NDArray[np.int64], widths: NDArray[np.uint8]) -> bytes:
    """Serialise one stream of a block: the size of its words, the words, and the raw bits."""
    bits = BitWriter()
    bits.add(levels, widths)
    return struct.pack("<I", len(words)) + words + bits.finish()


class PassReader:
    """Decodes the passes of a block, one after another."""

    def __init__(self, states: memoryview, tables: PassTables, where: str) -> None:
        self.states = read_states(states, LANES, where)
        self.tables = tables
        self.where = where

    def decode(
        self,
        sections: Sequence[memoryview],
        kernel: Callable,
        rows: NDArray[np.uint16],
        *arguments: Any,
    ) -> None:
        """Decode a pass from the sections of its streams, with table numbers ``rows (contexts,)``.

        The kernel is called with the words of all streams, the end of each stream's words, the
        states, all tables, `rows`, the raw bits of all streams, the read positions ``(2, streams)``
        in words and in bits, which it advances, and `arguments`. It returns 0 or a fault (an index
        into `FAULTS`). It may read up to `LANES` words past the end before it stops. Raises
        TruncatedStream or CorruptStream if the size of a section does not match its symbols, or the
        kernel returns a fault.
        """
        words, bits = [], []
        for data in sections:
            reader = ByteReader(data, self.where)
            words.append(read_words(reader.take(reader.unpack("I")[0]), self.where))
            bits.append(BitReader(reader.rest(), self.where))
        ends = np.cumsum([len(own) + LANES for own in words]) - LANES
        bytes_before = np.cumsum([0, *(len(own.bits) for own in bits[:-1])])
        reached = np.array([[0, *(ends[:-1] + LANES)], 8 * bytes_before])
        begins = reached[1].tolist()
        padded = np.concatenate([part for own in words for part in (own, PADDING)])
        raw = np.concatenate([*(own.bits for own in bits), np.zeros(MORE_BITS, np.uint8)])
        tables = self.tables.spans, self.tables.slots, rows
        fault = kernel(padded, ends, self.states, *tables, raw, reached, *arguments)
        if fault:
            raise CorruptStream(f"{self.where}: {FAULTS[fault]}")
        if np.any(reached[0] != ends):
            more = np.any(reached[0] > ends)
            raise CorruptStream(
                f"{self.where}: {FAULTS[OUT_OF_WORDS] if more else 'words are left'}"
            )
        for own, begin, used in zip(bits, begins, reached[1].tolist(), strict=True):
            own.position = used - begin
            own.close()

    def finish(self) -> None:
        """Check, after the last pass, that the states are the encoder's initial states."""
        check_final(self.states, self.where)

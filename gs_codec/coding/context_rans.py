"""rANS in which every symbol may have a table of its own, chosen by what is decoded already.

The coder is that of `rans`: 32 lanes, 32-bit states, 16-bit words. A pass is a run of symbols
whose tables are all known before its first is decoded; symbol i of a pass is of lane i mod 32.
FORMAT.md, section "Passes".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.fields import BitReader
from gs_codec.coding.frequency_table import FrequencyTable
from gs_codec.coding.rans import LANES, LOWEST, PADDING, check_final, push, read_states, read_words
from gs_codec.errors import CorruptStream
from gs_codec.runtime.kernels import kernel

PRECISION = 12

Symbols = NDArray[np.unsignedinteger]


@dataclass(frozen=True)
class PassTables:
    """Tables of all passes, packed: ``spans (T, A)`` (start << 16 | frequency), ``slots``."""

    spans: NDArray[np.uint32]
    slots: NDArray[np.uint8]  # (T, 2**PRECISION): symbol of each slot

    @classmethod
    def pack(cls, tables: Sequence[FrequencyTable]) -> PassTables:
        """Pack tables of precision `PRECISION`."""
        alphabet = max((t.frequencies.size for t in tables), default=1)
        spans = np.zeros((len(tables), alphabet), np.uint32)
        slots = np.zeros((len(tables), 1 << PRECISION), np.uint8)
        for span, slot, table in zip(spans, slots, tables, strict=True):
            _pack(table.frequencies, span, slot)
        return cls(spans, slots)


@kernel
def _pack(frequencies, spans, slots):
    start = 0
    for symbol in range(len(frequencies)):
        frequency = np.int64(frequencies[symbol])
        spans[symbol] = (start << 16) | frequency
        slots[start : start + frequency] = symbol
        start += frequency


@kernel
def _push_all(symbols, contexts, rows, spans, states, words, position):
    """Code a pass backwards, words before `position`; returns where they begin."""
    for i in range(len(symbols) - 1, -1, -1):
        span = np.int64(spans[rows[contexts[i]], symbols[i]])
        position = push(words, position, states, i & (LANES - 1), span, PRECISION)
    return position


def encode_passes(
    passes: Sequence[tuple[str, Symbols, Symbols, NDArray[np.int64]]], tables: PassTables
) -> tuple[bytes, dict[str, bytes]]:
    """Code the passes of a block; returns the initial states, and the words of each section.

    Passes are (section, symbols, contexts, rows), in the order they are decoded. The tables of
    ``symbols (n,)`` are ``rows[contexts]``.
    """
    states = np.full(LANES, LOWEST, np.int64)
    words = np.empty(1 + sum(len(symbols) for _, symbols, *_ in passes), np.uint16)
    position = words.size
    begins: dict[str, int] = {}
    for section, *coded_by in reversed(passes):
        position = _push_all(*coded_by, tables.spans, states, words, position)
        begins[section] = position
    words = words.astype("<u2")
    coded, end = {}, words.size
    for section, begin in begins.items():
        coded[section] = words[begin:end].tobytes()
        end = begin
    return states.astype("<u4").tobytes(), coded


class PassReader:
    """Decodes the passes of a block, section by section."""

    def __init__(self, states: memoryview, tables: PassTables, where: str) -> None:
        self.states = read_states(states, LANES, where)
        self.tables = tables
        self.where = where
        self.words = PADDING
        self.end = self.position = 0

    def open(self, data: memoryview) -> None:
        """Continue with the words of the next section."""
        words = read_words(data, self.where)
        self.words = np.concatenate([words, PADDING])
        self.end, self.position = len(words), 0

    def decode(
        self, kernel: Callable, rows: NDArray[np.int64], bits: BitReader, *arguments: Any
    ) -> list[Any]:
        """Decode a pass, by tables ``rows (contexts,)``; returns what else the kernel returns.

        The kernel is called with the words and where they begin and end, the states, all tables,
        `rows`, the raw bits and where they begin, and `arguments`. It returns the positions that it
        has reached in words, -1 if they end too early, and in bits.

        Raises
        ------
        CorruptStream
            If there are fewer words than symbols.
        """
        position, bits.position, *found = kernel(
            self.words, self.position, self.end, self.states, self.tables.spans, self.tables.slots,
            rows, bits.bits, bits.position, *arguments,
        )  # fmt: skip
        if not 0 <= position <= self.end:
            raise CorruptStream(f"{self.where}: more symbols than words")
        self.position = position
        return found

    def close(self) -> None:
        """Check that the section's words are all read."""
        if self.position != self.end:
            raise CorruptStream(f"{self.where}: {self.end - self.position} words are left")

    def finish(self) -> None:
        """Check, after the last section, that the states are those the encoder began with."""
        check_final(self.states, self.where)

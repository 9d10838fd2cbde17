"""rANS in which every symbol may have a table of its own, chosen by what is decoded already.

The coder is that of `rans`: 32 lanes, 32-bit states, 16-bit words. A pass is a run of symbols
whose tables are all known before its first is decoded; symbol i of a pass is of lane i mod 32.
FORMAT.md, section "Passes".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.frequency_table import FrequencyTable
from gs_codec.coding.rans import LANES, LOWEST, push
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
            size = table.frequencies.size
            span[:size] = (table.starts << np.uint32(16)) | table.frequencies
            slot[:] = np.repeat(np.arange(size, dtype=np.uint8), table.frequencies)
        return cls(spans, slots)


@kernel
def _push_all(symbols, contexts, rows, spans, states, words, position):
    """Code a pass backwards, words before `position`; returns where they begin."""
    for i in range(len(symbols) - 1, -1, -1):
        span = np.int64(spans[rows[contexts[i]], symbols[i]])
        position = push(words, position, states, i & (LANES - 1), span, PRECISION)
    return position


@dataclass
class PassWriter:
    """Collects the passes of a block, section by section, in the order they are decoded."""

    tables: PassTables
    passes: list[tuple[str, Symbols, Symbols, NDArray[np.int64]]] = field(default_factory=list)

    def add(
        self, section: str, symbols: Symbols, contexts: Symbols, rows: NDArray[np.int64]
    ) -> None:
        """Add a pass of ``symbols (n,)`` under the tables ``rows[contexts]``."""
        self.passes.append((section, symbols, contexts, rows))

    def finish(self) -> tuple[bytes, dict[str, bytes]]:
        """The initial states, and the words of each section."""
        states = np.full(LANES, LOWEST, np.int64)
        words = np.empty(1 + sum(len(symbols) for _, symbols, *_ in self.passes), np.uint16)
        position = words.size
        begins: dict[str, int] = {}
        for section, *coded_by in reversed(self.passes):
            position = _push_all(*coded_by, self.tables.spans, states, words, position)
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
        if len(states) != 4 * LANES:
            raise CorruptStream(f"{where}: {len(states)} bytes of states, expected {4 * LANES}")
        self.states = np.frombuffer(states, "<u4").astype(np.int64)
        if np.any(self.states < LOWEST):
            raise CorruptStream(f"{where}: a rANS state below {LOWEST}")
        self.tables = tables
        self.where = where
        self.words = np.zeros(LANES, np.uint16)
        self.end = self.position = 0

    def open(self, data: memoryview) -> None:
        """Continue with the words of the next section."""
        if len(data) % 2:
            raise CorruptStream(f"{self.where}: an odd number of bytes, expected 16-bit words")
        self.end, self.position = len(data) // 2, 0
        self.words = np.zeros(self.end + LANES, np.uint16)
        self.words[: self.end] = np.frombuffer(data, "<u2")

    def advance(self, position: int) -> None:
        """Set the position that a kernel has reached; -1 or beyond the end is corrupt."""
        if not 0 <= position <= self.end:
            raise CorruptStream(f"{self.where}: more symbols than words")
        self.position = position

    def close(self) -> None:
        """Check that the section's words are all read."""
        if self.position != self.end:
            raise CorruptStream(f"{self.where}: {self.end - self.position} words are left")

    def finish(self) -> None:
        """Check, after the last section, that the states are those the encoder began with."""
        if np.any(self.states != LOWEST):
            raise CorruptStream(f"{self.where}: the rANS states do not end where they must")

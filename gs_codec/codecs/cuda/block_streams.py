"""Locate the streams of all blocks in a file, and check that they were consumed exactly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.binary import check_end
from gs_codec.coding.context_rans import FAULTS
from gs_codec.coding.rans import LANES, LOWEST, read_states
from gs_codec.egs.egs_file import EgsFile, SectionId
from gs_codec.errors import CorruptStream, TruncatedStream

#: Upper bound for the bytes of a block's stream: a symbol takes fewer than 6.
_LONG = 1 << 27

#: Bytes after the file that kernels may read before they stop.
PADDING = 512


def _places(file: EgsFile, section: SectionId) -> NDArray[np.int64]:
    """Start and end of a section of each block in the file, ``(blocks, 2)``."""
    entries = [file.table[section, block] for block in range(file.header.block_count)]
    return np.array([(entry.position, entry.position + entry.size) for entry in entries])


@dataclass(frozen=True)
class Streams:
    """Words and raw bits of the streams of all blocks, located in the file.

    ``begins`` and ``ends (blocks, streams, 2)`` are offsets of the words, in words, and of the raw
    bits, in bits. ``low_bits (blocks, 2)`` are start and end in bits, ``trees (blocks, 2)`` in
    bytes. ``states (blocks, LANES)`` are the initial states.
    """

    data: NDArray[np.uint8]
    begins: NDArray[np.int64]
    ends: NDArray[np.int64]
    low_bits: NDArray[np.int64]
    trees: NDArray[np.int64]
    states: NDArray[np.int64]

    @classmethod
    def of(cls, file: EgsFile, streams: Sequence[str], data: NDArray[np.uint8]) -> Streams:
        """Locate the streams of a file; fill ``data``, `PADDING` longer, with its checked sections.

        Raises TruncatedStream or CorruptStream.
        """
        data[:] = 0
        for key, content in file.sections.items():
            position = file.table[key].position
            data[position : position + len(content)] = np.frombuffer(content, np.uint8)
        places = [_places(file, SectionId.of_stream(stream)) for stream in streams]
        first, last = np.stack(places, axis=1).transpose(2, 0, 1)
        if np.any(last - first < 4):
            raise TruncatedStream("a section of a block: no size of its words")
        size = data.view("<u4")[first // 4].astype(np.int64)
        if np.any(size > last - first - 4):
            raise TruncatedStream("a section of a block: more words than bytes")
        if np.any(size % 2):
            raise CorruptStream("a section of a block: an odd number of bytes of words")
        begins = np.stack([(first + 4) // 2, 8 * (first + 4 + size)], axis=2)
        ends = np.stack([(first + 4 + size) // 2, 8 * last], axis=2)
        if np.any(last - first >= _LONG):
            raise CorruptStream(f"a section of a block: {_LONG} bytes or more")
        states = [
            read_states(file.section(SectionId.STATES, block), LANES, f"block {block}")
            for block in range(file.header.block_count)
        ]
        low_bits = 8 * _places(file, SectionId.LOW_BITS)
        trees = _places(file, SectionId.GEOMETRY)
        return cls(data, begins, ends, low_bits, trees, np.array(states))

    @property
    def reached(self) -> NDArray[np.int64]:
        """Initial read positions of the kernels in each stream, ``(blocks, streams, 4)``.

        The four are: words read; bits read, counted from a multiple of 32; symbols read; and
        Gaussians that have symbols in the next step.
        """
        reached = np.zeros((*self.begins.shape[:2], 4), np.int64)
        reached[..., 1] = self.begins[..., 1] & 31
        return reached

    def check(
        self,
        reached: NDArray[np.int64],
        low_bits: NDArray[np.int64],
        states: NDArray[np.int64],
        faults: NDArray[np.int64],
        coders: NDArray[np.int64],
    ) -> None:
        """Check the kernels' end positions, final states and faults. Raises CorruptStream."""
        for block, (place, coder) in enumerate(zip(self.trees, coders.tolist(), strict=True)):
            low, high, _, position, _ = coder
            check_end(low, high, position, int(place[1] - place[0]), f"geometry of block {block}")
        for block, fault in np.argwhere(faults):
            raise CorruptStream(f"block {block}: {FAULTS[faults[block, fault]]}")
        words = self.begins[..., 0] + reached[..., 0]
        ends = np.argwhere(words != self.ends[..., 0])
        for block, stream in ends:
            raise CorruptStream(f"block {block}: stream {stream} does not end where its words do")
        bits = (self.begins[..., 1] & -32) + reached[..., 1]
        used = np.concatenate([bits, low_bits[:, None]], axis=1)
        ends = np.concatenate([self.ends[..., 1], self.low_bits[:, 1:]], axis=1)
        if np.any((used + 7) // 8 != ends // 8):
            [block, _] = np.argwhere((used + 7) // 8 != ends // 8)[0]
            raise CorruptStream(f"block {block}: too many or too few raw bytes")
        padding = np.where(used % 8 > 0, 0xFF >> (used % 8), 0)
        if np.any(self.data[np.maximum(ends // 8 - 1, 0)] & padding):
            raise CorruptStream("a section of a block: padding bits that are not 0")
        if np.any(states != LOWEST):
            [block, _] = np.argwhere(states != LOWEST)[0]
            raise CorruptStream(f"block {block}: the rANS states do not end where they must")

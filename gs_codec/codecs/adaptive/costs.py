"""What each Gaussian of profiles ``l``, ``m`` and ``s`` takes: the information of its symbols."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.colour import code_colours
from gs_codec.codecs.adaptive.contexts import FOLLOWING
from gs_codec.codecs.adaptive.decode import Blocks, Streams
from gs_codec.codecs.adaptive.following import following_contexts
from gs_codec.codecs.adaptive.sh_ac import BandSums, code_coefficient
from gs_codec.codecs.adaptive.tokens import raw_width, token_of
from gs_codec.coding.context_rans import PRECISION
from gs_codec.coding.nearest import Nearest
from gs_codec.egs.file import EgsFile
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.threads import run_all


@kernel
def _add(spans, rows, contexts, indices, values, costs):
    """Add the bits of ``values[indices]``: of their tokens by the tables, and raw ones."""
    for i in range(len(contexts)):
        index = indices[i]
        token = token_of(np.int64(values[index]))
        frequency = np.int64(spans[rows[contexts[i]], token]) & 0xFFFF
        costs[index] += PRECISION - np.log2(frequency) + raw_width(token)


def symbol_bits(file: EgsFile) -> NDArray[np.float64]:
    """Bits of the symbols of each Gaussian ``(N,)``, without those of positions.

    Raises
    ------
    CorruptStream, TruncatedStream
    """
    blocks = _CostedBlocks(file, file.header.sh_degree, file.header.count)
    numbers = range(file.header.block_count)
    spans = [slice(*file.header.block_range(number)) for number in numbers]
    run_all(lambda number: blocks.decode(number, spans[number]), numbers)
    return blocks.costs


class _CostedBlocks(Blocks):
    """Decodes blocks, and adds up the bits of each Gaussian in `costs`."""

    def __init__(self, file: EgsFile, degree: int, count: int) -> None:
        super().__init__(file, degree, count)
        self.costs = np.zeros(count)

    def streams(self, block: int, span: slice) -> Streams:
        return _CostedStreams(self, block, self.costs[span])


class _CostedStreams(Streams):
    """Reads the passes of a block, and adds the bits of each Gaussian to `costs`."""

    def __init__(self, blocks: Blocks, block: int, costs: NDArray[np.float64]) -> None:
        super().__init__(blocks, block)
        self.spans, self.costs = blocks.tables.spans, costs
        self.rows = np.zeros(0, np.int64)

    def next_tables(self) -> NDArray[np.int64]:
        self.rows = super().next_tables()
        return self.rows

    def read_into(
        self,
        contexts: NDArray[np.integer],
        indices: NDArray[np.int64],
        values: NDArray[np.integer],
    ) -> None:
        super().read_into(contexts, indices, values)
        _add(self.spans, self.rows, contexts, indices, values, self.costs)

    # Coding what was decoded gives its contexts once more.

    def read_following(
        self, name: str, bases: NDArray[np.int64], steps: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        levels = super().read_following(name, bases, steps)
        contexts = following_contexts(levels * steps, bases, FOLLOWING[name])
        _add(self.spans, self.rows, contexts, np.arange(len(levels)), levels, self.costs)
        return levels

    def read_colours(
        self, nearest: Nearest, unit: int, shifts: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        values = super().read_colours(nearest, unit, shifts)
        levels, contexts, _ = code_colours(nearest, values, unit, shifts)
        every = np.arange(len(shifts))
        for level, context in zip(levels.T, contexts.T, strict=True):
            _add(self.spans, self.rows, context.copy(), every, level.copy(), self.costs)
        return values

    def read_coefficient(self, sums: BandSums, last: bool, levels: NDArray[np.int32]) -> None:
        before = sums.copy()
        indices = sums.live[: sums.count].copy()
        super().read_coefficient(sums, last, levels)
        coded, contexts = code_coefficient(levels, before, last)
        values = np.zeros(len(levels), np.int64)
        values[indices] = coded
        _add(self.spans, self.rows, contexts, indices, values, self.costs)

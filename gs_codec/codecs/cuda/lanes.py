"""Shared by device kernels: rANS lanes, and products rounded separately.

A warp decodes a block, one thread per lane. In numba's simulator, where threads are slow, one
thread processes all lanes. So kernels keep the state of lanes in arrays of `OWN` items, and loop
over these.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import config, cuda
from numpy.typing import NDArray

from gs_codec.coding.context_rans import PRECISION, RUN_BITS, SPAN_BITS, PassTables
from gs_codec.coding.rans import LANES
from gs_codec.runtime.kernel_cache import kept

#: Whether kernels run in numba's simulator.
SIMULATED = bool(config.ENABLE_CUDASIM)

#: Threads per block of Gaussians, and lanes per thread.
WIDTH = 1 if SIMULATED else LANES
OWN = LANES // WIDTH

_ALL = 0xFFFFFFFF

if SIMULATED:
    launched = cuda.jit

    def device(function):
        """Mark a function that kernels call."""
        return function

    def settle():
        """Make writes visible to all lanes."""

    def meet():
        """Make writes visible to all threads of a block."""

    def ballot(flags):
        """Mask of the lanes whose flag is not 0."""
        return sum(1 << lane for lane in range(LANES) if flags[lane])

    def ones(mask):
        """Number of lanes in a mask."""
        return np.int32(bin(mask).count("1"))

    def bit_length(value):
        """Number of bits of an integer from 0 to 2**31 - 1."""
        return np.int32(int(value).bit_length())

    def value_of(values, lane):
        """The value of a lane."""
        return np.int32(values[lane])

    def sums_before(values, sums):
        """Fill `sums` with the total of all lanes before each; return the total of all lanes."""
        sums[:] = np.cumsum(values) - values
        return np.int32(np.sum(values))

    def rounded(first, second):
        """A product rounded before any addition."""
        return first * second

else:
    from numba.cuda import libdevice
    from numba.cuda.dispatcher import CUDACache

    device = cuda.jit(device=True)

    def launched(function: Callable) -> Any:
        """Compile a kernel, which takes seconds, or load it from disk if possible."""
        compiled: Any = cuda.jit(function)
        compiled._cache = kept(CUDACache, function, lambda target: target)
        return compiled

    @device
    def settle():
        """Make writes visible to all lanes."""
        cuda.syncwarp()

    @device
    def meet():
        """Make writes visible to all threads of a block."""
        cuda.syncthreads()

    @device
    def ballot(flags):
        """Mask of the lanes whose flag is not 0."""
        return np.int64(cuda.ballot_sync(_ALL, flags[0] != 0)) & _ALL

    @device
    def ones(mask):
        """Number of lanes in a mask."""
        return np.int32(cuda.popc(np.uint32(mask)))

    @device
    def bit_length(value):
        """Number of bits of an integer from 0 to 2**31 - 1."""
        return 32 - np.int32(cuda.clz(np.int32(value)))

    @device
    def value_of(values, lane):
        """The value of a lane."""
        return np.int32(cuda.shfl_sync(_ALL, values[0], lane))

    @device
    def sums_before(values, sums):
        """Fill `sums` with the total of all lanes before each; return the total of all lanes."""
        lane = cuda.threadIdx.x
        total = np.int32(values[0])
        for turn in range(5):
            other = np.int32(cuda.shfl_up_sync(_ALL, total, 1 << turn))
            total = np.int32(total + (other if lane >= 1 << turn else 0))
        sums[0] = total - values[0]
        return np.int32(cuda.shfl_sync(_ALL, total, LANES - 1))

    @device
    def rounded(first, second):
        """A product rounded before any addition, which prevents fused multiply-add."""
        return libdevice.dmul_rn(first, second)


@device
def lanes_before(mask, lane):
    """Number of lanes in a mask before `lane`."""
    return ones(mask & ((np.int64(1) << lane) - 1))


def pack_tables(tables: PassTables) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Tables that find a token in two steps, because all lanes wait for the slowest.

    Tokens that occur are ranked. The first array has an entry for every ``2**RUN_BITS`` slots: the
    rank of the token of the first slot (8 bits), and marks of the slots where further tokens start.
    The second has the token, start and frequency minus 1 of each rank (8, 12, 12 bits).
    """
    spans = tables.spans.reshape(-1, 1 << SPAN_BITS)
    rows, tokens = np.nonzero(spans & 0xFFFF)
    starts, frequencies = spans[rows, tokens] >> np.uint32(16), spans[rows, tokens] & 0xFFFF
    counts = np.bincount(rows, minlength=len(spans))
    ranked = np.zeros_like(spans)
    ranks = np.arange(len(rows)) - np.repeat(np.cumsum(counts) - counts, counts)
    ranked[rows, ranks] = tokens.astype(np.uint32) | starts << 8 | (frequencies - 1) << 20
    shape = len(spans), 1 << (PRECISION - RUN_BITS)
    of_run = rows * shape[1] + (starts >> RUN_BITS)
    bits = np.ldexp(1.0, (starts & ((1 << RUN_BITS) - 1)).astype(np.int32))
    begun, marks = (
        np.bincount(of_run, weights, shape[0] * shape[1]).astype(np.int64).reshape(shape)
        for weights in (None, bits)
    )
    first = np.cumsum(begun, axis=1) - (begun - (marks & 1)) - 1
    return (first | (marks & ~1) << 8).astype(np.uint32).ravel(), ranked.ravel()


# 32-bit integers where they suffice, which are native on a device: numba computes in 64 bits unless
# each result is converted. Only signed ones are mixed.


@device
def part_of(begins, ends, reached, block, stream):
    """Read position and ends of a block's words and raw bits in a stream.

    Raw bits are counted from item ``raw_at`` of the array, 32 bits per item.
    """
    words_at, raw_at = begins[block, stream, 0], begins[block, stream, 1] >> 5
    end = np.int32(ends[block, stream, 0] - words_at)
    limit = np.int32(ends[block, stream, 1] - (raw_at << 5))
    position, used = np.int32(reached[block, stream, 0]), np.int32(reached[block, stream, 1])
    return words_at, raw_at, end, limit, position, used


@device
def pull(runs, spans, row, state):
    """Decode a token with a table; return it and the state, which needs a word if it is low."""
    wide = np.int64(state)
    slot = np.int32(wide & ((1 << PRECISION) - 1))
    at = np.int32((row << (PRECISION - RUN_BITS)) + (slot >> RUN_BITS))
    run = np.int64(runs[np.uint64(at)])
    rank = np.int32((run & 255) + ones((run >> 8) & ((2 << (slot & ((1 << RUN_BITS) - 1))) - 1)))
    span = np.int64(spans[np.uint64(np.int32((row << SPAN_BITS) + rank))])
    place = np.int32(slot - ((span >> 8) & 4095))
    after = ((span >> 20) + 1) * (wide >> PRECISION) + place
    return np.int32(span & 255), np.uint32(after)


@device
def completed(after, lacks, words, at):
    """The state, with the missing word appended if it needs one."""
    if lacks:
        return np.uint32(np.int64(after) << 16 | np.int64(words[np.uint64(at)]))
    return after


@device
def raw_width(token):
    """Number of raw bits that follow a token."""
    return np.int32((((token >> 1) - 16) >> 2) + 2 if token >= 32 else 0)


@device
def integer_of(token, raw, begin, used, width):
    """The integer of a token and its raw bits, `width` bits from bit `used` on.

    Bits are counted from item `begin` of ``raw``, 32 per item, most significant first.
    """
    size = np.int32(token >> 1)
    if width > 0:
        at = begin + (used >> 5)
        window = np.int64(raw[np.uint64(at)]) << 32 | np.int64(raw[np.uint64(at + 1)])
        rest = np.int32((window >> (64 - (used & 31) - width)) & ((1 << width) - 1))
        size = np.int32(((4 + ((size - 16) & 3)) << width) | rest)
    return np.int32(-size if token & 1 else size)

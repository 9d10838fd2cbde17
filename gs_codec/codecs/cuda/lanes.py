"""What kernels on a device share: lanes of rANS, and products that are rounded.

A warp decodes a block: a thread for each lane. In numba's simulator, where threads are slow, one
thread goes through all lanes; so kernels keep what a lane has in arrays of `OWN` items, and go
through these.
"""

from __future__ import annotations

import numpy as np
from numba import config, cuda

from gs_codec.coding.context_rans import PRECISION, RUN_BITS, SPAN_BITS, PassTables
from gs_codec.coding.rans import LANES

#: Whether kernels run in numba's simulator.
SIMULATED = bool(config.ENABLE_CUDASIM)

#: Threads of a block of Gaussians, and lanes that each has.
WIDTH = 1 if SIMULATED else LANES
OWN = LANES // WIDTH

_ALL = 0xFFFFFFFF

if SIMULATED:

    def device(function):
        """A function that kernels call."""
        return function

    def settle():
        """Let all lanes see what each has written."""

    def ballot(flags):
        """Mask of the lanes whose flag is not 0."""
        return sum(1 << lane for lane in range(LANES) if flags[lane])

    def ones(mask):
        """Number of lanes in a mask."""
        return bin(mask).count("1")

    def bit_length(value):
        """Bits of a number that is not negative."""
        return int(value).bit_length()

    def value_of(values, lane):
        """What a lane has."""
        return np.int64(values[lane])

    def sums_before(values, sums):
        """Fill `sums` with what the lanes before each have in total; returns that of all."""
        total = 0
        for lane in range(LANES):
            sums[lane] = total
            total += np.int64(values[lane])
        return total

    def rounded(first, second):
        """A product that is rounded before it is added to anything."""
        return first * second

else:
    from numba.cuda import libdevice

    device = cuda.jit(device=True)

    @device
    def settle():
        """Let all lanes see what each has written."""
        cuda.syncwarp()

    @device
    def ballot(flags):
        """Mask of the lanes whose flag is not 0."""
        return np.int64(cuda.ballot_sync(_ALL, flags[0] != 0)) & _ALL

    @device
    def ones(mask):
        """Number of lanes in a mask."""
        return np.int64(cuda.popc(mask))

    @device
    def bit_length(value):
        """Bits of a number that is not negative."""
        return 64 - np.int64(cuda.clz(np.int64(value)))

    @device
    def value_of(values, lane):
        """What a lane has."""
        return np.int64(cuda.shfl_sync(_ALL, values[0], lane))

    @device
    def sums_before(values, sums):
        """Fill `sums` with what the lanes before each have in total; returns that of all."""
        lane = cuda.threadIdx.x
        total = values[0]
        step = 1
        while step < LANES:
            other = cuda.shfl_up_sync(_ALL, total, step)
            if lane >= step:
                total += other
            step *= 2
        sums[0] = total - values[0]
        return np.int64(cuda.shfl_sync(_ALL, total, LANES - 1))

    @device
    def rounded(first, second):
        """A product that is rounded before it is added to anything: never a fused operation."""
        return libdevice.dmul_rn(first, second)


@device
def lanes_before(mask, lane):
    """Number of lanes in a mask that come before a lane."""
    return ones(mask & ((1 << lane) - 1))


def pack_entries(tables: PassTables) -> np.ndarray:
    """Of every ``2**RUN_BITS`` slots the first token, and its start and frequency less 1, int32."""
    size = 1 << (PRECISION - RUN_BITS)
    tokens = tables.slots.astype(np.uint32)
    rows = np.repeat(np.arange(len(tokens) // size), size)
    spans = tables.spans[(rows << SPAN_BITS) + tokens]
    entries = tokens | (spans >> np.uint32(16)) << np.uint32(8)
    return (entries | ((spans & np.uint32(0xFFFF)) - np.uint32(1)) << np.uint32(20)).view(np.int32)


@device
def pull(entries, spans, row, state):
    """Decode a token under a table; returns it and the state, which lacks a word if it is low."""
    slot = state & ((1 << PRECISION) - 1)
    entry = np.int64(entries[np.uint64((row << (PRECISION - RUN_BITS)) + (slot >> RUN_BITS))])
    token, place, frequency = entry & 255, slot - ((entry >> 8) & 4095), ((entry >> 20) & 4095) + 1
    while place >= frequency:
        token += 1
        span = np.int64(spans[np.uint64((row << SPAN_BITS) + token)])
        place, frequency = slot - (span >> 16), span & 0xFFFF
    return token, frequency * (state >> PRECISION) + place


@device
def raw_width(token):
    """Number of raw bits that complete a token."""
    size = token >> 1
    return 0 if size < 16 else ((size - 16) >> 2) + 2


@device
def integer_of(token, raw, used, width):
    """The integer of a token and its raw bits, `width` from bit `used` on."""
    size = token >> 1
    if width > 0:
        at = used >> 3
        window = np.int64(raw[np.uint64(at)]) << 32 | np.int64(raw[np.uint64(at + 1)]) << 24
        window |= np.int64(raw[np.uint64(at + 2)]) << 16 | np.int64(raw[np.uint64(at + 3)]) << 8
        window |= np.int64(raw[np.uint64(at + 4)])
        rest = (window >> (40 - (used & 7) - width)) & ((1 << width) - 1)
        size = ((4 + ((size - 16) & 3)) << width) | rest
    return -size if token & 1 else size

"""What kernels on a device share: lanes of rANS, and products that are rounded.

A warp decodes a block: a thread for each lane. In numba's simulator, where threads are slow, one
thread goes through all lanes; so kernels keep what a lane has in arrays of `OWN` items, and go
through these.
"""

from __future__ import annotations

import numpy as np
from numba import config, cuda

from gs_codec.coding.context_rans import PRECISION, RUN_BITS, SPAN_BITS
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
        """Mask of the lanes whose flag is set."""
        return sum(1 << lane for lane in range(LANES) if flags[lane])

    def ones(mask):
        """Number of lanes in a mask."""
        return bin(mask).count("1")

    def sums_before(values, sums):
        """Fill `sums` with what the lanes before each have in total; returns that of all."""
        total = 0
        for lane in range(LANES):
            sums[lane] = total
            total += values[lane]
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
        """Mask of the lanes whose flag is set."""
        return np.int64(cuda.ballot_sync(_ALL, flags[0] != 0)) & _ALL

    @device
    def ones(mask):
        """Number of lanes in a mask."""
        return np.int64(cuda.popc(mask))

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
        return cuda.shfl_sync(_ALL, total, LANES - 1)

    @device
    def rounded(first, second):
        """A product that is rounded before it is added to anything: never a fused operation."""
        return libdevice.dmul_rn(first, second)


@device
def lanes_before(mask, lane):
    """Number of lanes in a mask that come before a lane."""
    return ones(mask & ((1 << lane) - 1))


@device
def pull(spans, slots, row, state):
    """Decode a token under a table; returns it and the state, which lacks a word if it is low."""
    slot = state & ((1 << PRECISION) - 1)
    token = np.int64(slots[(row << (PRECISION - RUN_BITS)) + (slot >> RUN_BITS)])
    span = np.int64(spans[(row << SPAN_BITS) + token])
    while slot - (span >> 16) >= span & 0xFFFF:
        token += 1
        span = np.int64(spans[(row << SPAN_BITS) + token])
    return token, (span & 0xFFFF) * (state >> PRECISION) + slot - (span >> 16)


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
        window = np.int64(raw[at]) << 32 | np.int64(raw[at + 1]) << 24
        window |= np.int64(raw[at + 2]) << 16 | np.int64(raw[at + 3]) << 8 | np.int64(raw[at + 4])
        rest = (window >> (40 - (used & 7) - width)) & ((1 << width) - 1)
        size = ((4 + ((size - 16) & 3)) << width) | rest
    return -size if token & 1 else size

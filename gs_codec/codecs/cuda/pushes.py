"""rANS of an encoder on a device, a warp for each block: rows of symbols, the last first."""

from __future__ import annotations

import numpy as np
from numba import cuda

from gs_codec.codecs.cuda.lanes import OWN, WIDTH, ballot, launched, ones
from gs_codec.coding.context_rans import PRECISION, SPAN_BITS
from gs_codec.coding.rans import LANES

#: Most streams of a pass.
_STREAMS = 4


@launched
def push_pass(tokens, contexts, rows, spans, cycle, starts, states, words, begins):
    """Code the symbols of a pass; what a block has lies between its ``starts (blocks + 1,)``.

    ``words (streams, symbols)`` of a block end where its symbols do, and begin where ``begins
    (blocks, streams)`` tells then. ``states (blocks, LANES)`` are those after the next pass.
    """
    block, thread = cuda.blockIdx.x, np.int64(cuda.threadIdx.x)
    start, end = starts[block], starts[block + 1]
    count, streams = end - start, begins.shape[1]
    state = cuda.local.array(OWN, np.int64)
    span = cuda.local.array(OWN, np.int64)
    owner = cuda.local.array(OWN, np.int32)
    full = cuda.local.array(OWN, np.int32)
    written = cuda.local.array(_STREAMS, np.int64)
    for stream in range(_STREAMS):
        written[stream] = 0
    for own in range(OWN):
        state[own] = np.int64(states[block, own * WIDTH + thread])
    for base in range((count - 1) & -LANES, -1, -LANES):
        for own in range(OWN):
            i = base + own * WIDTH + thread
            owner[own], span[own] = -1, 0
            if i < count:
                row = np.int64(rows[np.int64(contexts[start + i])])
                span[own] = np.int64(spans[(row << SPAN_BITS) + np.int64(tokens[start + i])])
                frequency = span[own] & 0xFFFF
                if state[own] >= frequency << (32 - PRECISION):
                    owner[own] = cycle[i % len(cycle)]
        for stream in range(streams):
            for own in range(OWN):
                full[own] = np.int32(owner[own] == stream)
            mask = ballot(full)
            for own in range(OWN):
                if full[own]:
                    # Higher lanes come before it.
                    later = ones(mask >> (own * WIDTH + thread + 1))
                    words[stream, end - 1 - written[stream] - later] = state[own] & 0xFFFF
                    state[own] >>= 16
            written[stream] += ones(mask)
        for own in range(OWN):
            if span[own] != 0:
                frequency = span[own] & 0xFFFF
                # Exact: both are below 2**32, so the quotient is not rounded up to an integer.
                quotient = np.int64(np.float64(state[own]) / np.float64(frequency))
                rest = state[own] - quotient * frequency
                state[own] = (quotient << PRECISION) + rest + (span[own] >> 16)
    for own in range(OWN):
        states[block, own * WIDTH + thread] = state[own]
    if thread == 0:
        for stream in range(streams):
            begins[block, stream] = end - written[stream]

"""Sums of magnitudes of SH-AC, and their shares by band, on a device, one warp per block.

FORMAT.md, section "Passes of SH-AC". Lanes decode a row of symbols at once. If the context of a
symbol depends on earlier symbols of the row, its lane guesses those, publishes its result, and
repeats until nothing changes. Lanes become correct one after another; most rows need few rounds.
"""

from __future__ import annotations

import numpy as np
from numba import cuda

from gs_codec.codecs.adaptive.contexts import COLOUR_SHIFTS, SUMS
from gs_codec.codecs.cuda.lanes import (
    OWN,
    WIDTH,
    ballot,
    bit_length,
    completed,
    device,
    integer_of,
    lanes_before,
    launched,
    ones,
    part_of,
    pull,
    raw_width,
    settle,
    sums_before,
    value_of,
)
from gs_codec.coding.context_rans import BAD_SUM, OUT_OF_WORDS
from gs_codec.coding.rans import LANES, LOWEST

#: Number of contexts for the sum of all bands, which come first in the first pass.
OF_SUM = COLOUR_SHIFTS * SUMS

#: Number of contexts for a band's share, which come next unless the band is the last.
OF_SHARE = SUMS


@device
def bucket(total):
    """`contexts.sum_bucket`, computed: table lookups of different entries would be serialised."""
    least = np.int32(bit_length(max(total, 2)) - 1)
    large = np.int32(min(2 * least + ((total >> (least - 1)) & 1), SUMS - 1))
    return np.int32(total) if total < 2 else large


@launched
def read_sums(
    words,
    raw,
    runs,
    spans,
    rows,
    reached,
    begins,
    ends,
    starts,
    states,
    stream,
    shifts,
    left,
    faults,
):
    """Decode the sums of magnitudes of all bands, first in the first band's pass."""
    block, thread = cuda.blockIdx.x, np.int32(cuda.threadIdx.x)
    start, count = starts[block], np.int32(starts[block + 1] - starts[block])
    words_at, raw_at, end, limit, position, used = part_of(begins, ends, reached, block, stream)
    state = cuda.local.array(OWN, np.uint32)
    after = cuda.local.array(OWN, np.uint32)
    tokens = cuda.local.array(OWN, np.int32)
    firsts = cuda.local.array(OWN, np.int32)
    sums = cuda.local.array(OWN, np.int32)
    flags = cuda.local.array(OWN, np.int32)
    widths = cuda.local.array(OWN, np.int32)
    before = cuda.local.array(OWN, np.int32)
    totals = cuda.local.array(OWN, np.int32)
    for own in range(OWN):
        state[own] = states[block, own * WIDTH + thread]
        before[own] = sums[own] = 0
    one = other = fault = np.int32(0)  # the sums of the last two Gaussians
    for base in range(0, count, LANES):
        if position > end or used > limit:
            fault = np.int32(OUT_OF_WORDS)
        if fault != 0:
            break
        for own in range(OWN):
            lane = own * WIDTH + thread
            few = np.int32(0)
            if base + lane < count:
                few = np.int32(min(shifts[start + base + lane], COLOUR_SHIFTS - 1))
            firsts[own] = SUMS * few
            sums[own] = 0
        bits, changed = np.int32(0), True
        while changed:
            for own in range(OWN):
                lane = own * WIDTH + thread
                last, past = value_of(sums, max(lane - 1, 0)), value_of(sums, max(lane - 2, 0))
                last = last if lane > 0 else one
                past = past if lane > 1 else (one if lane > 0 else other)
                totals[own] = min(max(np.int64(last) + np.int64(past), 0), 255)
            for own in range(OWN):
                widths[own] = 0
                if base + own * WIDTH + thread < count:
                    row = np.int32(rows[np.uint64(firsts[own] + bucket(totals[own]))])
                    tokens[own], after[own] = pull(runs, spans, row, state[own])
                    widths[own] = raw_width(tokens[own])
            bits = np.int32(0)
            if ballot(widths) != 0:
                bits = sums_before(widths, before)
            for own in range(OWN):
                flags[own] = 0
                if base + own * WIDTH + thread < count:
                    at = np.int32(used + before[own])
                    value = integer_of(tokens[own], raw, raw_at, at, widths[own])
                    flags[own] = np.int32(value != sums[own])
                    sums[own] = value
            changed = ballot(flags) != 0
        for own in range(OWN):
            lane = own * WIDTH + thread
            if base + lane < count:
                left[start + base + lane] = sums[own]
            flags[own] = np.int32(base + lane < count and sums[own] < 0)
        if ballot(flags) != 0:
            fault = np.int32(BAD_SUM)
        for own in range(OWN):
            lane = own * WIDTH + thread
            flags[own] = np.int32(base + lane < count and np.int64(after[own]) < LOWEST)
        lacking = ballot(flags)
        for own in range(OWN):
            lane = own * WIDTH + thread
            if base + lane < count:
                at = words_at + position + lanes_before(lacking, lane)
                state[own] = completed(after[own], flags[own], words, at)
        position = np.int32(position + ones(lacking))
        used = np.int32(used + bits)
        one, other = value_of(sums, LANES - 1), value_of(sums, LANES - 2)
    for own in range(OWN):
        states[block, own * WIDTH + thread] = state[own]
    if thread == 0:
        reached[block, stream, 0], reached[block, stream, 1] = position, used
        reached[block, stream, 2] = count
        if fault != 0:
            faults[block, stream] = fault


@launched
def read_shares(
    words, raw, runs, spans, rows, reached, begins, ends, starts, states, stream,
    offset, left, shares, live, faults,
):  # fmt: skip
    """Decode a band's shares of the remaining sums; the last band (offset -1) takes all of it.

    ``live`` gets the indices of the Gaussians with a share above 0, in order.
    """
    block, thread = cuda.blockIdx.x, np.int32(cuda.threadIdx.x)
    start, count = starts[block], np.int32(starts[block + 1] - starts[block])
    words_at, raw_at, end, limit, position, used = part_of(begins, ends, reached, block, stream)
    symbol, lives = np.int32(reached[block, stream, 2]), np.int32(0)
    flags = cuda.local.array(OWN, np.int32)
    for base in range(0, count, LANES):
        for own in range(OWN):
            i = base + own * WIDTH + thread
            flags[own] = 0
            if i < count:
                value = np.int32(left[start + i])
                shares[start + i] = value if offset < 0 else 0
                flags[own] = np.int32(value > 0)
        some = ballot(flags)
        for own in range(OWN):
            lane = own * WIDTH + thread
            if flags[own]:
                live[start + lives + lanes_before(some, lane)] = base + lane
        lives = np.int32(lives + ones(some))
    settle()
    state = cuda.local.array(OWN, np.uint32)
    after = cuda.local.array(OWN, np.uint32)
    tokens = cuda.local.array(OWN, np.int32)
    numbers = cuda.local.array(OWN, np.int32)
    widths = cuda.local.array(OWN, np.int32)
    before = cuda.local.array(OWN, np.int32)
    for own in range(OWN):
        state[own] = states[block, own * WIDTH + thread]
        before[own] = 0
    kept = fault = np.int32(0)
    for base in range(symbol & -LANES, symbol + lives if offset >= 0 else 0, LANES):
        if position > end or used > limit:
            fault = np.int32(OUT_OF_WORDS)
        if fault != 0:
            break
        for own in range(OWN):
            j = base + own * WIDTH + thread - symbol
            flags[own] = widths[own] = 0
            numbers[own] = -1
            if j >= 0 and j < lives:
                numbers[own] = live[start + j]
                rest = np.int32(left[start + numbers[own]])
                row = np.int32(rows[np.uint64(offset + bucket(rest))])
                tokens[own], after[own] = pull(runs, spans, row, state[own])
                widths[own] = raw_width(tokens[own])
                flags[own] = np.int32(np.int64(after[own]) < LOWEST)
        lacking = ballot(flags)
        bits = np.int32(0)
        if ballot(widths) != 0:
            bits = sums_before(widths, before)
        for own in range(OWN):
            lane = own * WIDTH + thread
            if numbers[own] < 0:
                flags[own] = 0
                continue
            at = words_at + position + lanes_before(lacking, lane)
            state[own] = completed(after[own], flags[own], words, at)
            at = np.int32(used + before[own])
            value = integer_of(tokens[own], raw, raw_at, at, widths[own])
            rest = np.int32(left[start + numbers[own]])
            if value < 0 or value > rest:
                faults[block, stream] = BAD_SUM
                value = np.int32(0)
            shares[start + numbers[own]] = value
            left[start + numbers[own]] = rest - value
            flags[own] = np.int32(value > 0)
        staying = ballot(flags)
        settle()
        for own in range(OWN):
            lane = own * WIDTH + thread
            if flags[own]:
                live[start + kept + lanes_before(staying, lane)] = numbers[own]
        kept = np.int32(kept + ones(staying))
        position = np.int32(position + ones(lacking))
        used = np.int32(used + bits)
        settle()
    for own in range(OWN):
        states[block, own * WIDTH + thread] = state[own]
    if thread == 0:
        reached[block, stream, 0], reached[block, stream, 1] = position, used
        reached[block, stream, 2] = symbol + lives if offset >= 0 else symbol
        reached[block, stream, 3] = kept if offset >= 0 else lives
        if fault != 0:
            faults[block, stream] = fault

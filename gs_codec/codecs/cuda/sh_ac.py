"""The passes of SH-AC on a device, a warp for each block. FORMAT.md, "Passes of SH-AC".

A symbol's context depends on symbols before it, some of the same row of lanes. All lanes decode by
what they believe of those, tell what they found, and decode again until nothing changes: lanes are
right one after another, and most rows are after a few rounds.
"""

from __future__ import annotations

import numpy as np
from numba import cuda

from gs_codec.codecs.adaptive.contexts import COLOUR_SHIFTS, MEMBERS, SIGNS, SUMS, sum_bucket
from gs_codec.codecs.cuda.lanes import (
    OWN,
    WIDTH,
    ballot,
    integer_of,
    lanes_before,
    ones,
    pull,
    raw_width,
    settle,
    sums_before,
)
from gs_codec.coding.context_rans import BAD_SUM, OUT_OF_WORDS
from gs_codec.coding.rans import LANES, LOWEST

#: Sums that lanes can see: of the last two Gaussians, then those of a row.
_ROW = LANES + 2

_OF_SUM, _OF_SHARE, _OF_COLOUR = COLOUR_SHIFTS * SUMS, SUMS, SUMS * SIGNS * MEMBERS


@cuda.jit
def read_band(
    words, raw, spans, slots, rows, bounds, ends, starts, states, stream,
    ago, shifts, first, last, left, shares, live, marks, levels, faults,
):  # fmt: skip
    """Decode ``levels (k, 3, N)``, 0 before; `left` becomes what is left for further bands.

    ``shares``, ``live`` and ``marks (N,)`` are scratch memory; marks are 0 before.
    """
    block, thread = cuda.blockIdx.x, cuda.threadIdx.x
    start, count = starts[block], starts[block + 1] - starts[block]
    end, limit = ends[block, stream, 0], ends[block, stream, 1]
    position, used = bounds[block, stream, 0], bounds[block, stream, 1]
    sums = cuda.shared.array(_ROW, np.int64)
    fault = cuda.shared.array(1, np.int64)
    state = cuda.local.array(OWN, np.int64)
    after = cuda.local.array(OWN, np.int64)
    tokens = cuda.local.array(OWN, np.int64)
    values = cuda.local.array(OWN, np.int64)
    flags = cuda.local.array(OWN, np.int64)
    widths = cuda.local.array(OWN, np.int64)
    before = cuda.local.array(OWN, np.int64)
    for own in range(OWN):
        state[own] = states[block, own * WIDTH + thread]
        before[own] = 0
    fault[0] = sums[0] = sums[1] = 0
    settle()
    symbol = offset = np.int64(0)

    for base in range(0, count if first else 0, LANES):
        if position > end or used > limit:
            fault[0] = OUT_OF_WORDS
        if fault[0] != 0:
            break
        for own in range(OWN):
            sums[2 + own * WIDTH + thread] = 0
        bits, changed = np.int64(0), True
        while changed:
            settle()
            for own in range(OWN):
                lane = own * WIDTH + thread
                widths[own] = 0
                if base + lane < count:
                    total = max(sums[lane] + sums[lane + 1], 0)
                    shift = min(np.int64(shifts[start + base + lane]), COLOUR_SHIFTS - 1)
                    row = np.int64(rows[SUMS * shift + sum_bucket(total)])
                    tokens[own], after[own] = pull(spans, slots, row, state[own])
                    widths[own] = raw_width(tokens[own])
            bits = np.int64(0)
            if ballot(widths) != 0:
                bits = sums_before(widths, before)
            settle()
            for own in range(OWN):
                lane = own * WIDTH + thread
                flags[own] = 0
                if base + lane < count:
                    value = integer_of(tokens[own], raw, used + before[own], widths[own])
                    flags[own] = np.int64(value != sums[2 + lane])
                    sums[2 + lane] = value
            changed = ballot(flags) != 0
        for own in range(OWN):
            lane = own * WIDTH + thread
            flags[own] = 0
            if base + lane < count:
                left[start + base + lane] = value = sums[2 + lane]
                if value < 0:
                    fault[0] = BAD_SUM
                flags[own] = np.int64(after[own] < LOWEST)
        lacking = ballot(flags)
        for own in range(OWN):
            lane = own * WIDTH + thread
            if base + lane < count:
                if flags[own]:
                    word = np.int64(words[position + lanes_before(lacking, lane)])
                    after[own] = after[own] << 16 | word
                state[own] = after[own]
        position += ones(lacking)
        used += bits
        settle()
        if thread == 0:
            sums[0], sums[1] = sums[LANES], sums[LANES + 1]
        settle()
    if first:
        symbol, offset = np.int64(count), np.int64(_OF_SUM)

    lives = np.int64(0)
    for base in range(0, count, LANES):
        for own in range(OWN):
            i = base + own * WIDTH + thread
            flags[own] = 0
            if i < count:
                value = np.int64(left[start + i])
                shares[start + i] = value if last else 0
                flags[own] = np.int64(value > 0)
        some = ballot(flags)
        for own in range(OWN):
            lane = own * WIDTH + thread
            if flags[own]:
                live[start + lives + lanes_before(some, lane)] = base + lane
        lives += ones(some)
    settle()

    # The band's shares of what is left, then its coefficients.
    members = levels.shape[0]
    for turn in range(1 if last else 0, 1 + 3 * members):
        k, kept = turn, np.int64(0)
        colour, place = (k - 1) // members, (k - 1) % members
        begin = offset if k == 0 else offset + _OF_COLOUR * colour + place
        for base in range(symbol & -LANES, symbol + lives, LANES):
            if position > end or used > limit:
                fault[0] = OUT_OF_WORDS
            if fault[0] != 0:
                break
            changed = True
            while changed:
                settle()
                for own in range(OWN):
                    lane = own * WIDTH + thread
                    j = base + lane - symbol
                    flags[own] = widths[own] = 0
                    if j < 0 or j >= lives:
                        continue
                    i = start + np.int64(live[start + j])
                    sign = np.int64(0)
                    if k == 0:
                        context = sum_bucket(np.int64(left[i]))
                    else:
                        one = np.int64(marks[i - np.int64(ago[i, 0])]) if ago[i, 0] > 0 else 0
                        other = np.int64(marks[i - np.int64(ago[i, 1])]) if ago[i, 1] > 0 else 0
                        if one >> 2 == k:
                            sign += (one & 3) - 1
                        if other >> 2 == k:
                            sign += (other & 3) - 1
                        context = SIGNS * sum_bucket(np.int64(shares[i])) + abs(sign)
                        context *= MEMBERS
                    row = np.int64(rows[begin + context])
                    tokens[own], after[own] = pull(spans, slots, row, state[own])
                    widths[own] = raw_width(tokens[own])
                    values[own] = sign
                settle()
                for own in range(OWN):
                    lane = own * WIDTH + thread
                    j = base + lane - symbol
                    if k == 0 or j < 0 or j >= lives:
                        continue
                    i = start + np.int64(live[start + j])
                    own_sign = np.int64(tokens[own] > 1)
                    if (tokens[own] & 1 != 0) != (values[own] < 0):
                        own_sign = -own_sign
                    mark = 4 * k + 1 + own_sign
                    flags[own] = np.int64(np.int64(marks[i]) != mark)
                    marks[i] = mark
                changed = ballot(flags) != 0
            bits = np.int64(0)
            if ballot(widths) != 0:
                bits = sums_before(widths, before)
            for own in range(OWN):
                lane = own * WIDTH + thread
                j = base + lane - symbol
                flags[own] = np.int64(0 <= j < lives and after[own] < LOWEST)
            lacking = ballot(flags)
            for own in range(OWN):
                lane = own * WIDTH + thread
                j = base + lane - symbol
                if j < 0 or j >= lives:
                    flags[own] = 0
                    continue
                if flags[own]:
                    word = np.int64(words[position + lanes_before(lacking, lane)])
                    after[own] = after[own] << 16 | word
                state[own] = after[own]
                i = start + np.int64(live[start + j])
                value = integer_of(tokens[own], raw, used + before[own], widths[own])
                if k == 0:
                    rest = np.int64(left[i])
                    if value < 0 or value > rest:
                        fault[0] = BAD_SUM
                        value = np.int64(0)
                    shares[i] = value
                    left[i] = rest - value
                    flags[own] = np.int64(value > 0)
                else:
                    rest = np.int64(shares[i])
                    if k == 3 * members:
                        # A sign; anything else is beyond what is left.
                        value = value * rest if abs(value) == 1 else rest + 1
                    rest -= abs(value)
                    if rest < 0:
                        fault[0] = BAD_SUM
                    levels[place, colour, i] = -value if values[own] < 0 else value
                    shares[i] = rest
                    flags[own] = np.int64(rest > 0)
            staying = ballot(flags)
            settle()
            for own in range(OWN):
                lane = own * WIDTH + thread
                values[own] = 0
                if flags[own]:
                    values[own] = live[start + base + lane - symbol]
            settle()
            for own in range(OWN):
                lane = own * WIDTH + thread
                if flags[own]:
                    live[start + kept + lanes_before(staying, lane)] = values[own]
            kept += ones(staying)
            position += ones(lacking)
            used += bits
            settle()
        if fault[0] != 0:
            break
        symbol += lives
        lives = kept
        if k == 0:
            offset += _OF_SHARE
    for own in range(OWN):
        states[block, own * WIDTH + thread] = state[own]
    if thread == 0:
        bounds[block, stream, 0], bounds[block, stream, 1] = position, used
        # Those of the passes before are 0, or this is of no consequence.
        faults[block, stream - 3] = fault[0]

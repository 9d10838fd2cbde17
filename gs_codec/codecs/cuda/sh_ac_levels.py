"""Levels of SH-AC on a device, one warp per block. FORMAT.md, section "Passes of SH-AC".

A row of symbols is decoded as in `sums`: each lane decodes a token for every possible sum of its
neighbours' signs, and selects the right one once those signs are known.
"""

from __future__ import annotations

import numpy as np
from numba import cuda

from gs_codec.codecs.adaptive.contexts import MEMBERS, SIGNS, SUMS
from gs_codec.codecs.cuda.lanes import (
    OWN,
    WIDTH,
    ballot,
    completed,
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
from gs_codec.codecs.cuda.sums import bucket
from gs_codec.coding.context_rans import BAD_SUM, OUT_OF_WORDS
from gs_codec.coding.nearest import WINDOW
from gs_codec.coding.rans import LANES, LOWEST

#: Number of contexts of a colour.
_OF_COLOUR = SUMS * SIGNS * MEMBERS

#: Marks a lane without a Gaussian.
_NONE = -1 - WINDOW

#: A level above any sum.
_LARGEST = (1 << 31) - 1


@launched
def read_levels(
    words, raw, runs, spans, rows, reached, begins, ends, starts, states, stream,
    offset, members, ago, shares, live, marks, levels, faults,
):  # fmt: skip
    """Decode ``levels (members 3 N,)`` of a band, initially 0; overwrites `shares` and `live`.

    ``marks (N,)``, initially 0, record the last coefficient of a Gaussian and its sign: 4 times the
    coefficient's number, from 1 on, plus the sign, plus 1.
    """
    block, thread = cuda.blockIdx.x, np.int32(cuda.threadIdx.x)
    start, total = starts[block], starts[cuda.gridDim.x]
    words_at, raw_at, end, limit, position, used = part_of(begins, ends, reached, block, stream)
    symbol, lives = np.int32(reached[block, stream, 2]), np.int32(reached[block, stream, 3])
    fault = np.int32(0)
    state = cuda.local.array(OWN, np.uint32)
    # State of a lane: its Gaussian (or a negative number), its neighbours, its remaining sum; the
    # same for the next row, prefetched to hide latency.
    numbers = cuda.local.array(OWN, np.int32)
    backs = cuda.local.array(OWN, np.int32)
    rests = cuda.local.array(OWN, np.int32)
    next_numbers = cuda.local.array(OWN, np.int32)
    next_backs = cuda.local.array(OWN, np.int32)
    next_rests = cuda.local.array(OWN, np.int32)
    later = cuda.local.array(OWN, np.int32)
    # Lanes of the two neighbours, or -1; and the sum of the signs of neighbours in earlier rows.
    source0 = cuda.local.array(OWN, np.int32)
    source1 = cuda.local.array(OWN, np.int32)
    known = cuda.local.array(OWN, np.int32)
    # Tokens for each possible sum of the neighbours' signs, and the states after them.
    t0 = cuda.local.array(OWN, np.int32)
    t1 = cuda.local.array(OWN, np.int32)
    t2 = cuda.local.array(OWN, np.int32)
    x0 = cuda.local.array(OWN, np.uint32)
    x1 = cuda.local.array(OWN, np.uint32)
    x2 = cuda.local.array(OWN, np.uint32)
    signs = cuda.local.array(OWN, np.int32)
    sums = cuda.local.array(OWN, np.int32)
    flags = cuda.local.array(OWN, np.int32)
    widths = cuda.local.array(OWN, np.int32)
    before = cuda.local.array(OWN, np.int32)
    for own in range(OWN):
        state[own] = states[block, own * WIDTH + thread]
        before[own] = 0
    for k in range(1, 1 + 3 * members):
        colour, place, kept = (k - 1) // members, (k - 1) % members, np.int32(0)
        begin = np.int32(offset + _OF_COLOUR * colour + place)
        out = (3 * place + colour) * total + start
        for own in range(OWN):
            j = np.int32((symbol & -LANES) + own * WIDTH + thread - symbol)
            next_numbers[own] = live[start + j] if j >= 0 and j < lives else _NONE
            next_backs[own] = next_rests[own] = 0
            if next_numbers[own] >= 0:
                next_backs[own] = ago[start + next_numbers[own]]
                next_rests[own] = shares[start + next_numbers[own]]
            j = np.int32(j + LANES)
            later[own] = live[start + j] if j < lives else _NONE
        for base in range(symbol & -LANES, symbol + lives, LANES):
            if position > end or used > limit:
                fault = np.int32(OUT_OF_WORDS)
            if fault != 0:
                break
            for own in range(OWN):
                numbers[own], backs[own] = next_numbers[own], next_backs[own]
                rests[own], next_numbers[own] = next_rests[own], later[own]
                if next_numbers[own] >= 0:
                    next_backs[own] = ago[start + next_numbers[own]]
                    next_rests[own] = shares[start + next_numbers[own]]
                j = np.int32(base + 2 * LANES + own * WIDTH + thread - symbol)
                later[own] = live[start + j] if j < lives else _NONE
            for own in range(OWN):
                lane = np.int32(own * WIDTH + thread)
                number = numbers[own]
                first = np.int32(number - (backs[own] & 255))
                second = np.int32(number - ((backs[own] >> 8) & 255))
                source0[own] = source1[own] = -1
                for away in range(1, WINDOW + 1):
                    other = value_of(numbers, max(lane - away, 0))
                    inside = lane >= away and other >= 0
                    if inside and other == first:
                        source0[own] = lane - away
                    if inside and other == second:
                        source1[own] = lane - away
                known[own] = sums[own] = signs[own] = widths[own] = 0
                t0[own] = t1[own] = t2[own] = 0
                if number >= 0:
                    one, other = np.int32(marks[start + first]), np.int32(marks[start + second])
                    there = (first < number) & (source0[own] < 0) & (one >> 2 == k)
                    known[own] += ((one & 3) - 1) * np.int32(there)
                    there = (second < number) & (source1[own] < 0) & (other >> 2 == k)
                    known[own] += ((other & 3) - 1) * np.int32(there)
                    context = np.int32(begin + SIGNS * MEMBERS * bucket(rests[own]))
                    row0 = np.int32(rows[np.uint64(context)])
                    row1 = np.int32(rows[np.uint64(context + MEMBERS)])
                    row2 = np.int32(rows[np.uint64(context + 2 * MEMBERS)])
                    t0[own], x0[own] = pull(runs, spans, row0, state[own])
                    t1[own], x1[own] = pull(runs, spans, row1, state[own])
                    t2[own], x2[own] = pull(runs, spans, row2, state[own])
            changed = True
            while changed:
                for own in range(OWN):
                    first = value_of(signs, max(source0[own], 0))
                    second = value_of(signs, max(source1[own], 0))
                    first = first if source0[own] >= 0 else np.int32(0)
                    second = second if source1[own] >= 0 else np.int32(0)
                    sums[own] = np.int32(known[own] + first + second)
                for own in range(OWN):
                    size = abs(sums[own])
                    token = t0[own] if size == 0 else t1[own] if size == 1 else t2[own]
                    sign = np.int32(0 if token < 2 else 1 - 2 * (token & 1))
                    sign = np.int32(-sign if sums[own] < 0 else sign)
                    flags[own] = np.int32(sign != signs[own])
                    signs[own] = sign
                changed = ballot(flags) != 0
            for own in range(OWN):
                flags[own] = 0
                if numbers[own] >= 0:
                    size = abs(sums[own])
                    t0[own] = t0[own] if size == 0 else t1[own] if size == 1 else t2[own]
                    x0[own] = x0[own] if size == 0 else x1[own] if size == 1 else x2[own]
                    flags[own] = np.int32(np.int64(x0[own]) < LOWEST)
                    widths[own] = raw_width(t0[own])
                    marks[start + numbers[own]] = 4 * k + 1 + signs[own]
            lacking = ballot(flags)
            bits = np.int32(0)
            if ballot(widths) != 0:
                bits = sums_before(widths, before)
            for own in range(OWN):
                lane = own * WIDTH + thread
                if numbers[own] >= 0:
                    at = words_at + position + lanes_before(lacking, lane)
                    state[own] = completed(x0[own], flags[own], words, at)
                    at = np.int32(used + before[own])
                    value = integer_of(t0[own], raw, raw_at, at, widths[own])
                    if k == 3 * members:
                        # A sign; any other value exceeds the remaining sum.
                        value = np.int32(value * rests[own] if abs(value) == 1 else _LARGEST)
                    rest = np.int32(rests[own] - abs(value))
                    if rest < 0:
                        faults[block, stream] = BAD_SUM
                        rest = np.int32(0)
                    levels[out + numbers[own]] = -value if sums[own] < 0 else value
                    shares[start + numbers[own]] = rest
                    flags[own] = np.int32(rest > 0)
            staying = ballot(flags)
            for own in range(OWN):
                lane = own * WIDTH + thread
                if flags[own] and numbers[own] >= 0:
                    live[start + kept + lanes_before(staying, lane)] = numbers[own]
            kept = np.int32(kept + ones(staying))
            position = np.int32(position + ones(lacking))
            used = np.int32(used + bits)
            settle()
        symbol = np.int32(symbol + lives)
        lives = kept
    for own in range(OWN):
        states[block, own * WIDTH + thread] = state[own]
    if thread == 0:
        reached[block, stream, 0], reached[block, stream, 1] = position, used
        if fault != 0:
            faults[block, stream] = fault

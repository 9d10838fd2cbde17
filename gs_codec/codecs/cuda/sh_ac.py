"""The passes of SH-AC on a device, a warp for each block. FORMAT.md, "Passes of SH-AC".

Lanes decode a row of symbols at once. Where the context of a symbol depends on symbols before it
in the row, its lane goes by what it believes of those, tells what it found, and tries again until
nothing changes: lanes are right one after another, and most rows after a few rounds.
"""

from __future__ import annotations

import numpy as np
from numba import cuda

from gs_codec.codecs.adaptive.contexts import COLOUR_SHIFTS, MEMBERS, SIGNS, SUMS
from gs_codec.codecs.cuda.lanes import (
    OWN,
    WIDTH,
    ballot,
    bit_length,
    device,
    integer_of,
    lanes_before,
    ones,
    pull,
    raw_width,
    settle,
    sums_before,
    value_of,
)
from gs_codec.coding.context_rans import BAD_SUM, OUT_OF_WORDS
from gs_codec.coding.nearest import WINDOW
from gs_codec.coding.rans import LANES, LOWEST

#: Contexts of a pass: those of the sum of all bands, if it is in it, come first, then those of the
#: band's share, if it is not the last, then those of each colour.
OF_SUM, OF_SHARE, _OF_COLOUR = COLOUR_SHIFTS * SUMS, SUMS, SUMS * SIGNS * MEMBERS


@device
def _bucket(total):
    """As `contexts.sum_bucket`, computed: lanes that differ would wait for one another's entry."""
    least = bit_length(max(total, 2)) - 1
    return total if total < 2 else min(2 * least + ((total >> (least - 1)) & 1), SUMS - 1)


@device
def _completed(after, lacks, words, at):
    """States with the words that they lack."""
    return after << 16 | np.int64(words[np.uint64(at)]) if lacks else after


@cuda.jit
def read_sums(
    words, raw, entries, spans, rows, reached, ends, starts, states, stream, shifts, left, faults
):
    """Decode the sums of magnitudes of all bands, first of the first band's pass."""
    block, thread = cuda.blockIdx.x, cuda.threadIdx.x
    start, count = starts[block], starts[block + 1] - starts[block]
    end, limit = ends[block, stream, 0], ends[block, stream, 1]
    position, used = reached[block, stream, 0], reached[block, stream, 1]
    state = cuda.local.array(OWN, np.int64)
    after = cuda.local.array(OWN, np.int64)
    tokens = cuda.local.array(OWN, np.int64)
    begins = cuda.local.array(OWN, np.int64)
    sums = cuda.local.array(OWN, np.int32)
    flags = cuda.local.array(OWN, np.int32)
    widths = cuda.local.array(OWN, np.int32)
    before = cuda.local.array(OWN, np.int32)
    totals = cuda.local.array(OWN, np.int64)
    for own in range(OWN):
        state[own] = states[block, own * WIDTH + thread]
        before[own] = sums[own] = 0
    one = other = fault = np.int64(0)  # the sums of the last two Gaussians
    for base in range(0, count, LANES):
        if position > end or used > limit:
            fault = np.int64(OUT_OF_WORDS)
        if fault != 0:
            break
        for own in range(OWN):
            lane = own * WIDTH + thread
            few = np.int64(0)
            if base + lane < count:
                few = min(np.int64(shifts[start + base + lane]), COLOUR_SHIFTS - 1)
            begins[own] = SUMS * few
            sums[own] = 0
        bits, changed = np.int64(0), True
        while changed:
            for own in range(OWN):
                lane = own * WIDTH + thread
                last, past = value_of(sums, max(lane - 1, 0)), value_of(sums, max(lane - 2, 0))
                last = last if lane > 0 else one
                past = past if lane > 1 else (one if lane > 0 else other)
                totals[own] = max(last + past, 0)
            for own in range(OWN):
                widths[own] = 0
                if base + own * WIDTH + thread < count:
                    row = np.int64(rows[np.uint64(begins[own] + _bucket(totals[own]))])
                    tokens[own], after[own] = pull(entries, spans, row, state[own])
                    widths[own] = raw_width(tokens[own])
            bits = np.int64(0)
            if ballot(widths) != 0:
                bits = sums_before(widths, before)
            for own in range(OWN):
                flags[own] = 0
                if base + own * WIDTH + thread < count:
                    at = used + np.int64(before[own])
                    value = integer_of(tokens[own], raw, at, np.int64(widths[own]))
                    flags[own] = np.int32(value != np.int64(sums[own]))
                    sums[own] = value
            changed = ballot(flags) != 0
        for own in range(OWN):
            lane = own * WIDTH + thread
            if base + lane < count:
                left[start + base + lane] = sums[own]
            flags[own] = np.int32(base + lane < count and np.int64(sums[own]) < 0)
        if ballot(flags) != 0:
            fault = np.int64(BAD_SUM)
        for own in range(OWN):
            lane = own * WIDTH + thread
            flags[own] = np.int32(base + lane < count and after[own] < LOWEST)
        lacking = ballot(flags)
        for own in range(OWN):
            lane = own * WIDTH + thread
            if base + lane < count:
                at = position + lanes_before(lacking, lane)
                state[own] = _completed(after[own], flags[own], words, at)
        position += ones(lacking)
        used += bits
        one, other = value_of(sums, LANES - 1), value_of(sums, LANES - 2)
    for own in range(OWN):
        states[block, own * WIDTH + thread] = state[own]
    if thread == 0:
        reached[block, stream, 0], reached[block, stream, 1] = position, used
        reached[block, stream, 2] = count
        if fault != 0:
            faults[block, stream] = fault


@cuda.jit
def read_shares(
    words, raw, entries, spans, rows, reached, ends, starts, states, stream,
    offset, left, shares, live, faults,
):  # fmt: skip
    """Decode a band's shares of what is left; those of the last band, of offset -1, are all of it.

    ``live`` gets the numbers of the Gaussians that have some, in order.
    """
    block, thread = cuda.blockIdx.x, cuda.threadIdx.x
    start, count = starts[block], starts[block + 1] - starts[block]
    end, limit = ends[block, stream, 0], ends[block, stream, 1]
    position, used = reached[block, stream, 0], reached[block, stream, 1]
    symbol, lives = reached[block, stream, 2], np.int64(0)
    flags = cuda.local.array(OWN, np.int32)
    for base in range(0, count, LANES):
        for own in range(OWN):
            i = base + own * WIDTH + thread
            flags[own] = 0
            if i < count:
                value = np.int64(left[start + i])
                shares[start + i] = value if offset < 0 else 0
                flags[own] = np.int32(value > 0)
        some = ballot(flags)
        for own in range(OWN):
            lane = own * WIDTH + thread
            if flags[own]:
                live[start + lives + lanes_before(some, lane)] = base + lane
        lives += ones(some)
    settle()
    state = cuda.local.array(OWN, np.int64)
    after = cuda.local.array(OWN, np.int64)
    tokens = cuda.local.array(OWN, np.int64)
    numbers = cuda.local.array(OWN, np.int64)
    widths = cuda.local.array(OWN, np.int32)
    before = cuda.local.array(OWN, np.int32)
    for own in range(OWN):
        state[own] = states[block, own * WIDTH + thread]
        before[own] = 0
    kept = fault = np.int64(0)
    for base in range(symbol & -LANES, symbol + lives if offset >= 0 else 0, LANES):
        if position > end or used > limit:
            fault = np.int64(OUT_OF_WORDS)
        if fault != 0:
            break
        for own in range(OWN):
            j = base + own * WIDTH + thread - symbol
            flags[own] = widths[own] = 0
            numbers[own] = -1
            if j >= 0 and j < lives:
                numbers[own] = live[start + j]
                rest = np.int64(left[start + numbers[own]])
                row = np.int64(rows[np.uint64(offset + _bucket(rest))])
                tokens[own], after[own] = pull(entries, spans, row, state[own])
                widths[own] = raw_width(tokens[own])
                flags[own] = np.int32(after[own] < LOWEST)
        lacking = ballot(flags)
        bits = np.int64(0)
        if ballot(widths) != 0:
            bits = sums_before(widths, before)
        for own in range(OWN):
            lane = own * WIDTH + thread
            if numbers[own] < 0:
                flags[own] = 0
                continue
            at = position + lanes_before(lacking, lane)
            state[own] = _completed(after[own], flags[own], words, at)
            at = used + np.int64(before[own])
            value = integer_of(tokens[own], raw, at, np.int64(widths[own]))
            rest = np.int64(left[start + numbers[own]])
            if value < 0 or value > rest:
                faults[block, stream] = BAD_SUM
                value = np.int64(0)
            shares[start + numbers[own]] = value
            left[start + numbers[own]] = rest - value
            flags[own] = np.int32(value > 0)
        staying = ballot(flags)
        settle()
        for own in range(OWN):
            lane = own * WIDTH + thread
            if flags[own]:
                live[start + kept + lanes_before(staying, lane)] = numbers[own]
        kept += ones(staying)
        position += ones(lacking)
        used += bits
        settle()
    for own in range(OWN):
        states[block, own * WIDTH + thread] = state[own]
    if thread == 0:
        reached[block, stream, 0], reached[block, stream, 1] = position, used
        reached[block, stream, 2] = symbol + lives if offset >= 0 else symbol
        reached[block, stream, 3] = kept if offset >= 0 else lives
        if fault != 0:
            faults[block, stream] = fault


@device
def _sign_of(token):
    return np.int64(0) if token < 2 else np.int64(1) - 2 * (token & 1)


@cuda.jit
def read_levels(
    words, raw, entries, spans, rows, reached, ends, starts, states, stream,
    offset, ago, shares, live, marks, levels, faults,
):  # fmt: skip
    """Decode ``levels (k, 3, N)``, 0 before, of a band; `shares` and `live` are used up.

    ``marks (N,)`` tell the last coefficient of a Gaussian and its sign: 4 times its number, from 1
    on, plus the sign plus 1; they are 0 before.
    """
    block, thread = cuda.blockIdx.x, cuda.threadIdx.x
    start = starts[block]
    end, limit = ends[block, stream, 0], ends[block, stream, 1]
    position, used = reached[block, stream, 0], reached[block, stream, 1]
    symbol, lives = reached[block, stream, 2], reached[block, stream, 3]
    members, fault = levels.shape[0], np.int64(0)
    state = cuda.local.array(OWN, np.int64)
    numbers = cuda.local.array(OWN, np.int32)
    rests = cuda.local.array(OWN, np.int64)
    # Lanes of the two neighbours, or -1; and the sum of the signs of those that have none.
    sources = cuda.local.array((OWN, 2), np.int64)
    known = cuda.local.array(OWN, np.int64)
    # Tokens by how large the sum of the neighbours' signs is, and states after them.
    t0 = cuda.local.array(OWN, np.int64)
    t1 = cuda.local.array(OWN, np.int64)
    t2 = cuda.local.array(OWN, np.int64)
    x0 = cuda.local.array(OWN, np.int64)
    x1 = cuda.local.array(OWN, np.int64)
    x2 = cuda.local.array(OWN, np.int64)
    signs = cuda.local.array(OWN, np.int32)
    sums = cuda.local.array(OWN, np.int64)
    flags = cuda.local.array(OWN, np.int32)
    widths = cuda.local.array(OWN, np.int32)
    before = cuda.local.array(OWN, np.int32)
    for own in range(OWN):
        state[own] = states[block, own * WIDTH + thread]
        before[own] = 0
    for k in range(1, 1 + 3 * members):
        colour, place, kept = (k - 1) // members, (k - 1) % members, np.int64(0)
        begin = offset + _OF_COLOUR * colour + place
        for base in range(symbol & -LANES, symbol + lives, LANES):
            if position > end or used > limit:
                fault = np.int64(OUT_OF_WORDS)
            if fault != 0:
                break
            for own in range(OWN):
                j = base + own * WIDTH + thread - symbol
                numbers[own] = -1 - WINDOW
                if j >= 0 and j < lives:
                    numbers[own] = live[start + j]
            for own in range(OWN):
                lane = own * WIDTH + thread
                number = np.int64(numbers[own])
                back = np.int64(0)
                if number >= 0:
                    back = np.int64(ago[start + number])
                first, second = number - (back & 255), number - ((back >> 8) & 255)
                sources[own, 0] = sources[own, 1] = -1
                for apart in range(1, WINDOW + 1):
                    other = value_of(numbers, max(lane - apart, 0))
                    if lane >= apart and other == first and first < number:
                        sources[own, 0] = lane - apart
                    if lane >= apart and other == second and second < number:
                        sources[own, 1] = lane - apart
                known[own] = sums[own] = signs[own] = flags[own] = widths[own] = 0
                t0[own] = t1[own] = t2[own] = 0
                if number >= 0:
                    mark = np.int64(marks[start + first])
                    if first < number and sources[own, 0] < 0 and mark >> 2 == k:
                        known[own] += (mark & 3) - 1
                    mark = np.int64(marks[start + second])
                    if second < number and sources[own, 1] < 0 and mark >> 2 == k:
                        known[own] += (mark & 3) - 1
                    rests[own] = shares[start + number]
                    context = begin + SIGNS * MEMBERS * _bucket(rests[own])
                    row0 = np.int64(rows[np.uint64(context)])
                    row1 = np.int64(rows[np.uint64(context + MEMBERS)])
                    row2 = np.int64(rows[np.uint64(context + 2 * MEMBERS)])
                    t0[own], x0[own] = pull(entries, spans, row0, state[own])
                    t1[own], x1[own] = pull(entries, spans, row1, state[own])
                    t2[own], x2[own] = pull(entries, spans, row2, state[own])
            changed = True
            while changed:
                for own in range(OWN):
                    first = value_of(signs, max(sources[own, 0], 0))
                    second = value_of(signs, max(sources[own, 1], 0))
                    sums[own] = known[own] + (first if sources[own, 0] >= 0 else 0)
                    sums[own] += second if sources[own, 1] >= 0 else 0
                for own in range(OWN):
                    size = abs(sums[own])
                    token = t0[own] if size == 0 else t1[own] if size == 1 else t2[own]
                    sign = _sign_of(token) if sums[own] >= 0 else -_sign_of(token)
                    flags[own] = np.int32(sign != np.int64(signs[own]))
                    signs[own] = sign
                changed = ballot(flags) != 0
            for own in range(OWN):
                flags[own] = 0
                if numbers[own] >= 0:
                    size = abs(sums[own])
                    t0[own] = t0[own] if size == 0 else t1[own] if size == 1 else t2[own]
                    x0[own] = x0[own] if size == 0 else x1[own] if size == 1 else x2[own]
                    flags[own] = np.int32(x0[own] < LOWEST)
                    widths[own] = raw_width(t0[own])
                    marks[start + np.int64(numbers[own])] = 4 * k + 1 + np.int64(signs[own])
            lacking = ballot(flags)
            bits = np.int64(0)
            if ballot(widths) != 0:
                bits = sums_before(widths, before)
            for own in range(OWN):
                lane = own * WIDTH + thread
                number = np.int64(numbers[own])
                if number < 0:
                    flags[own] = 0
                    continue
                at = position + lanes_before(lacking, lane)
                state[own] = _completed(x0[own], flags[own], words, at)
                at = used + np.int64(before[own])
                value = integer_of(t0[own], raw, at, np.int64(widths[own]))
                rest = rests[own]
                if k == 3 * members:
                    # A sign; anything else is beyond what is left.
                    value = value * rest if abs(value) == 1 else rest + 1
                rest -= abs(value)
                if rest < 0:
                    faults[block, stream] = BAD_SUM
                    rest = np.int64(0)
                levels[place, colour, start + number] = -value if sums[own] < 0 else value
                shares[start + number] = rest
                flags[own] = np.int32(rest > 0)
            staying = ballot(flags)
            settle()
            for own in range(OWN):
                lane = own * WIDTH + thread
                if flags[own]:
                    live[start + kept + lanes_before(staying, lane)] = numbers[own]
            kept += ones(staying)
            position += ones(lacking)
            used += bits
            settle()
        symbol += lives
        lives = kept
    for own in range(OWN):
        states[block, own * WIDTH + thread] = state[own]
    if thread == 0:
        reached[block, stream, 0], reached[block, stream, 1] = position, used
        if fault != 0:
            faults[block, stream] = fault

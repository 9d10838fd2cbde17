"""The f_dc pass on a device. FORMAT.md, section "Colours".

While the activity is not known yet, one lane for each channel and each possible activity decodes a
token; then the lane with the right activity has the value.
"""

from __future__ import annotations

import math

import numpy as np
from numba import cuda

from gs_codec.codecs.adaptive.contexts import ACTIVITIES, COLOUR_SHIFTS
from gs_codec.codecs.adaptive.lattice import FIXED_LIMIT
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
)
from gs_codec.coding.context_rans import BAD_VALUE, OUT_OF_WORDS
from gs_codec.coding.nearest import WINDOW
from gs_codec.coding.rans import LANES, LOWEST

_CHANNELS = 3
_USED = _CHANNELS * ACTIVITIES

#: Lanes in use per thread.
_HELD = min(_USED, OWN)


@launched
def read_colours(
    words, raw, runs, spans, rows, reached, begins, ends, starts, states, stream,
    ago, weights, inverses, unit, shifts, values, faults,
):  # fmt: skip
    """Decode fixed-point ``values (3 N,)``, with neighbours from `surround`."""
    block, thread = cuda.blockIdx.x, np.int32(cuda.threadIdx.x)
    start, count = starts[block], np.int32(starts[block + 1] - starts[block])
    words_at, raw_at, end, limit, position, used = part_of(begins, ends, reached, block, stream)
    state = cuda.shared.array(LANES, np.uint32)
    seen = cuda.shared.array((WINDOW, _CHANNELS), np.int32)
    fault = cuda.shared.array(1, np.int32)
    lacks = cuda.local.array(OWN, np.int32)
    widths = cuda.local.array(OWN, np.int32)
    before = cuda.local.array(OWN, np.int32)
    chosen = cuda.local.array(OWN, np.int32)
    tokens = cuda.local.array(OWN, np.int32)
    means = cuda.local.array(OWN, np.int32)
    after = cuda.local.array(OWN, np.uint32)
    channels = cuda.local.array(OWN, np.int32)
    guesses = cuda.local.array(OWN, np.int32)
    where = cuda.local.array(OWN, np.int32)
    out = cuda.local.array(OWN, np.int64)
    for own in range(OWN):
        lane = own * WIDTH + thread
        state[lane] = states[block, lane]
        lacks[own] = widths[own] = before[own] = chosen[own] = 0
        # Lanes without a guess never match.
        channels[own] = min(lane // ACTIVITIES, _CHANNELS - 1)
        guesses[own] = lane % ACTIVITIES if lane < _USED else -1
        where[own] = channels[own]
        out[own] = channels[own] * starts[cuda.gridDim.x] + start
        if lane < WINDOW:
            for channel in range(_CHANNELS):
                seen[lane, channel] = 0
    fault[0] = 0
    settle()
    back, weight, inverse = np.int32(ago[start]), np.int64(weights[start]), inverses[start]
    shift = np.int32(shifts[start])
    for i in range(count):
        if position > end or used > limit:
            fault[0] = OUT_OF_WORDS
        if fault[0] != 0:
            break
        # Prefetch the data of the next Gaussian to hide latency.
        ahead = start + min(i + 1, count - 1)
        next_back, next_weight = np.int32(ago[ahead]), np.int64(weights[ahead])
        next_inverse, next_shift = inverses[ahead], np.int32(shifts[ahead])
        step = np.int64(unit) << shift
        n0, n1 = np.int32(back & 255), np.int32((back >> 8) & 255)
        n2, n3 = np.int32((back >> 16) & 255), np.int32((back >> 24) & 255)
        n0, n1 = np.int32((i - n0) & (WINDOW - 1)), np.int32((i - n1) & (WINDOW - 1))
        n2, n3 = np.int32((i - n2) & (WINDOW - 1)), np.int32((i - n3) & (WINDOW - 1))
        w0, w1 = np.int32(weight & 0xFFFF), np.int32((weight >> 16) & 0xFFFF)
        w2, w3 = np.int32((weight >> 32) & 0xFFFF), np.int32((weight >> 48) & 0xFFFF)
        mass = np.int32(w0 + w1 + w2 + w3)
        for own in range(_HELD):
            channel = channels[own]
            v0, v1 = np.int32(seen[n0, channel]), np.int32(seen[n1, channel])
            v2, v3 = np.int32(seen[n2, channel]), np.int32(seen[n3, channel])
            context = channel * COLOUR_SHIFTS + min(shift, COLOUR_SHIFTS - 1)
            context = np.int32(ACTIVITIES * context + max(guesses[own], 0))
            row = np.int32(rows[np.uint64(context)])
            tokens[own], after[own] = pull(runs, spans, row, state[where[own]])
            total = np.int64(w0) * np.int64(v0) + np.int64(w1) * np.int64(v1)
            total += np.int64(w2) * np.int64(v2) + np.int64(w3) * np.int64(v3)
            # Rounded down: the quotient is at least 1/4096 away from integers.
            mean = np.int32(math.floor((np.float64(2 * total + mass) + 0.5) * inverse))
            spread = np.int64(w0) * np.int64(abs(np.int64(v0) - np.int64(mean)))
            spread += np.int64(w1) * np.int64(abs(np.int64(v1) - np.int64(mean)))
            spread += np.int64(w2) * np.int64(abs(np.int64(v2) - np.int64(mean)))
            spread += np.int64(w3) * np.int64(abs(np.int64(v3) - np.int64(mean)))
            activity = np.int32(0)
            for length in range(ACTIVITIES - 1):
                more = mass > 0 and 4 * spread >= (np.int64(mass) * step) << length
                activity = np.int32(activity + (1 if more else 0))
            means[own] = mean
            chosen[own] = np.int32(activity == guesses[own])
            lacks[own] = np.int32(chosen[own] != 0 and np.int64(after[own]) < LOWEST)
            widths[own] = raw_width(tokens[own]) if chosen[own] else 0
        lacking = ballot(lacks)
        bits = np.int32(0)
        if ballot(widths) != 0:
            bits = sums_before(widths, before)
        settle()
        for own in range(_HELD):
            lane = own * WIDTH + thread
            if chosen[own]:
                at = words_at + position + lanes_before(lacking, lane)
                state[where[own]] = completed(after[own], lacks[own], words, at)
                at = np.int32(used + before[own])
                level = integer_of(tokens[own], raw, raw_at, at, widths[own])
                value = np.int64(means[own]) + np.int64(level) * step
                if abs(value) >= FIXED_LIMIT:
                    fault[0] = BAD_VALUE
                    value = np.int64(0)
                seen[i & (WINDOW - 1), channels[own]] = value
                values[out[own] + i] = value
            where[own] = (where[own] + _CHANNELS) & (LANES - 1)
        position = np.int32(position + ones(lacking))
        used = np.int32(used + bits)
        back, weight, inverse, shift = next_back, next_weight, next_inverse, next_shift
        settle()
    for own in range(OWN):
        lane = own * WIDTH + thread
        states[block, lane] = state[lane]
    if thread == 0:
        reached[block, stream, 0], reached[block, stream, 1] = position, used
        if fault[0] != 0:
            faults[block, stream] = fault[0]

"""The f_dc pass on a device. FORMAT.md, section "Colours".

A lane for each channel and each activity decodes the token that it would be, while the activity is
not known yet; then the lane that was right has the value.
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
    integer_of,
    lanes_before,
    ones,
    pull,
    raw_width,
    settle,
    sums_before,
)
from gs_codec.coding.context_rans import BAD_VALUE, OUT_OF_WORDS
from gs_codec.coding.nearest import NEIGHBOURS, WINDOW
from gs_codec.coding.rans import LANES, LOWEST

_CHANNELS = 3
_USED = _CHANNELS * ACTIVITIES

#: Lanes that a thread may have in use.
_HELD = min(_USED, OWN)


@cuda.jit
def read_colours(
    words, raw, entries, spans, rows, reached, ends, starts, states, stream,
    ago, weights, inverses, unit, shifts, values, faults,
):  # fmt: skip
    """Decode ``values (3, N)``, fixed-point numbers; of neighbours as `surround` gives them."""
    block, thread = cuda.blockIdx.x, cuda.threadIdx.x
    start, count = starts[block], starts[block + 1] - starts[block]
    end, limit = ends[block, stream, 0], ends[block, stream, 1]
    position, used = reached[block, stream, 0], reached[block, stream, 1]
    state = cuda.shared.array(LANES, np.int64)
    seen = cuda.shared.array((WINDOW, _CHANNELS), np.int32)
    fault = cuda.shared.array(1, np.int64)
    lacks = cuda.local.array(OWN, np.int32)
    widths = cuda.local.array(OWN, np.int32)
    before = cuda.local.array(OWN, np.int32)
    chosen = cuda.local.array(OWN, np.int32)
    tokens = cuda.local.array(OWN, np.int64)
    means = cuda.local.array(OWN, np.int64)
    after = cuda.local.array(OWN, np.int64)
    for own in range(OWN):
        lane = own * WIDTH + thread
        state[lane] = states[block, lane]
        lacks[own] = widths[own] = before[own] = chosen[own] = 0
        if lane < WINDOW:
            for channel in range(_CHANNELS):
                seen[lane, channel] = 0
    fault[0] = 0
    settle()
    back, weight, inverse = np.int64(ago[start]), np.int64(weights[start]), inverses[start]
    shift = np.int64(shifts[start])
    for i in range(start, start + count):
        if position > end or used > limit:
            fault[0] = OUT_OF_WORDS
        if fault[0] != 0:
            break
        # Those of the next Gaussian, which take long to come.
        ahead = min(i + 1, start + count - 1)
        next_back, next_weight = np.int64(ago[ahead]), np.int64(weights[ahead])
        next_inverse, next_shift = inverses[ahead], np.int64(shifts[ahead])
        step = unit << shift
        for own in range(_HELD):
            lane = own * WIDTH + thread
            channel, guess = min(lane // ACTIVITIES, _CHANNELS - 1), lane % ACTIVITIES
            context = ACTIVITIES * (channel * COLOUR_SHIFTS + min(shift, COLOUR_SHIFTS - 1)) + guess
            where = (_CHANNELS * (i - start) + channel) & (LANES - 1)
            row = np.int64(rows[np.uint64(context)])
            tokens[own], after[own] = pull(entries, spans, row, state[where])
            total = mass = spread = activity = np.int64(0)
            for k in range(NEIGHBOURS):
                near = (i - ((back >> (8 * k)) & 255)) & (WINDOW - 1)
                share = (weight >> (16 * k)) & 0xFFFF
                total += share * np.int64(seen[near, channel])
                mass += share
            # Rounded down: the quotient is half of a 2048th or more away from integers.
            mean = np.int64(math.floor((np.float64(2 * total + mass) + 0.5) * inverse))
            for k in range(NEIGHBOURS):
                near = (i - ((back >> (8 * k)) & 255)) & (WINDOW - 1)
                share = (weight >> (16 * k)) & 0xFFFF
                spread += share * abs(np.int64(seen[near, channel]) - mean)
            if mass > 0:
                for length in range(ACTIVITIES - 1):
                    activity += np.int64(4 * spread >= (mass * step) << length)
            means[own] = mean
            chosen[own] = np.int32(lane < _USED and activity == guess)
            lacks[own] = np.int32(chosen[own] and after[own] < LOWEST)
            widths[own] = raw_width(tokens[own]) if chosen[own] else 0
        lacking = ballot(lacks)
        bits = np.int64(0)
        if ballot(widths) != 0:
            bits = sums_before(widths, before)
        settle()
        for own in range(_HELD):
            lane = own * WIDTH + thread
            channel = min(lane // ACTIVITIES, _CHANNELS - 1)
            if chosen[own]:
                if lacks[own]:
                    word = np.int64(words[np.uint64(position + lanes_before(lacking, lane))])
                    after[own] = after[own] << 16 | word
                state[(_CHANNELS * (i - start) + channel) & (LANES - 1)] = after[own]
                at = used + np.int64(before[own])
                level = integer_of(tokens[own], raw, at, np.int64(widths[own]))
                value = means[own] + level * step
                if abs(value) >= FIXED_LIMIT:
                    fault[0] = BAD_VALUE
                    value = np.int64(0)
                seen[i & (WINDOW - 1), channel] = value
                values[channel, i] = value
        position += ones(lacking)
        used += bits
        back, weight, inverse, shift = next_back, next_weight, next_inverse, next_shift
        settle()
    for own in range(OWN):
        lane = own * WIDTH + thread
        states[block, lane] = state[lane]
    if thread == 0:
        reached[block, stream, 0], reached[block, stream, 1] = position, used
        if fault[0] != 0:
            faults[block, stream] = fault[0]

"""The f_dc pass on a device, a thread for each of Y, Co, Cg. FORMAT.md, "Colours"."""

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


@cuda.jit
def read_colours(
    words, raw, spans, slots, rows, bounds, ends, starts, states, stream,
    ago, weights, unit, shifts, values, faults,
):  # fmt: skip
    """Decode ``values (3, N)``, fixed-point numbers."""
    block, thread = cuda.blockIdx.x, cuda.threadIdx.x
    start, count = starts[block], starts[block + 1] - starts[block]
    state = cuda.shared.array(LANES, np.int64)
    seen = cuda.shared.array((WINDOW, _CHANNELS), np.int64)
    fault = cuda.shared.array(1, np.int64)
    lacks = cuda.local.array(OWN, np.int64)
    widths = cuda.local.array(OWN, np.int64)
    before = cuda.local.array(OWN, np.int64)
    tokens = cuda.local.array(OWN, np.int64)
    means = cuda.local.array(OWN, np.int64)
    after = cuda.local.array(OWN, np.int64)
    for own in range(OWN):
        lane = own * WIDTH + thread
        state[lane] = states[block, lane]
        lacks[own] = widths[own] = before[own] = 0
        if lane < WINDOW:
            for channel in range(_CHANNELS):
                seen[lane, channel] = 0
    fault[0] = 0
    settle()
    position, used = bounds[block, stream, 0], bounds[block, stream, 1]
    for i in range(start, start + count):
        if position > ends[block, stream, 0] or used > ends[block, stream, 1]:
            fault[0] = OUT_OF_WORDS
        if fault[0] != 0:
            break
        shift = np.int64(shifts[i])
        step = unit << shift
        for own in range(OWN):
            channel = own * WIDTH + thread
            if channel >= _CHANNELS:
                continue
            total = mass = spread = activity = mean = np.int64(0)
            for k in range(NEIGHBOURS):
                value = seen[(i - np.int64(ago[i, k])) & (WINDOW - 1), channel]
                total += np.int64(weights[i, k]) * value
                mass += np.int64(weights[i, k])
            if mass > 0:
                # Exact, as in `coding.colour.predict`.
                quotient = np.float64(2 * total + mass) / np.float64(2 * mass)
                mean = np.int64(math.floor(quotient))
                for k in range(NEIGHBOURS):
                    value = seen[(i - np.int64(ago[i, k])) & (WINDOW - 1), channel]
                    spread += np.int64(weights[i, k]) * abs(value - mean)
                for length in range(ACTIVITIES - 1):
                    activity += np.int64(4 * spread >= (mass * step) << length)
            context = ACTIVITIES * (channel * COLOUR_SHIFTS + min(shift, COLOUR_SHIFTS - 1))
            row = np.int64(rows[context + activity])
            lane = (_CHANNELS * (i - start) + channel) & (LANES - 1)
            tokens[own], after[own] = pull(spans, slots, row, state[lane])
            means[own] = mean
            lacks[own] = np.int64(after[own] < LOWEST)
            widths[own] = raw_width(tokens[own])
        lacking = ballot(lacks)
        bits = np.int64(0)
        if ballot(widths) != 0:
            bits = sums_before(widths, before)
        settle()
        for own in range(OWN):
            channel = own * WIDTH + thread
            if channel >= _CHANNELS:
                continue
            lane = (_CHANNELS * (i - start) + channel) & (LANES - 1)
            if lacks[own]:
                word = np.int64(words[position + lanes_before(lacking, channel)])
                after[own] = after[own] << 16 | word
            state[lane] = after[own]
            level = integer_of(tokens[own], raw, used + before[own], widths[own])
            value = means[own] + level * step
            if abs(value) >= FIXED_LIMIT:
                fault[0] = BAD_VALUE
                value = np.int64(0)
            seen[i & (WINDOW - 1), channel] = value
            values[channel, i] = value
        position += ones(lacking)
        used += bits
        settle()
    for own in range(OWN):
        lane = own * WIDTH + thread
        states[block, lane] = state[lane]
    if thread == 0:
        bounds[block, stream, 0], bounds[block, stream, 1] = position, used
        faults[block, 1] = fault[0]

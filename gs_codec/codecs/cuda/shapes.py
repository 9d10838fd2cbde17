"""The shape pass on a device. FORMAT.md, section "Passes".

The nine symbols of a Gaussian depend on one another. Nine lanes take them apart, one for each list,
at the same time those of one Gaussian and of three before it: at each step in two phases, in the
first the shape class of a Gaussian, scale_1 of the one two before and the rotation of the one three
before; in the second the colour class and opacity, scale_0 of the one before, scale_2 of the one
two before. So a lane has what its context depends on, and the state that it needs.
"""

from __future__ import annotations

import numpy as np
from numba import cuda

from gs_codec.codecs.adaptive.contexts import (
    BEFORE,
    BEFORE_CENTRES,
    BEFORE_SHIFTS,
    SHAPE_OFFSETS,
    SHIFT_CONTEXTS,
)
from gs_codec.codecs.adaptive.lattice import FIXED_LIMIT, FRACTION_BITS, RULE_FRACTION_BITS
from gs_codec.codecs.cuda.lanes import (
    OWN,
    WIDTH,
    ballot,
    bit_length,
    integer_of,
    ones,
    pull,
    raw_width,
    settle,
    value_of,
)
from gs_codec.coding.context_rans import BAD_CLASS, BAD_VALUE, OUT_OF_WORDS
from gs_codec.coding.rans import LANES, LOWEST

_CLASS, _COLOUR, _OPACITY, _SCALE, _ROLL, _ITEMS = 0, 1, 2, 3, 6, 9

#: Streams of the pass; that of each lane, the first lane of that stream, and how many it has.
STREAMS = 4
_STREAM = np.array([0, 0, 1, 2, 2, 2, 3, 3, 3], np.int64)
_FIRST = np.array([0, 0, 2, 3, 3, 3, 6, 6, 6], np.int64)
_MOST = 3

#: Phase in which a lane decodes, and how many Gaussians it is behind.
_PHASE = np.array([0, 1, 1, 1, 0, 1, 0, 0, 0], np.int64)
_BEHIND = np.array([0, 0, 0, 1, 2, 2, 3, 3, 3], np.int64)
_LAST = 3

#: Lanes of the same stream whose symbols of the same phase come before.
_PRIOR = np.array([0, 0, 0, 1 << 5, 0, 0, 0, 1 << 6, 3 << 6], np.int64)

#: How many of opacity and three scales a rule may know when a lane uses it.
_KNOWN = np.array([0, 0, 0, 1, 2, 3, 4, 4, 4], np.int64)

#: Lanes that a thread may have in use; steps after which faults are looked for.
_HELD = min(_ITEMS, OWN)
_PATIENCE = 16


@cuda.jit
def read_shapes(
    words, raw, entries, spans, rows, reached, ends, starts, states,
    numbers, limits, units, centres, most, planes, poles, faults,
):  # fmt: skip
    """Decode ``planes (9, N)``: classes, opacity, scales, turns; and ``poles (N,)``.

    Rules, ``numbers (9, 5)`` and ``limits (9,)``, units and centres are of the lanes.
    """
    block, thread = cuda.blockIdx.x, cuda.threadIdx.x
    start, count = starts[block], starts[block + 1] - starts[block]
    state = cuda.shared.array(LANES, np.int64)
    # Of each lane: its symbols so far, what it is, its rule.
    position = cuda.local.array(OWN, np.int64)
    used = cuda.local.array(OWN, np.int64)
    last = cuda.local.array(OWN, np.int64)
    past = cuda.local.array(OWN, np.int64)
    fault = cuda.local.array(OWN, np.int64)
    rule = cuda.local.array((OWN, 5), np.int64)
    limit = cuda.local.array(OWN, np.int64)
    unit = cuda.local.array(OWN, np.int64)
    mates = cuda.local.array(OWN, np.int64)
    # Of each lane, in a phase.
    shift = cuda.local.array(OWN, np.int32)
    token = cuda.local.array(OWN, np.int64)
    after = cuda.local.array(OWN, np.int64)
    lacks = cuda.local.array(OWN, np.int32)
    width = cuda.local.array(OWN, np.int32)
    found = cuda.local.array(OWN, np.int32)
    for own in range(OWN):
        lane = own * WIDTH + thread
        state[lane] = states[block, lane]
        lacks[own] = width[own] = found[own] = shift[own] = 0
        position[own] = used[own] = last[own] = past[own] = fault[own] = 0
        limit[own] = unit[own] = mates[own] = 0
        for k in range(5):
            rule[own, k] = 0
        if lane < _ITEMS:
            stream = _STREAM[lane]
            position[own], used[own] = reached[block, stream, 0], reached[block, stream, 1]
            limit[own], unit[own] = limits[lane], units[lane]
            for k in range(5):
                rule[own, k] = numbers[lane, k] if k <= _KNOWN[lane] else 0
            for other in range(_ITEMS):
                mates[own] |= np.int64(_STREAM[other] == stream) << other
    settle()
    # Class, opacity and scales of a Gaussian and of the three before.
    c0 = c1 = c2 = c3 = o0 = o1 = o2 = o3 = np.int64(0)
    l1 = l2 = l3 = m2 = m3 = s2 = s3 = np.int64(0)
    for step in range(count + _LAST):
        for phase in range(2):
            for own in range(_HELD):
                lane = own * WIDTH + thread
                # What is not decoded yet has a factor of 0.
                octaves = c0 if lane < _SCALE else c1 if lane == _SCALE else c2
                octaves = c3 if lane >= _ROLL else octaves
                logit = o3 if lane >= _ROLL else o1 if lane == _SCALE else o2
                longest, middle = (l3, m3) if lane >= _ROLL else (l2, m2)
                total = rule[own, 0] + (octaves << RULE_FRACTION_BITS)
                total += (rule[own, 1] * min(logit, 0)) >> FRACTION_BITS
                total += (rule[own, 2] * longest) >> FRACTION_BITS
                total += (rule[own, 3] * middle) >> FRACTION_BITS
                total += (rule[own, 4] * s3) >> FRACTION_BITS
                total >>= RULE_FRACTION_BITS
                apart = abs(m3 - s3) if lane == _ROLL else abs(s3 - l3)
                apart = abs(l3 - m3) if lane > _ROLL + 1 else apart
                alike = max(FRACTION_BITS - bit_length(apart), 0)
                total += alike if lane >= _ROLL else 0
                shift[own] = min(max(total, 0), limit[own])
            if phase == 0:
                first, second = value_of(shift, _ROLL), value_of(shift, _ROLL + 2)
                for own in range(_HELD):
                    lane = own * WIDTH + thread
                    i = step - _LAST
                    if lane == _ROLL:
                        shift[own] = max(first, second)
                        if i >= 0:
                            poles[start + i] = 2 if second > first else 0
                    elif lane == _ROLL + 2:
                        shift[own] = min(first, second)
            for own in range(_HELD):
                lane = own * WIDTH + thread
                kind = min(lane, _ITEMS - 1)
                i = step - _BEHIND[kind]
                active = lane < _ITEMS and _PHASE[kind] == phase and i >= 0 and i < count
                lacks[own] = width[own] = 0
                if active:
                    few = min(np.int64(shift[own]), SHIFT_CONTEXTS - 1)
                    total = last[own] + past[own]
                    context = SHAPE_OFFSETS[lane]
                    if lane == _CLASS:
                        context += total
                    elif lane == _COLOUR:
                        context += c0
                    elif lane < _ROLL:
                        bucket = total >> BEFORE_SHIFTS[lane - _OPACITY]
                        bucket = min(max(bucket + BEFORE_CENTRES[lane - _OPACITY], 0), BEFORE - 1)
                        context += BEFORE * few + bucket
                    else:
                        context += few
                    row = np.int64(rows[np.uint64(context)])
                    where = (_ITEMS * i + lane) & (LANES - 1)
                    token[own], after[own] = pull(entries, spans, row, state[where])
                    lacks[own] = np.int32(after[own] < LOWEST)
                    width[own] = raw_width(token[own])
            lacking = ballot(lacks)
            some = ballot(width)
            for own in range(_HELD):
                lane = own * WIDTH + thread
                kind = min(lane, _ITEMS - 1)
                before = total = np.int64(0)
                if some != 0:
                    for k in range(_MOST):
                        other = _FIRST[kind] + k
                        bits = value_of(width, other)
                        total += bits * ((mates[own] >> other) & 1)
                        before += bits * ((_PRIOR[kind] >> other) & 1)
                i = step - _BEHIND[kind]
                active = lane < _ITEMS and _PHASE[kind] == phase and i >= 0 and i < count
                if active:
                    if lacks[own]:
                        at = position[own] + ones(lacking & _PRIOR[kind])
                        after[own] = after[own] << 16 | np.int64(words[np.uint64(at)])
                    state[(_ITEMS * i + lane) & (LANES - 1)] = after[own]
                    bits = np.int64(width[own])
                    value = integer_of(token[own], raw, used[own] + before, bits)
                    if lane < _OPACITY:
                        if value < 0 or value >= most[lane]:
                            fault[own] = BAD_CLASS
                            value = np.int64(0)
                    else:
                        value *= unit[own] << np.int64(shift[own])
                    past[own] = last[own]
                    last[own] = value
                    if lane == _OPACITY or lane == _SCALE:
                        value += centres[lane - _OPACITY]
                    elif lane == _SCALE + 1:
                        value = l2 - value
                    elif lane == _SCALE + 2:
                        value = m2 - value
                    if abs(value) >= FIXED_LIMIT:
                        fault[own] = BAD_VALUE
                        value = np.int64(0)
                    found[own] = value
                    planes[lane, start + i] = value
                position[own] += ones(lacking & mates[own])
                used[own] += total
            settle()
            if phase == 0:
                c0, m2 = value_of(found, _CLASS), value_of(found, _SCALE + 1)
            else:
                o0, l1 = value_of(found, _OPACITY), value_of(found, _SCALE)
                s2 = value_of(found, _SCALE + 2)
        c3, o3, l3, m3, s3 = c2, o2, l2, m2, s2
        c2, o2, l2 = c1, o1, l1
        c1, o1 = c0, o0
        if step & (_PATIENCE - 1) == 0:
            for own in range(_HELD):
                lane = own * WIDTH + thread
                stream = _STREAM[min(lane, _ITEMS - 1)]
                if position[own] > ends[block, stream, 0] or used[own] > ends[block, stream, 1]:
                    fault[own] = OUT_OF_WORDS
                lacks[own] = np.int32(fault[own] != 0 and lane < _ITEMS)
            if ballot(lacks) != 0:
                break
    for own in range(OWN):
        lane = own * WIDTH + thread
        states[block, lane] = state[lane]
        if lane < _ITEMS:
            stream = _STREAM[lane]
            if lane == _FIRST[lane]:
                reached[block, stream, 0], reached[block, stream, 1] = position[own], used[own]
            if fault[own] != 0:
                faults[block, 0] = fault[own]

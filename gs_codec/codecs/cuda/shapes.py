"""The shape pass on a device. FORMAT.md, section "Passes".

The nine symbols of a Gaussian depend on one another. Nine lanes, one for each list, decode them as
a pipeline over four Gaussians. Each step has two phases. The first decodes the shape class of
Gaussian i, scale_1 of Gaussian i - 2 and the rotation of Gaussian i - 3. The second decodes the
colour class and opacity of Gaussian i, scale_0 of Gaussian i - 1, and scale_2 of Gaussian i - 2. So
each lane's context and state are known when it needs them.
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
    completed,
    device,
    integer_of,
    launched,
    ones,
    pull,
    raw_width,
    settle,
    value_of,
)
from gs_codec.coding.binary import FRESH
from gs_codec.coding.context_rans import BAD_CLASS, BAD_VALUE, OUT_OF_WORDS
from gs_codec.coding.count_tree import STACK, TREE_CONTEXTS, walk
from gs_codec.coding.rans import LANES, LOWEST


@device
def read_tree(
    block, data, places, starts, total_bits, codes, lefts, coders, contexts, nodes, state
):  # fmt: skip
    """Decode position codes and their numbers of missing low bits, ``(N,)``.

    The tree of a block is between its ``places (blocks, 2)``; ``coders (blocks, 5)`` receives the
    final state of its coder. ``contexts (TREE_CONTEXTS,)``, int32, ``nodes (5, STACK)`` and ``state
    (5,)``, int64, are scratch memory.
    """
    start, stop = starts[block], starts[block + 1]
    tree = data[places[block, 0] : places[block, 1]]
    for k in range(TREE_CONTEXTS):
        contexts[k] = FRESH
    code = np.int64(0)
    for k in range(4):
        code = code << 8 | (np.int64(tree[k]) if k < len(tree) else np.int64(0))
    state[0], state[1], state[2], state[3], state[4] = 0, 0xFFFFFFFF, code, 4, 0
    walk(codes[start:stop], total_bits, state, tree, contexts, lefts[start:stop], False, nodes)
    for k in range(5):
        coders[block, k] = state[k]


_CLASS, _COLOUR, _OPACITY, _SCALE, _ROLL, _ITEMS = 0, 1, 2, 3, 6, 9

#: Number of streams of the pass; then, for each lane, its stream, the first lane of that stream,
#: and the stream's number of lanes.
STREAMS = 4
_STREAM = np.array([0, 0, 1, 2, 2, 2, 3, 3, 3], np.int64)
_FIRST = np.array([0, 0, 2, 3, 3, 3, 6, 6, 6], np.int64)
_MOST = 3

#: Phase in which each lane decodes; and the number of Gaussians it is behind.
_PHASE = np.array([0, 1, 1, 1, 0, 1, 0, 0, 0], np.int64)
_BEHIND = np.array([0, 0, 0, 1, 2, 2, 3, 3, 3], np.int64)
_LAST = 3

#: Mask of the lanes of the same stream that decode earlier in the same phase.
_PRIOR = np.array([0, 0, 0, 1 << 5, 0, 0, 0, 1 << 6, 3 << 6], np.int64)

#: Number of attributes (opacity and scales) that the rule of each lane may use.
_KNOWN = np.array([0, 0, 0, 1, 2, 3, 4, 4, 4], np.int64)

#: Factors of the shift, and of the bucket of the last two values, in each lane's context.
_BY_SHIFT = np.array([0, 0, BEFORE, BEFORE, BEFORE, BEFORE, 1, 1, 1], np.int64)
_BY_BUCKET = np.array([0, 0, 1, 1, 1, 1, 0, 0, 0], np.int64)

#: Lanes in use per thread; steps between checks for faults.
_HELD = min(_ITEMS, OWN)
_PATIENCE = 16


@launched
def read_shapes(
    words, raw, runs, spans, rows, reached, begins, ends, starts, states,
    numbers, limits, units, centres, most, planes, poles,
    data, trees, total_bits, codes, lefts, coders, faults,
):  # fmt: skip
    """Decode ``planes (9 N,)``: classes, opacity, scales, turns; and ``poles (N,)``.

    Rules (``numbers (9, 5)`` and ``limits (9,)``), units and centres are given per lane. A second
    warp per block reads its tree at the same time; see `read_tree`.
    """
    blocks = len(starts) - 1
    if cuda.blockIdx.x < blocks:
        _read(
            words, raw, runs, spans, rows, reached, begins, ends, starts, states,
            numbers, limits, units, centres, most, planes, poles, faults,
        )  # fmt: skip
    elif cuda.threadIdx.x == 0:
        contexts = cuda.shared.array(TREE_CONTEXTS, np.int32)
        nodes = cuda.shared.array((5, STACK), np.int64)
        state = cuda.local.array(5, np.int64)
        scratch, block = (contexts, nodes, state), cuda.blockIdx.x - blocks
        read_tree(block, data, trees, starts, total_bits, codes, lefts, coders, *scratch)


@device
def _read(
    words, raw, runs, spans, rows, reached, begins, ends, starts, states,
    numbers, limits, units, centres, most, planes, poles, faults,
):  # fmt: skip
    block, thread = cuda.blockIdx.x, np.int32(cuda.threadIdx.x)
    start, count = starts[block], np.int32(starts[block + 1] - starts[block])
    state = cuda.shared.array(LANES, np.uint32)
    # For each lane: its position in the stream, its kind, its rule, and its last two values.
    words_at = cuda.local.array(OWN, np.int64)
    raw_at = cuda.local.array(OWN, np.int64)
    position = cuda.local.array(OWN, np.int32)
    used = cuda.local.array(OWN, np.int32)
    behind = cuda.local.array(OWN, np.int32)
    turn = cuda.local.array(OWN, np.int32)
    mates = cuda.local.array(OWN, np.int32)
    prior = cuda.local.array(OWN, np.int32)
    first = cuda.local.array(OWN, np.int32)
    rule = cuda.local.array((OWN, 5), np.int32)
    limit = cuda.local.array(OWN, np.int32)
    unit = cuda.local.array(OWN, np.int64)
    centre = cuda.local.array(OWN, np.int32)
    offset = cuda.local.array(OWN, np.int32)
    by_shift = cuda.local.array(OWN, np.int32)
    by_bucket = cuda.local.array(OWN, np.int32)
    down = cuda.local.array(OWN, np.int32)
    up = cuda.local.array(OWN, np.int32)
    where = cuda.local.array(OWN, np.int32)
    out = cuda.local.array(OWN, np.int64)
    last = cuda.local.array(OWN, np.int64)
    past = cuda.local.array(OWN, np.int64)
    fault = cuda.local.array(OWN, np.int32)
    # For each lane, in a phase.
    active = cuda.local.array(OWN, np.int32)
    shift = cuda.local.array(OWN, np.int32)
    token = cuda.local.array(OWN, np.int32)
    after = cuda.local.array(OWN, np.uint32)
    lacks = cuda.local.array(OWN, np.int32)
    width = cuda.local.array(OWN, np.int32)
    found = cuda.local.array(OWN, np.int32)
    for own in range(OWN):
        lane = own * WIDTH + thread
        state[lane] = states[block, lane]
        lacks[own] = width[own] = found[own] = shift[own] = 0
        last[own] = past[own] = fault[own] = 0
        kind = min(lane, _ITEMS - 1)
        stream = _STREAM[kind]
        words_at[own], raw_at[own] = begins[block, stream, 0], begins[block, stream, 1] >> 5
        position[own], used[own] = reached[block, stream, 0], reached[block, stream, 1]
        # Lanes without a list are never active.
        behind[own], turn[own] = _BEHIND[kind], _PHASE[kind] if lane < _ITEMS else -1
        prior[own], first[own] = _PRIOR[kind], _FIRST[kind]
        limit[own], unit[own] = limits[kind], units[kind]
        offset[own], by_shift[own] = SHAPE_OFFSETS[kind], _BY_SHIFT[kind]
        by_bucket[own] = _BY_BUCKET[kind]
        down[own] = BEFORE_SHIFTS[min(max(kind - _OPACITY, 0), 3)]
        up[own] = BEFORE_CENTRES[min(max(kind - _OPACITY, 0), 3)]
        centre[own] = 0
        if _OPACITY <= kind <= _SCALE:
            centre[own] = centres[kind - _OPACITY]
        for k in range(5):
            rule[own, k] = numbers[kind, k] if k <= _KNOWN[kind] else 0
        mates[own] = 0
        for other in range(_ITEMS):
            mates[own] |= np.int32(_STREAM[other] == stream) << other
        where[own] = (lane - _ITEMS * behind[own]) & (LANES - 1)
        out[own] = kind * starts[len(starts) - 1] + start - behind[own]
    settle()
    most0, most1 = np.int32(most[0]), np.int32(most[1])
    # Class, opacity and scales of a Gaussian and of the three before it.
    c0 = c1 = c2 = c3 = o0 = o1 = o2 = o3 = np.int32(0)
    l1 = l2 = l3 = m2 = m3 = s2 = s3 = np.int32(0)
    for step in range(count + _LAST):
        for phase in range(2):
            for own in range(_HELD):
                lane = np.int32(own * WIDTH + thread)
                i = np.int32(step - behind[own])
                active[own] = np.int32(turn[own] == phase and i >= 0 and i < count)
                # Values not decoded yet have a coefficient of 0.
                octaves = c0 if lane < _SCALE else c1 if lane == _SCALE else c2
                octaves = c3 if lane >= _ROLL else octaves
                logit = o3 if lane >= _ROLL else o1 if lane == _SCALE else o2
                longest, middle = l3 if lane >= _ROLL else l2, m3 if lane >= _ROLL else m2
                total = np.int64(rule[own, 0]) + (np.int64(octaves) << RULE_FRACTION_BITS)
                total += (np.int64(rule[own, 1]) * np.int64(min(logit, 0))) >> FRACTION_BITS
                total += (np.int64(rule[own, 2]) * np.int64(longest)) >> FRACTION_BITS
                total += (np.int64(rule[own, 3]) * np.int64(middle)) >> FRACTION_BITS
                if phase == 0:
                    total += (np.int64(rule[own, 4]) * np.int64(s3)) >> FRACTION_BITS
                octave = np.int32(min(max(total >> RULE_FRACTION_BITS, -64), 64))
                if phase == 0:
                    one = m3 if lane == _ROLL else l3
                    other = m3 if lane > _ROLL + 1 else s3
                    difference = min(abs(np.int64(one) - np.int64(other)), 1 << FRACTION_BITS)
                    alike = max(FRACTION_BITS - bit_length(difference), 0)
                    octave = np.int32(octave + (alike if lane >= _ROLL else 0))
                shift[own] = min(max(octave, 0), limit[own])
            if phase == 0:
                one, other = value_of(shift, _ROLL), value_of(shift, _ROLL + 2)
                for own in range(_HELD):
                    lane = own * WIDTH + thread
                    if lane == _ROLL:
                        shift[own] = max(one, other)
                        if active[own]:
                            poles[start + step - _LAST] = 2 if other > one else 0
                    elif lane == _ROLL + 2:
                        shift[own] = min(one, other)
            for own in range(_HELD):
                lane = own * WIDTH + thread
                lacks[own] = width[own] = 0
                if active[own]:
                    few = min(shift[own], SHIFT_CONTEXTS - 1)
                    total = last[own] + past[own]
                    bucket = np.int32(min(max((total >> down[own]) + up[own], 0), BEFORE - 1))
                    context = np.int32(offset[own] + by_shift[own] * few + by_bucket[own] * bucket)
                    if lane == _CLASS:
                        context = np.int32(total)
                    elif lane == _COLOUR:
                        context = np.int32(context + c0)
                    row = np.int32(rows[np.uint64(context)])
                    token[own], after[own] = pull(runs, spans, row, state[where[own]])
                    lacks[own] = np.int32(np.int64(after[own]) < LOWEST)
                    width[own] = raw_width(token[own])
            lacking = ballot(lacks)
            some = ballot(width)
            for own in range(_HELD):
                lane = own * WIDTH + thread
                before = bits = np.int32(0)
                if some != 0:
                    for k in range(_MOST):
                        place = np.int32(first[own] + k)
                        each = value_of(width, place)
                        bits = np.int32(bits + (each if (mates[own] >> place) & 1 else 0))
                        before = np.int32(before + (each if (prior[own] >> place) & 1 else 0))
                if active[own]:
                    at = words_at[own] + position[own] + ones(lacking & prior[own])
                    state[where[own]] = completed(after[own], lacks[own], words, at)
                    at = np.int32(used[own] + before)
                    level = integer_of(token[own], raw, raw_at[own], at, width[own])
                    value = np.int64(level)
                    if lane < _OPACITY:
                        if level < 0 or level >= (most0 if lane == _CLASS else most1):
                            fault[own] = BAD_CLASS
                            value = np.int64(0)
                    else:
                        value *= unit[own] << shift[own]
                    past[own] = last[own]
                    moved = value + np.int64(centre[own])
                    if lane == _SCALE + 1:
                        moved = np.int64(l2) - value
                    elif lane == _SCALE + 2:
                        moved = np.int64(m2) - value
                    if abs(moved) >= FIXED_LIMIT:
                        fault[own] = BAD_VALUE
                        value = moved = np.int64(0)
                    last[own] = value
                    found[own] = moved
                    planes[out[own] + step] = moved
                if turn[own] == phase:
                    where[own] = (where[own] + _ITEMS) & (LANES - 1)
                position[own] += ones(lacking & mates[own])
                used[own] += bits
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
                over = position[own] > ends[block, stream, 0] - words_at[own]
                if over or used[own] > ends[block, stream, 1] - (raw_at[own] << 5):
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

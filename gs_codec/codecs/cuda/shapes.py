"""The shape pass on a device. FORMAT.md, section "Passes".

Nine symbols of a Gaussian depend on one another. Four threads take them apart, one for each stream:
while one decodes the classes and the opacity of a Gaussian, another decodes the scales of the one
before it, and a third the rotation of the one before that.
"""

from __future__ import annotations

import numpy as np
from numba import cuda

from gs_codec.codecs.adaptive.contexts import SHAPE_OFFSETS, SHIFT_CONTEXTS
from gs_codec.codecs.adaptive.lattice import FIXED_LIMIT, rule_shift
from gs_codec.codecs.adaptive.rotation import turns_of
from gs_codec.codecs.adaptive.shape import before_context
from gs_codec.codecs.cuda.lanes import OWN, WIDTH, integer_of, pull, raw_width, settle
from gs_codec.coding.context_rans import BAD_CLASS, BAD_VALUE, OUT_OF_WORDS
from gs_codec.coding.rans import LANES, LOWEST

#: Streams of the pass, each of one thread; and how many of them a thread has.
STREAMS = 4
_HELD = -(-STREAMS // WIDTH)

#: List of symbols that the thread of a stream decodes in each of three phases, or -1.
_LISTS = np.array([[0, 1, -1], [-1, 2, -1], [3, 4, 5], [6, 7, 8]], np.int64)

#: How many Gaussians a stream is behind the first.
_BEHIND = np.array([0, 0, 1, 2], np.int64)

#: Symbols of a Gaussian, and Gaussians whose numbers threads can see.
_SYMBOLS, _SEEN = 9, 4

_CLASS, _COLOUR, _OPACITY, _SCALE, _ROLL = 0, 1, 2, 3, 6


@cuda.jit
def read_shapes(
    words, raw, spans, slots, rows, bounds, ends, starts, states,
    numbers, limits, units, centres, most, planes, poles, faults,
):  # fmt: skip
    """Decode ``planes (9, N)``: classes, opacity, scales, turns; and ``poles (N,)``."""
    block, thread = cuda.blockIdx.x, cuda.threadIdx.x
    start, count = starts[block], starts[block + 1] - starts[block]
    state = cuda.shared.array(LANES, np.int64)
    seen = cuda.shared.array((_SEEN, _SYMBOLS), np.int64)
    last = cuda.shared.array((2, _SYMBOLS), np.int64)
    turns = cuda.shared.array(3, np.int64)
    fault = cuda.shared.array(1, np.int64)
    position = cuda.local.array(_HELD, np.int64)
    used = cuda.local.array(_HELD, np.int64)
    for own in range(OWN):
        lane = own * WIDTH + thread
        state[lane] = states[block, lane]
        if lane < _SYMBOLS:
            last[0, lane] = last[1, lane] = 0
    for own in range(_HELD):
        stream = own * WIDTH + thread
        if stream < STREAMS:
            position[own], used[own] = bounds[block, stream, 0], bounds[block, stream, 1]
    fault[0] = 0
    settle()
    for step in range(count + _BEHIND[STREAMS - 1]):
        for phase in range(3):
            for own in range(_HELD):
                stream = own * WIDTH + thread
                if stream >= STREAMS:
                    continue
                item, i = _LISTS[stream, phase], step - _BEHIND[stream]
                if item < 0 or i < 0 or i >= count:
                    continue
                if position[own] > ends[block, stream, 0] or used[own] > ends[block, stream, 1]:
                    fault[0] = OUT_OF_WORDS
                    continue
                near = seen[i & (_SEEN - 1)]
                shift = np.int64(0)
                if item == _CLASS:
                    context = last[0, 0] + last[1, 0]
                elif item == _COLOUR:
                    context = SHAPE_OFFSETS[1] + near[_CLASS]
                elif item < _ROLL:
                    # What is not decoded yet counts as 0.
                    logit = near[_OPACITY] if item > _OPACITY else np.int64(0)
                    longest = near[_SCALE] if item > _SCALE else np.int64(0)
                    middle = near[_SCALE + 1] if item > _SCALE + 1 else np.int64(0)
                    shift = rule_shift(
                        numbers, limits, item - _OPACITY, near[_CLASS], logit, longest, middle, 0, 0
                    )
                    context = before_context(item - _OPACITY, shift, last[0, item] + last[1, item])
                else:
                    if item == _ROLL:
                        turns[0], turns[1], turns[2], pole = turns_of(
                            numbers, limits, 4, near[_CLASS], near[_OPACITY],
                            near[_SCALE], near[_SCALE + 1], near[_SCALE + 2],
                        )  # fmt: skip
                        poles[start + i] = pole
                    shift = turns[phase]
                    context = SHAPE_OFFSETS[item] + min(shift, SHIFT_CONTEXTS - 1)
                lane = (_SYMBOLS * i + item) & (LANES - 1)
                token, after = pull(spans, slots, np.int64(rows[context]), state[lane])
                if after < LOWEST:
                    after = after << 16 | np.int64(words[position[own]])
                    position[own] += 1
                state[lane] = after
                width = raw_width(token)
                value = integer_of(token, raw, used[own], width)
                used[own] += width
                if item < _OPACITY:
                    if value < 0 or value >= most[item]:
                        fault[0] = BAD_CLASS
                        value = np.int64(0)
                else:
                    value *= units[stream] << shift
                if item < _ROLL:
                    last[1, item] = last[0, item]
                    last[0, item] = value
                if item == _OPACITY:
                    value += centres[0]
                elif item == _SCALE:
                    value += centres[1]
                elif item in (_SCALE + 1, _SCALE + 2):
                    value = near[item - 1] - value
                if abs(value) >= FIXED_LIMIT:
                    fault[0] = BAD_VALUE
                near[item] = value
                planes[item, start + i] = value
            settle()
        if fault[0] != 0:
            break
    for own in range(OWN):
        lane = own * WIDTH + thread
        states[block, lane] = state[lane]
    for own in range(_HELD):
        stream = own * WIDTH + thread
        if stream < STREAMS:
            bounds[block, stream, 0], bounds[block, stream, 1] = position[own], used[own]
    if thread == 0:
        faults[block, 0] = fault[0]

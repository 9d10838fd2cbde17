"""Colours rounded on a device, as `adaptive.colour` does: a thread for each channel of a block."""

from __future__ import annotations

import math

import numpy as np
from numba import cuda

from gs_codec.codecs.adaptive.colour import SHARE
from gs_codec.codecs.adaptive.contexts import ACTIVITIES, COLOUR_SHIFTS
from gs_codec.codecs.cuda.lanes import launched, rounded_single
from gs_codec.coding.nearest import NEIGHBOURS, WINDOW, find_nearest

_CHANNELS = 3

#: Errors that are kept: those of twice the window in which neighbours are found.
_KEPT = 2 * WINDOW


@launched
def find_shares(places, block_size, shares):
    """Fill ``shares (4, N)`` of the errors of the nearest that a Gaussian takes over."""
    near = cuda.local.array((1, NEIGHBOURS), np.int64)
    distances = cuda.local.array((1, NEIGHBOURS), np.int64)
    keys = cuda.local.array(WINDOW, np.float64)
    for i in range(cuda.grid(1), shares.shape[1], cuda.gridsize(1)):
        for k in range(NEIGHBOURS):
            near[0, k] = distances[0, k] = 0
        first = i - i % block_size
        found = find_nearest(places[:, first : i + 1], i - first, near, distances, 0, keys)
        total = 0.0
        for k in range(found):
            total += 1.0 / (1.0 + distances[0, 0] + distances[0, k])
        for k in range(NEIGHBOURS):
            shares[k, i] = 0.0
            if k < found:
                shares[k, i] = SHARE / total / (1.0 + distances[0, 0] + distances[0, k])


@launched
def round_diffusing(values, ago, shares, starts, levels):
    """Round ``values (C, N)``, in steps, with the errors of the nearest; ``ago`` has four each."""
    block, channel = cuda.blockIdx.x // values.shape[0], cuda.blockIdx.x % values.shape[0]
    start, count = starts[block], starts[block + 1] - starts[block]
    errors = cuda.local.array(_KEPT, np.float32)
    for i in range(_KEPT):
        errors[i] = 0.0
    for i in range(count):
        back, own = np.int64(ago[start + i]), np.float32(0.0)
        for k in range(NEIGHBOURS):
            apart = (back >> (8 * k)) & 255
            if apart > 0:
                theirs = errors[(i - apart) & (_KEPT - 1)]
                own = np.float32(own + rounded_single(shares[k, start + i], theirs))
        taken = min(max(own, np.float32(-1.0)), np.float32(1.0))
        wanted = np.float32(values[channel, start + i] + taken)
        level = np.float32(math.floor(np.float32(wanted + np.float32(0.5))))
        errors[i & (_KEPT - 1)] = np.float32(wanted - level)
        levels[channel, start + i] = np.int32(level)


@launched
def round_colours(colours, ago, weights, inverses, unit, shifts, starts, levels, contexts):
    """Fill levels and contexts ``(N, 3)`` of ``colours (3, N)``; neighbours as by `surround`."""
    block, channel = cuda.blockIdx.x // _CHANNELS, cuda.blockIdx.x % _CHANNELS
    start, count = starts[block], starts[block + 1] - starts[block]
    seen = cuda.local.array(WINDOW, np.int64)
    for i in range(WINDOW):
        seen[i] = 0
    for i in range(count):
        back, weight = np.int64(ago[start + i]), np.int64(weights[start + i])
        shift = np.int64(shifts[start + i])
        step = np.int64(unit) << shift
        total = mass = spread = activity = np.int64(0)
        for k in range(NEIGHBOURS):
            own = (weight >> (16 * k)) & 0xFFFF
            total += own * seen[(i - ((back >> (8 * k)) & 255)) & (WINDOW - 1)]
            mass += own
        # Rounded down: the quotient is half of a 2048th or more away from integers.
        mean = np.int64(math.floor((np.float64(2 * total + mass) + 0.5) * inverses[start + i]))
        for k in range(NEIGHBOURS):
            value = seen[(i - ((back >> (8 * k)) & 255)) & (WINDOW - 1)]
            spread += ((weight >> (16 * k)) & 0xFFFF) * abs(value - mean)
        for length in range(ACTIVITIES - 1):
            activity += np.int64(mass > 0 and 4 * spread >= (mass * step) << length)
        level = (2 * (np.int64(colours[channel, start + i]) - mean) + step) // (2 * step)
        context = channel * COLOUR_SHIFTS + min(shift, COLOUR_SHIFTS - 1)
        levels[start + i, channel] = level
        contexts[start + i, channel] = ACTIVITIES * context + activity
        seen[i & (WINDOW - 1)] = mean + level * step

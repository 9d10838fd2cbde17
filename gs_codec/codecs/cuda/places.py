"""Positions and neighbours on a device, one thread per Gaussian. FORMAT.md, "Positions"."""

from __future__ import annotations

import numpy as np
from numba import cuda

from gs_codec.codecs.adaptive.lattice import rule_shift
from gs_codec.codecs.cuda.lanes import launched, rounded
from gs_codec.coding.nearest import NEIGHBOURS, WINDOW, find_nearest
from gs_codec.coding.predicted_colour import weigh

_LARGEST = float(np.finfo(np.float32).max)


@launched
def find_widths(numbers, limits, planes, lefts, widths, shifts):
    """Fill widths of low bits and shifts of colours, ``(N,)``; rules are of positions, colours."""
    for i in range(cuda.grid(1), len(widths), cuda.gridsize(1)):
        logit, longest = np.int64(planes[2, i]), np.int64(planes[3, i])
        middle, shortest = np.int64(planes[4, i]), np.int64(planes[5, i])
        octaves = 3 * np.int64(planes[0, i])
        dropped = rule_shift(numbers, limits, 0, octaves, logit, longest, middle, shortest, 0)
        widths[i] = max(np.int64(lefts[i]) - dropped, 0)
        octaves = np.int64(planes[1, i])
        shifts[i] = rule_shift(numbers, limits, 1, octaves, logit, longest, middle, shortest, 0)


@launched
def place(
    raw, firsts, lasts, before, widths, lefts, codes, block_size, axes, sides, origin, half,
    places, means,
):  # fmt: skip
    """Read low bits; fill ``places (3, N)`` in half steps and ``means (N, 3)``.

    The bits of a block begin at ``firsts``, minus the value of ``before (N,)`` at its first
    Gaussian.
    """
    for i in range(cuda.grid(1), len(widths), cuda.gridsize(1)):
        block, width = i // block_size, np.int64(widths[i])
        at = firsts[block] + before[i] - before[block * block_size]
        field = np.int64(0)
        while width > 0:
            take = min(8 - (at & 7), width)
            byte = np.int64(raw[at >> 3]) if at < lasts[block] else np.int64(0)
            field = (field << take) | ((byte >> (8 - (at & 7) - take)) & ((1 << take) - 1))
            at += take
            width -= take
        dropped = np.int64(lefts[i]) - np.int64(widths[i])
        code = np.int64(codes[i]) | (field << dropped)
        for axis in range(3):
            cell = np.int64(0)
            for byte in range(8):
                cell |= np.int64(axes[byte, (code >> (8 * byte)) & 255, axis])
            cell = 2 * cell + (1 << np.int64(sides[axis, dropped]))
            places[axis, i] = cell
            position = origin[axis] + rounded(np.float64(cell), half)
            means[i, axis] = min(max(position, -_LARGEST), _LARGEST)


@launched
def surround(places, block_size, ago, weights, inverses):
    """Find the nearest preceding Gaussians of each, ``(N,)``.

    ``ago`` has the distance back to each of four neighbours, 8 bits each, 0 for none; ``weights``
    their weights, 16 bits each; ``inverses`` half the inverse of the weights' sum.
    """
    near = cuda.local.array((1, NEIGHBOURS), np.int64)
    distances = cuda.local.array((1, NEIGHBOURS), np.int64)
    own = cuda.local.array(NEIGHBOURS, np.int64)
    keys = cuda.local.array(WINDOW, np.float64)
    for i in range(cuda.grid(1), len(ago), cuda.gridsize(1)):
        for k in range(NEIGHBOURS):
            near[0, k] = distances[0, k] = 0
        first = i - i % block_size
        found = find_nearest(places[:, first : i + 1], i - first, near, distances, 0, keys)
        weigh(distances, 0, found, own)
        back = weight = mass = np.int64(0)
        for k in range(NEIGHBOURS):
            if k < found:
                back |= (i - first - near[0, k]) << (8 * k)
                weight |= own[k] << (16 * k)
                mass += own[k]
        ago[i], weights[i] = back, weight
        inverses[i] = 0.5 / mass if mass > 0 else 0.0

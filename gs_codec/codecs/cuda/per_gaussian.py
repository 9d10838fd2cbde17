"""Kernels with one thread per Gaussian: positions and neighbours, and the floats of a scene."""

from __future__ import annotations

import math

import numpy as np
from numba import cuda

from gs_codec.codecs.adaptive.lattice import FRACTION_BITS, TOO_LARGE, rule_shift
from gs_codec.codecs.cuda.lanes import SIMULATED, device, launched, meet, rounded
from gs_codec.coding.nearest import NEIGHBOURS, WINDOW, find_nearest
from gs_codec.coding.predicted_colour import weigh
from gs_codec.coding.ycocg import GREEN, LUMA, ORANGE
from gs_codec.scene import SH_COEFFICIENTS

_LARGEST = float(np.finfo(np.float32).max)


@launched
def find_widths(numbers, limits, planes, lefts, widths, shifts):
    """Fill widths of low bits and shifts of colours, ``(N,)``; rules: positions, colours."""
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


#: Threads of a kernel that has one thread per Gaussian.
THREADS = 1 if SIMULATED else 128

#: Row length of a Gaussian's colours in shared memory; the extra column avoids bank conflicts.
_COLUMNS = 3 * (1 + max(SH_COEFFICIENTS)) + 1

_ONE = float(1 << FRACTION_BITS)


@launched
def fill_shapes(planes, poles, logits, log_scales, quats):
    """Fill ``logits (N,)``, ``log_scales (N, 3)`` and ``quats (N, 4)``."""
    for i in range(cuda.grid(1), len(logits), cuda.gridsize(1)):
        logits[i] = np.float64(planes[2, i]) / _ONE
        for k in range(3):
            log_scales[i, k] = np.float64(planes[3 + k, i]) / _ONE
        roll = min(max(np.float64(planes[6, i]) / _ONE, -1.0), 1.0)
        middle, third = np.float64(planes[7, i]) / _ONE, np.float64(planes[8, i]) / _ONE
        real = math.sqrt(1.0 - rounded(roll, roll))
        square = rounded(middle, middle) + rounded(third, third)
        norm, upright = math.sqrt(max(square, 1.0)), math.sqrt(max(1.0 - square, 0.0))
        middle, third = middle / norm, third / norm
        pole = np.int64(poles[i])
        sign = 1.0 - pole
        quats[i, 0] = real * upright
        quats[i, 1 + pole] = roll * upright
        quats[i, 2] = rounded(real, middle) - sign * rounded(roll, third)
        quats[i, 3 - pole] = rounded(real, third) + sign * rounded(roll, middle)


@device
def _fill(tile, thread, column, y, o, g):
    luma, orange, green = rounded(y, LUMA), rounded(o, ORANGE), rounded(g, GREEN)
    rest = luma - green
    tile[thread, column] = rest + orange
    tile[thread, column + 1] = luma + 2.0 * green
    tile[thread, column + 2] = rest - orange


@device
def _coefficient(levels, matrices, run, runs, k, i):
    """Y, Co, Cg of a coefficient, in step sizes; without runs, levels are of coefficients."""
    if runs == 0:
        return (
            np.float64(levels[k, 0, i]),
            np.float64(levels[k, 1, i]),
            np.float64(levels[k, 2, i]),
        )
    y, o, g = 0.0, 0.0, 0.0
    for j in range(matrices.shape[2]):
        factor = matrices[run, k, j]
        y += factor * levels[j, 0, i]
        o += factor * levels[j, 1, i]
        g += factor * levels[j, 2, i]
    return y, o, g


@launched
def fill_colours(
    values, levels, matrices, firsts, units, shifts, coefficients, block_size, fault, faults, sh
):  # fmt: skip
    """Fill ``sh (N (1 + K) 3,)`` from SH-DC ``values (3, N)`` and SH-AC ``levels (K, 3, N)``.

    ``matrices (R, K, K)`` turn the components of runs into coefficients; a block's begin at
    ``firsts[block]`` of ``firsts (blocks + 1,)``. Threads write from shared memory, so that writes
    of adjacent colours are coalesced.
    """
    tile = cuda.shared.array((THREADS, _COLUMNS), np.float32)
    thread, width = cuda.threadIdx.x, 3 * (1 + coefficients)
    for first in range(cuda.blockIdx.x * THREADS, len(shifts), cuda.gridDim.x * THREADS):
        i = first + thread
        if i < len(shifts):
            y, o = np.float64(values[0, i]) / _ONE, np.float64(values[1, i]) / _ONE
            _fill(tile, thread, 0, y, o, np.float64(values[2, i]) / _ONE)
            octave = np.float64(1 << np.int64(shifts[i])) / _ONE
            block = i // block_size
            runs = firsts[block + 1] - firsts[block]
            size = min(block_size, len(shifts) - block * block_size)
            run = firsts[block] + ((i - block * block_size + 1) * runs - 1) // size
            for k in range(coefficients):
                y, o, g = _coefficient(levels, matrices, run, runs, k, i)
                step = units[k] * octave
                y, o, g = y * step, o * step, g * step
                if max(abs(y), abs(o), abs(g)) >= TOO_LARGE:
                    faults[block, faults.shape[1] - 1] = fault
                _fill(tile, thread, 3 + 3 * k, y, o, g)
        meet()
        for k in range(thread, min(THREADS, len(shifts) - first) * width, THREADS):
            sh[first * width + k] = tile[k // width, k % width]
        meet()

"""Convert integers to the floats of a scene, one thread per Gaussian, rounded as on a CPU."""

from __future__ import annotations

import math

import numpy as np
from numba import cuda

from gs_codec.codecs.adaptive.lattice import FRACTION_BITS, TOO_LARGE
from gs_codec.codecs.cuda.lanes import SIMULATED, device, launched, meet, rounded
from gs_codec.coding.ycocg import GREEN, LUMA, ORANGE
from gs_codec.scene import SH_COEFFICIENTS

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


@launched
def fill_colours(values, levels, units, shifts, coefficients, block_size, fault, faults, sh):
    """Fill ``sh (N (1 + K) 3,)`` from SH-DC ``values (3, N)`` and SH-AC ``levels (K, 3, N)``.

    Threads write from shared memory, so that writes of adjacent colours are coalesced.
    """
    tile = cuda.shared.array((THREADS, _COLUMNS), np.float32)
    thread, width = cuda.threadIdx.x, 3 * (1 + coefficients)
    for first in range(cuda.blockIdx.x * THREADS, len(shifts), cuda.gridDim.x * THREADS):
        i = first + thread
        if i < len(shifts):
            y, o = np.float64(values[0, i]) / _ONE, np.float64(values[1, i]) / _ONE
            _fill(tile, thread, 0, y, o, np.float64(values[2, i]) / _ONE)
            octave = np.float64(1 << np.int64(shifts[i])) / _ONE
            for k in range(coefficients):
                step = units[k] * octave
                y, o = np.float64(levels[k, 0, i]) * step, np.float64(levels[k, 1, i]) * step
                g = np.float64(levels[k, 2, i]) * step
                if max(abs(y), abs(o), abs(g)) >= TOO_LARGE:
                    faults[i // block_size, faults.shape[1] - 1] = fault
                _fill(tile, thread, 3 + 3 * k, y, o, g)
        meet()
        for k in range(thread, min(THREADS, len(shifts) - first) * width, THREADS):
            sh[first * width + k] = tile[k // width, k % width]
        meet()

"""Numbers of a scene from its integers, a thread for each Gaussian, rounded as on a CPU."""

from __future__ import annotations

import math

import numpy as np
from numba import cuda

from gs_codec.codecs.adaptive.lattice import FRACTION_BITS, TOO_LARGE
from gs_codec.codecs.cuda.lanes import device, rounded
from gs_codec.coding.ycocg import GREEN, LUMA, ORANGE

_ONE = float(1 << FRACTION_BITS)


@device
def _red_green_blue(y, o, g, out):
    luma, orange, green = rounded(y, LUMA), rounded(o, ORANGE), rounded(g, GREEN)
    rest = luma - green
    out[0], out[1], out[2] = rest + orange, luma + 2.0 * green, rest - orange


@cuda.jit
def fill_shapes(planes, poles, logits, log_scales, quats):
    """Fill ``logits (N,)``, ``log_scales (N, 3)`` and ``quats (N, 4)``."""
    i = cuda.grid(1)
    if i >= len(logits):
        return
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


@cuda.jit
def fill_colours(
    values, levels, units, shifts, coefficients, block_size, number, fault, faults, sh
):  # fmt: skip
    """Fill ``sh (N, 1 + K, 3)`` from SH-DC ``values (3, N)`` and SH-AC ``levels (K, 3, N)``."""
    i = cuda.grid(1)
    if i >= len(shifts):
        return
    y, o = np.float64(values[0, i]) / _ONE, np.float64(values[1, i]) / _ONE
    _red_green_blue(y, o, np.float64(values[2, i]) / _ONE, sh[i, 0])
    octave = np.float64(1 << np.int64(shifts[i])) / _ONE
    for k in range(coefficients):
        step = np.float64(units[k]) * octave
        y, o = np.float64(levels[k, 0, i]) * step, np.float64(levels[k, 1, i]) * step
        g = np.float64(levels[k, 2, i]) * step
        if max(abs(y), abs(o), abs(g)) >= TOO_LARGE:
            faults[i // block_size, number] = fault
        _red_green_blue(y, o, g, sh[i, 1 + k])

"""Orthonormal luma and chroma of SH, so that one step size suits all three."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gs_codec.runtime.kernels import inlined, kernel

LUMA = 1.0 / math.sqrt(3.0)
ORANGE = 1.0 / math.sqrt(2.0)
GREEN = 1.0 / math.sqrt(6.0)


def to_ycocg(colours: NDArray[np.float32]) -> NDArray[np.float64]:
    """Y, Co, Cg ``(3, ...)`` of R, G, B ``(3, ...)``; preserves lengths."""
    red, green, blue = colours.astype(np.float64)
    luma = (red + green + blue) * LUMA
    return np.stack([luma, (red - blue) * ORANGE, (2.0 * green - red - blue) * GREEN])


def from_ycocg(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Invert `to_ycocg`, in float64, with each product rounded separately, then to float32."""
    luma, orange, green = values[0] * LUMA, values[1] * ORANGE, values[2] * GREEN
    rest = luma - green
    return np.stack([rest + orange, luma + 2.0 * green, rest - orange]).astype(np.float32)


@inlined
def luma_chroma(red, green, blue):
    """Y, Co, Cg of one colour, as in `to_ycocg`."""
    luma = (red + green + blue) * LUMA
    return luma, (red - blue) * ORANGE, (2.0 * green - red - blue) * GREEN


@inlined
def red_green_blue(y, o, g):
    """R, G, B of one colour, as in `from_ycocg`."""
    luma, orange, green = y * LUMA, o * ORANGE, g * GREEN
    rest = luma - green
    return rest + orange, luma + 2.0 * green, rest - orange


@kernel
def _take(planes, members, units, shifts, limit, out):
    beyond = 0
    taken = np.empty((3, len(members)))
    for k in range(len(units)):
        # Gather in a loop of its own: it is memory-bound, because members are scattered over a
        # plane.
        for channel in range(3):
            for i in range(len(members)):
                taken[channel, i] = planes[channel, k, members[i]]
        for i in range(len(members)):
            step = np.float64(units[k] << shifts[i]) / 1048576.0
            luma, orange, other = luma_chroma(taken[0, i], taken[1, i], taken[2, i])
            beyond += np.int64(abs(luma) > limit) + (abs(orange) > limit) + (abs(other) > limit)
            out[0, k, i] = min(max(luma, -limit), limit) / step
            out[1, k, i] = min(max(orange, -limit), limit) / step
            out[2, k, i] = min(max(other, -limit), limit) / step
    return beyond


def take_colours(
    planes: NDArray[np.float32],
    members: NDArray[np.integer],
    units: NDArray[np.int64],
    shifts: NDArray[np.int64],
    limit: float,
) -> tuple[NDArray[np.float32], int]:
    """Y, Co, Cg ``(3 K, n)`` in steps, of R, G, B ``planes (3, K, N)``; how many were clamped.

    The step of coefficient k of Gaussian ``members[i]`` is ``units[k] << shifts[i]``, in units of 1
    / 2**20; values beyond `limit` are clamped to it.
    """
    out = np.empty((3, len(units), len(members)), np.float32)
    beyond = _take(planes, members, units, shifts, limit, out)
    return out.reshape(3 * len(units), len(members)), beyond


@kernel
def _fill(levels, units, steps, limit, out, first):
    count, beyond = len(steps), 0
    for k in range(len(units)):
        unit = units[k]
        # Contiguous rows, and no float maximum, so that LLVM vectorises over eight colours.
        luma, orange, other = levels[0, k], levels[1, k], levels[2, k]
        red, green, blue = (
            out[0, k, first : first + count],
            out[1, k, first : first + count],
            out[2, k, first : first + count],
        )
        for i in range(count):
            step = unit * steps[i]
            y, o, g = luma[i] * step, orange[i] * step, other[i] * step
            beyond |= np.int64(abs(y) >= limit) | np.int64(abs(o) >= limit)
            beyond |= np.int64(abs(g) >= limit)
            red[i], green[i], blue[i] = red_green_blue(y, o, g)
    return beyond == 0


def fill_colours(
    levels: NDArray[np.int32],
    units: NDArray[np.int64],
    shifts: NDArray[np.int64],
    limit: float,
    out: NDArray[np.float32],
    first: int = 0,
) -> bool:
    """Convert ``levels (3, K, n)`` of Y, Co, Cg to R, G, B in ``out (3, K, N)``, from `first` on.

    The value of a level is ``level * (units[k] << shifts[i])``, in units of 1 / 2**20: exact below
    2**33. Return whether all are below `limit`. The operations are those of `from_ycocg`.
    """
    return _fill(levels, units.astype(np.float64), 2.0 ** (shifts - 20), limit, out, first)


@kernel
def _round(planes, rows, start, steps, out):
    stop = start + len(steps)
    for k in range(rows[0], rows[1]):
        reds, greens, blues = (
            planes[0, k, start:stop],
            planes[1, k, start:stop],
            planes[2, k, start:stop],
        )
        red, green, blue = out[0, k, start:stop], out[1, k, start:stop], out[2, k, start:stop]
        for i in range(len(steps)):
            y, o, g = luma_chroma(np.float64(reds[i]), np.float64(greens[i]), np.float64(blues[i]))
            step = steps[i]
            y, o, g = step * np.rint(y / step), step * np.rint(o / step), step * np.rint(g / step)
            red[i], green[i], blue[i] = red_green_blue(y, o, g)


def round_colours(
    planes: NDArray[np.float32],
    rows: range,
    start: int,
    steps: NDArray[np.floating],
    out: NDArray[np.float32],
) -> None:
    """Round some of R, G, B ``planes (3, K, N)`` to `out` so that Y, Co, Cg are whole steps.

    They are those of coefficients `rows` and of n Gaussians from `start` on; ``steps (n,)``.
    """
    _round(planes, (rows.start, rows.stop), start, steps, out)

"""Orthonormal luma and chroma of SH, so that one step serves all three."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gs_codec.kernels import kernel

_LUMA = 1.0 / math.sqrt(3.0)
_ORANGE = 1.0 / math.sqrt(2.0)
_GREEN = 1.0 / math.sqrt(6.0)


def to_ycocg(colours: NDArray[np.float32]) -> NDArray[np.float64]:
    """Y, Co, Cg ``(3, ...)`` of R, G, B ``(3, ...)``; lengths stay as they are."""
    red, green, blue = colours.astype(np.float64)
    luma = (red + green + blue) * _LUMA
    return np.stack([luma, (red - blue) * _ORANGE, (2.0 * green - red - blue) * _GREEN])


def from_ycocg(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """The inverse of `to_ycocg`, in float64, product by product, then float32."""
    luma, orange, green = values[0] * _LUMA, values[1] * _ORANGE, values[2] * _GREEN
    rest = luma - green
    return np.stack([rest + orange, luma + 2.0 * green, rest - orange]).astype(np.float32)


@kernel
def fill_colours(levels, units, shifts, places, limit, out):
    """R, G, B of levels of Y, Co, Cg ``(3, K, n)`` into columns `places` of ``out (3, K, N)``.

    The value of a level is ``level * (units[k] << shifts[i])``, in 1 / 2**20. Returns whether all
    are below `limit`. Same operations as `from_ycocg`.
    """
    for k in range(len(units)):
        for i in range(len(places)):
            step = units[k] << shifts[i]
            y, o, g = levels[0, k, i] * step, levels[1, k, i] * step, levels[2, k, i] * step
            if max(abs(y), abs(o), abs(g)) >= limit:
                return False
            luma = (y / 1048576.0) * _LUMA
            orange = (o / 1048576.0) * _ORANGE
            green = (g / 1048576.0) * _GREEN
            rest = luma - green
            place = places[i]
            out[0, k, place] = rest + orange
            out[1, k, place] = luma + 2.0 * green
            out[2, k, place] = rest - orange
    return True

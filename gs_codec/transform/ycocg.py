"""Orthonormal luma and chroma of SH, so that one step serves all three."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

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

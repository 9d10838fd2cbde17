"""Values that are nearly zero, as training leaves them if a colour is stuck at black."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Threshold relative to the channel's mean magnitude. Quantised formats store several values next
#: to zero. With a Laplace distribution, one value in a hundred is below it, but never all of a
#: colour.
_SHARE = 0.01


def is_zero(planes: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which values of channels ``(..., N)`` are at most 1/100 of the channel's mean magnitude."""
    if not planes.size:
        return np.zeros(planes.shape, bool)
    magnitude = np.abs(planes)
    return magnitude <= _SHARE * magnitude.mean(axis=-1, keepdims=True, dtype=np.float64)

"""Values that are as good as zero: what training leaves where a colour is stuck at black."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: In means of the channel's magnitude. Formats that store levels have several next to zero; of
#: values that follow a Laplace distribution one in a hundred is as small, all of a colour never.
_SHARE = 0.01


def is_zero(planes: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which values of channels ``(..., N)`` are at most a hundredth of the mean magnitude."""
    if not planes.size:
        return np.zeros(planes.shape, bool)
    magnitude = np.abs(planes)
    return magnitude <= _SHARE * magnitude.mean(axis=-1, keepdims=True, dtype=np.float64)

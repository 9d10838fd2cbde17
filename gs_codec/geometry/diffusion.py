"""Rounding whose errors neighbours make up for: splats overlap, and their errors add up.

An encoder's choice; decoders do not know of it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.geometry.colour import NEIGHBOURS, WINDOW, find_nearest
from gs_codec.kernels import kernel

#: Share of the neighbours' errors that a Gaussian takes over.
_SHARE = 0.6


@kernel
def _diffuse(cells, values, share, levels):
    channels, count = values.shape
    near = np.zeros(NEIGHBOURS, np.int64)
    distances = np.zeros(NEIGHBOURS, np.int64)
    weights = np.zeros(NEIGHBOURS)
    window = np.empty(WINDOW)
    errors = np.zeros((count, channels), np.float32)
    for i in range(count):
        found = find_nearest(cells, i, near, distances, window)
        total = 0.0
        for k in range(found):
            weights[k] = 1.0 / (1.0 + distances[0] + distances[k])
            total += weights[k]
        for channel in range(channels):
            value = np.float64(values[channel, i])
            taken = 0.0
            for k in range(found):
                taken += weights[k] * errors[near[k], channel]
            if found > 0:
                taken = min(max(share * taken / total, -1.0), 1.0)
            level = np.floor(value + taken + 0.5)
            errors[i, channel] = value + taken - level
            levels[channel, i] = np.int64(level)


def round_diffusing(places: NDArray[np.int64], values: NDArray[np.float32]) -> NDArray[np.int64]:
    """Levels ``(C, n)`` of values ``(C, n)``, in steps, of Gaussians in stream order.

    `places` ``(3, n)``, int64, are their positions.
    """
    levels = np.empty(values.shape, np.int64)
    _diffuse(places, values, _SHARE, levels)
    return levels

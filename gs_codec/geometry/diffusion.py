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


#: Gaussians whose values are moved together, so that planes are read a cache line at a time.
_CHUNK = 64


@kernel
def _diffuse(cells, values, share, levels):
    channels, count = values.shape
    near = np.zeros(NEIGHBOURS, np.int64)
    distances = np.zeros(NEIGHBOURS, np.int64)
    weights = np.zeros(NEIGHBOURS, np.float32)
    window = np.empty(WINDOW)
    # Errors of the last Gaussians, twice what neighbours are looked for in.
    errors = np.zeros((2 * WINDOW, channels), np.float32)
    chunk = np.empty((_CHUNK, channels), np.float32)
    for first in range(0, count, _CHUNK):
        size = min(_CHUNK, count - first)
        for channel in range(channels):
            for i in range(size):
                chunk[i, channel] = values[channel, first + i]
        for i in range(size):
            found = find_nearest(cells, first + i, near, distances, window)
            total = 0.0
            for k in range(found):
                total += 1.0 / (1.0 + distances[0] + distances[k])
            for k in range(found):
                weights[k] = share / total / (1.0 + distances[0] + distances[k])
            own = errors[(first + i) % (2 * WINDOW)]
            own[:] = 0.0
            for k in range(found):
                theirs = errors[near[k] % (2 * WINDOW)]
                for channel in range(channels):
                    own[channel] += weights[k] * theirs[channel]
            for channel in range(channels):
                taken = min(max(own[channel], np.float32(-1.0)), np.float32(1.0))
                wanted = chunk[i, channel] + taken
                level = np.floor(wanted + np.float32(0.5))
                own[channel] = wanted - level
                chunk[i, channel] = level
        for channel in range(channels):
            for i in range(size):
                levels[channel, first + i] = np.int64(chunk[i, channel])


def round_diffusing(places: NDArray[np.int64], values: NDArray[np.float32]) -> NDArray[np.int64]:
    """Levels ``(C, n)`` of values ``(C, n)``, in steps, of Gaussians in stream order.

    `places` ``(3, n)``, int64, are their positions.
    """
    levels = np.empty(values.shape, np.int64)
    _diffuse(places, values, _SHARE, levels)
    return levels

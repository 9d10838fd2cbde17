"""Rounding with error diffusion to neighbours: splats overlap, and their errors add up.

Only the encoder does this; the format does not depend on it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.nearest import NEIGHBOURS, WINDOW, Nearest
from gs_codec.runtime.kernels import kernel

#: Share of the neighbours' errors that a Gaussian takes over.
_SHARE = 0.6

#: Gaussians whose values are moved together, so that planes are read a cache line at a time.
_CHUNK = 64


@kernel
def _diffuse(near, distances, values, share, levels):
    channels, count = values.shape
    # Errors of the last Gaussians: twice the window in which neighbours are found.
    errors = np.zeros((2 * WINDOW, channels), np.float32)
    chunk = np.empty((_CHUNK, channels), np.float32)
    for first in range(0, count, _CHUNK):
        size = min(_CHUNK, count - first)
        for channel in range(channels):
            for i in range(size):
                chunk[i, channel] = values[channel, first + i]
        for i in range(first, first + size):
            found = min(i, NEIGHBOURS)
            total = 0.0
            for k in range(found):
                total += 1.0 / (1.0 + distances[i, 0] + distances[i, k])
            own = errors[i % (2 * WINDOW)]
            own[:] = 0.0
            for k in range(found):
                weight = np.float32(share / total / (1.0 + distances[i, 0] + distances[i, k]))
                theirs = errors[near[i, k] % (2 * WINDOW)]
                for channel in range(channels):
                    own[channel] += weight * theirs[channel]
            row = chunk[i - first]
            for channel in range(channels):
                taken = min(max(own[channel], np.float32(-1.0)), np.float32(1.0))
                wanted = row[channel] + taken
                level = np.floor(wanted + np.float32(0.5))
                own[channel] = wanted - level
                row[channel] = level
        for channel in range(channels):
            for i in range(size):
                levels[channel, first + i] = np.int32(chunk[i, channel])


def round_diffusing(nearest: Nearest, values: NDArray[np.float32]) -> NDArray[np.int32]:
    """Round values ``(C, n)``, in steps, of Gaussians in stream order to levels ``(C, n)``."""
    levels = np.empty(values.shape, np.int32)
    _diffuse(*nearest, values, _SHARE, levels)
    return levels

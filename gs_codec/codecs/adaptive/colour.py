"""Colours in Y, Co, Cg, on lattices with different step sizes.

SH-DC is predicted in a closed loop, from decoded values of the nearest preceding points, as in
`coding.predicted_colour`; the difference is rounded to the Gaussian's own step. FORMAT.md, section
"Lattices", "Colours". SH-AC is rounded with error diffusion to neighbours, because splats overlap
and their errors add up. Only the encoder diffuses; the format does not depend on it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.contexts import ACTIVITIES, COLOUR_SHIFTS
from gs_codec.codecs.adaptive.lattice import FIXED_LIMIT
from gs_codec.codecs.adaptive.tokens import read_token
from gs_codec.coding.context_rans import BAD_VALUE, MORE_BITS, OUT_OF_WORDS, PassReader
from gs_codec.coding.nearest import NEIGHBOURS, WINDOW, Nearest
from gs_codec.coding.predicted_colour import predict, weigh
from gs_codec.runtime.kernels import kernel

#: Share of its neighbours' errors that a Gaussian compensates.
SHARE = 0.6

#: Number of Gaussians transposed together, so that planes are read a cache line at a time.
_CHUNK = 64


@kernel
def _code(near, distances, colours, unit, shifts, levels, contexts, values):
    weights = np.zeros(NEIGHBOURS, np.int64)
    for i in range(len(shifts)):
        found = min(i, NEIGHBOURS)
        weigh(distances, i, found, weights)
        step = unit << shifts[i]
        base = ACTIVITIES * min(shifts[i], COLOUR_SHIFTS - 1)
        for channel in range(3):
            mean, activity = predict(values, channel, near, i, weights, step, ACTIVITIES)
            level = (2 * (colours[channel, i] - mean) + step) // (2 * step)
            levels[i, channel] = level
            contexts[i, channel] = channel * COLOUR_SHIFTS * ACTIVITIES + base + activity
            values[channel, i] = mean + level * step


@kernel
def _read(
    words, ends, states, spans, slots, rows, bits, reached,
    near, distances, unit, shifts, values,
):  # fmt: skip
    """Decode ``values (3, n)``."""
    position, used = reached[:, 0]
    weights = np.zeros(NEIGHBOURS, np.int64)
    means, contexts = np.zeros((2, 3), np.int64)
    symbol, limit = 0, 8 * (len(bits) - MORE_BITS)
    for i in range(len(shifts)):
        if position > ends[0] or used > limit:
            return OUT_OF_WORDS
        found = min(i, NEIGHBOURS)
        weigh(distances, i, found, weights)
        step = unit << shifts[i]
        base = ACTIVITIES * min(shifts[i], COLOUR_SHIFTS - 1)
        # In a loop of its own: channels do not depend on one another, so their chains overlap.
        for channel in range(3):
            mean, activity = predict(values, channel, near, i, weights, step, ACTIVITIES)
            means[channel] = mean
            contexts[channel] = channel * COLOUR_SHIFTS * ACTIVITIES + base + activity
        for channel in range(3):
            row = rows[contexts[channel]]
            level, position, used = read_token(
                words, position, states, symbol, spans, slots, row, bits, used, True
            )
            symbol += 1
            values[channel, i] = means[channel] + level * step
            if abs(values[channel, i]) >= FIXED_LIMIT:
                return BAD_VALUE
    reached[0, 0], reached[1, 0] = position, used
    return 0


def code_colours(
    nearest: Nearest, colours: NDArray[np.int64], unit: int, shifts: NDArray[np.int64]
) -> tuple[NDArray[np.int32], NDArray[np.uint16], NDArray[np.int64]]:
    """Levels and contexts ``(n, 3)``, and decoded values ``(3, n)``, of SH-DC in stream order.

    Parameters
    ----------
    nearest : Nearest
        Neighbours by decoded positions, in half steps of the grid.
    colours : ndarray, shape (3, n), int64
        Fixed-point Y, Co, Cg.
    unit : int
    shifts : ndarray, shape (n,), int64
    """
    count = len(shifts)
    levels, contexts = np.zeros((count, 3), np.int32), np.zeros((count, 3), np.uint16)
    values = np.zeros((3, count), np.int64)
    _code(*nearest, colours, unit, shifts, levels, contexts, values)
    return levels, contexts, values


def read_colours(
    reader: PassReader,
    sections: Sequence[memoryview],
    rows: NDArray[np.uint16],
    nearest: Nearest,
    unit: int,
    shifts: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Decode the values ``(3, n)`` that `code_colours` returned.

    ``rows (contexts,)`` are table numbers; `nearest`, `unit` and ``shifts (n,)`` are the arguments
    of `code_colours`. Raises TruncatedStream or CorruptStream.
    """
    values = np.zeros((3, len(shifts)), np.int64)
    reader.decode(sections, _read, rows, *nearest, unit, shifts, values)
    return values


@kernel
def _diffuse(near, distances, values, share, levels):
    channels, count = values.shape
    # Ring buffer of the errors of recent Gaussians: twice the window of the neighbour search.
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
    """Round values ``(C, n)``, in steps and stream order, to levels, with error diffusion."""
    levels = np.empty(values.shape, np.int32)
    _diffuse(*nearest, values, SHARE, levels)
    return levels

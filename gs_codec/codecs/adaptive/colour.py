"""Closed-loop prediction of SH-DC on lattices of unequal steps, in Y, Co, Cg.

A point's colour is predicted from the nearest of those just before, as `colour` does, and the
difference is rounded to the point's own step. FORMAT.md, section "Lattices", "Colours".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.contexts import ACTIVITIES, COLOUR_SHIFTS
from gs_codec.codecs.adaptive.lattice import FRACTION_BITS, TOO_LARGE
from gs_codec.codecs.adaptive.tokens import raw_width, value_of
from gs_codec.coding.binary import code_raw
from gs_codec.coding.colour import predict, weigh
from gs_codec.coding.context_rans import PRECISION, PassReader
from gs_codec.coding.fields import BitReader
from gs_codec.coding.nearest import NEIGHBOURS, WINDOW, Nearest, find_nearest
from gs_codec.coding.rans import LANES, pull
from gs_codec.runtime.kernels import kernel

#: Values of a valid block are smaller.
_TOO_LARGE = int(TOO_LARGE) << FRACTION_BITS


@kernel
def _code(near, distances, colours, unit, shifts, levels, contexts, values):
    weights = np.zeros(NEIGHBOURS, np.int64)
    for i in range(len(shifts)):
        found = min(i, NEIGHBOURS)
        weigh(distances[i], found, weights)
        step = unit << shifts[i]
        base = ACTIVITIES * min(shifts[i], COLOUR_SHIFTS - 1)
        for channel in range(3):
            mean, activity = predict(values[channel], near[i], weights, found, step, ACTIVITIES)
            level = (2 * (colours[channel, i] - mean) + step) // (2 * step)
            levels[i, channel] = level
            contexts[i, channel] = channel * COLOUR_SHIFTS * ACTIVITIES + base + activity
            values[channel, i] = mean + level * step


@kernel
def _decode(
    cells, unit, shifts, rows, words, position, end, states, spans, slots, bits, used, values
):  # fmt: skip
    """Decode ``values (3, n)``; returns the positions reached in words (-1: too few) and bits."""
    near = np.zeros(NEIGHBOURS, np.int64)
    distances = np.zeros(NEIGHBOURS, np.int64)
    weights = np.zeros(NEIGHBOURS, np.int64)
    window = np.empty(WINDOW)
    symbol = 0
    for i in range(len(shifts)):
        if position > end:
            return -1, used
        found = find_nearest(cells, i, near, distances, window)
        weigh(distances, found, weights)
        step = unit << shifts[i]
        base = ACTIVITIES * min(shifts[i], COLOUR_SHIFTS - 1)
        for channel in range(3):
            mean, activity = predict(values[channel], near, weights, found, step, ACTIVITIES)
            row = rows[channel * COLOUR_SHIFTS * ACTIVITIES + base + activity]
            token, position = pull(
                words, position, states, symbol & (LANES - 1), spans[row], slots[row], PRECISION
            )
            symbol += 1
            rest = 0
            width = raw_width(token)
            if width:
                rest = code_raw(bits, used, width, 0, False)
                used += width
            # Clamped so that sums cannot overflow; the caller refuses values at the limit.
            value = mean + value_of(token, rest) * step
            values[channel, i] = min(max(value, -_TOO_LARGE), _TOO_LARGE)
    return position, used


def code_colours(
    nearest: Nearest, colours: NDArray[np.int64], unit: int, shifts: NDArray[np.int64]
) -> tuple[NDArray[np.int32], NDArray[np.uint16], NDArray[np.int64]]:
    """Levels and contexts ``(n, 3)``, and decoded values ``(3, n)``, of colours in stream order.

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


def decode_colours(
    cells: NDArray[np.int64],
    unit: int,
    shifts: NDArray[np.int64],
    rows: NDArray[np.int64],
    reader: PassReader,
    bits: BitReader,
) -> NDArray[np.int64]:
    """The values ``(3, n)`` that `code_colours` gave; ``rows (contexts,)`` are tables.

    Raises
    ------
    CorruptStream
        If there are fewer words than symbols.
    """
    values = np.zeros((3, len(shifts)), np.int64)
    tables = (reader.tables.spans, reader.tables.slots)
    position, bits.position = _decode(
        cells, unit, shifts, rows, reader.words, reader.position, reader.end, reader.states,
        *tables, bits.bits, bits.position, values,
    )  # fmt: skip
    reader.advance(position)
    return values

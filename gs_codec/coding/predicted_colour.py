"""Lossless predictive coder of quantised SH-DC on points in canonical order.

G, R - G and B - G are predicted from the nearest of the preceding points in Morton order. The
residuals are coded as binary decisions; their contexts depend on how much those neighbours
disagree. FORMAT.md, section "SH-DC".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.binary import (
    bit_length,
    code_integer,
    decode_binary,
    encode_binary,
    new_contexts,
)
from gs_codec.coding.nearest import NEIGHBOURS, WINDOW, find_nearest
from gs_codec.errors import CorruptStream
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.wording import counted

_MAGNITUDES = 14  # bit lengths of a residual of 12-bit colours: 0..13
_ACTIVITIES = 14
_PREVIOUS = 4
_PER_CLASS = 4 * _MAGNITUDES
_CONTEXTS = 3 * _ACTIVITIES * _PREVIOUS * _PER_CLASS


@inlined
def weigh(distances, row, found, weights):
    """Fill `weights` of the nearest points from their squared distances in one row of `distances`.

    Missing neighbours get weight 0, so that loops have a constant trip count.
    """
    # Exact because the dividend is below 2**53; float division is faster.
    wide = np.float64(256 * (distances[row, 0] + 1))
    for k in range(NEIGHBOURS):
        distance = np.float64(distances[row, k] + distances[row, 0] + 1)
        weights[k] = np.int64(wide / distance) * np.int64(k < found)


@inlined
def predict(values, channel, near, row, weights, step, activities):
    """Return the neighbours' weighted mean, and the class of their disagreement in steps."""
    total = mass = np.int64(0)
    for k in range(NEIGHBOURS):
        total += weights[k] * values[channel, near[row, k]]
        mass += weights[k]
    if mass == 0:
        return 0, 0
    # Exact: both are below 2**53, so no quotient is rounded up to an integer.
    mean = np.int64(np.floor(np.float64(2 * total + mass) / np.float64(2 * mass)))
    spread = np.int64(0)
    for k in range(NEIGHBOURS):
        spread += weights[k] * abs(values[channel, near[row, k]] - mean)
    # The bit length of the spread in quarter steps, computed without division or branches.
    activity = 0
    for length in range(activities - 1):
        activity += np.int64(4 * spread >= (mass * step) << length)
    return mean, activity


@kernel
def _walk(cells, values, coded, state, data, contexts, encoding):
    """Code `values` (G, R - G, B - G) of all points; channels with coded[c] == 0 stay 0."""
    near = np.zeros((1, NEIGHBOURS), np.int64)
    distances = np.zeros((1, NEIGHBOURS), np.int64)
    weights = np.zeros(NEIGHBOURS, np.int64)
    window = np.empty(WINDOW)
    for i in range(values.shape[1]):
        found = find_nearest(cells, i, near, distances, 0, window)
        weigh(distances, 0, found, weights)
        previous = 0
        for channel in range(3):
            if coded[channel] == 0:
                continue
            mean, activity = predict(values, channel, near, 0, weights, 1, _ACTIVITIES)
            before = min(bit_length(previous) >> 1, _PREVIOUS - 1)
            base = ((channel * _ACTIVITIES + activity) * _PREVIOUS + before) * _PER_CLASS
            residual = 0
            if encoding:
                residual = values[channel, i] - mean
            residual = code_integer(state, data, contexts, base, _MAGNITUDES, residual)
            values[channel, i] = mean + residual
            previous = abs(residual)


def encode_colour(
    cells: NDArray[np.uint32], colours: NDArray[np.uint16], depths: tuple[int, int, int]
) -> bytes:
    """Code quantised SH-DC.

    Parameters
    ----------
    cells : ndarray, shape (3, N), uint32
        Quantised positions, in canonical order.
    colours : ndarray, shape (3, N), uint16
        Quantised SH-DC of R, G, B.
    depths : tuple of int
        Bits of R, G, B; 0 for a constant channel, which is not coded.
    """
    red, green, blue = colours.astype(np.int64)
    source = np.stack([green, red - green, blue - green])
    source[1:] *= np.array([[depths[0] > 0], [depths[2] > 0]])
    cells = np.ascontiguousarray(cells)  # one memory layout: the kernel is compiled only once

    def model(state: NDArray, data: NDArray) -> None:
        values = source.copy()
        _walk(cells, values, _coded(depths), state, data, new_contexts(_CONTEXTS), True)

    return encode_binary(model, 3 * colours.shape[1])


def decode_colour(
    data: memoryview, cells: NDArray[np.uint32], depths: tuple[int, int, int], where: str
) -> NDArray[np.uint16]:
    """Invert `encode_colour`.

    Raises CorruptStream if the section's size does not match the points, or a colour is out of
    range.
    """
    values = np.zeros((3, cells.shape[1]), np.int64)

    def model(state: NDArray, stream: NDArray) -> None:
        _walk(cells, values, _coded(depths), state, stream, new_contexts(_CONTEXTS), False)

    decode_binary(model, data, where)
    green, red, blue = values
    red = red + green if depths[0] else red
    blue = blue + green if depths[2] else blue
    for channel, depth in zip((red, green, blue), depths, strict=True):
        if channel.size and (channel.min() < 0 or channel.max() >> depth):
            raise CorruptStream(f"{where}: a colour outside its {counted(depth, 'bit')}")
    return np.stack([red, green, blue]).astype(np.uint16)


def _coded(depths: tuple[int, int, int]) -> NDArray[np.int64]:
    """Which of G, R - G, B - G are coded."""
    red, green, blue = depths
    return np.array([green > 0, red > 0, blue > 0], np.int64)

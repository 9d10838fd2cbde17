"""Tables of values and of vectors, and rounding to them with the lowest error and bits.

Errors and bits are weighted as in `cells`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.formats.cells import WORTH, row_means, split_cells
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.threads import run_all

#: Maximum number of values that a table is made from.
_SAMPLE = 1 << 20

#: Number of times that prices are updated from the levels chosen with them.
_ROUNDS = 4

#: Number of levels tried on each side of the nearest.
_REACH = 5

#: Number of values per task.
_CHUNK = 1 << 12

#: Minimum step size, for division.
_TINY = 2.0**-40


def weights_of(steps: NDArray[np.floating]) -> NDArray[np.float64]:
    """Weights of squared errors for step sizes, which may be 0."""
    return np.maximum(steps.astype(np.float64), _TINY) ** -2.0


def make_table(
    values: NDArray[np.floating], steps: NDArray[np.floating], most: int = 256
) -> NDArray[np.float32]:
    """Choose 1 to `most` ascending values that approximate all values best.

    Parameters
    ----------
    values : ndarray, shape (n,)
    steps : ndarray, shape (n,)
        Units of the errors.
    """
    if not len(values):
        return np.zeros(1, np.float32)
    order = np.argsort(values, kind="stable")
    if len(order) > _SAMPLE:
        order = order[np.linspace(0, len(order) - 1, _SAMPLE).astype(np.int64)]
    known = values[order].astype(np.float32)
    weights = weights_of(steps[order])
    cells = split_cells(known[:, None], weights, most)
    table, _ = row_means(known[:, None], weights, cells.labels(), len(cells.stops))
    return np.unique(table[:, 0].astype(np.float32))


def choose_levels(
    values: NDArray[np.floating], steps: NDArray[np.floating], table: NDArray[np.floating]
) -> NDArray[np.uint8]:
    """Index in an ascending table for each value: within its step size, with few bits.

    Parameters
    ----------
    values, steps : ndarray, shape (n,)
    table : ndarray, shape (at most 256,)
    """
    wide, known = values.astype(np.float64), table.astype(np.float64)
    by_step = np.sqrt(weights_of(steps))
    levels = _nearest(wide, known)
    above = np.searchsorted(known, wide)
    for _ in range(_ROUNDS):
        counts = np.bincount(levels, minlength=len(known))
        _choose(wide, by_step, known, WORTH * label_bits(counts), above, levels)
    return levels


def choose_colours(
    values: NDArray[np.floating], steps: NDArray[np.floating], table: NDArray[np.floating]
) -> NDArray[np.uint8]:
    """Like `choose_levels`, with few bits in images that store red and blue minus green.

    Parameters
    ----------
    values : ndarray, shape (n, 3, K)
        Red, green and blue.
    steps : ndarray, shape (n, K)
    table : ndarray, shape (at most 256,)

    Returns
    -------
    ndarray, shape (n, 3, K), uint8
    """
    known = table.astype(np.float64)
    near = _nearest(values, known)
    levels, by_step = near.copy(), np.sqrt(weights_of(steps))

    def run(start: int) -> None:
        some = slice(start, start + _CHUNK)
        _choose_colours(values[some], by_step[some], known, *prices, near[some], levels[some])

    for _ in range(_ROUNDS):
        green = levels[:, 1].ravel()
        others = [levels[:, channel].ravel() - green for channel in (0, 2)]
        prices = [WORTH * label_bits(np.bincount(x, minlength=256)) for x in (green, *others)]
        run_all(run, range(0, len(values), _CHUNK))
    return levels


def _nearest(values: NDArray[np.floating], table: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.searchsorted((table[1:] + table[:-1]) / 2, values).astype(np.uint8)


def label_bits(counts: NDArray[np.integer]) -> NDArray[np.float64]:
    """Bits of each label, from its frequency; an unused label has a high price."""
    shares = np.maximum(counts, 0.5) / max(counts.sum(), 1)
    return -np.log2(shares)


@kernel
def _choose(values, by_step, table, price, near, levels):
    for i in range(len(values)):
        value, scale = values[i], by_step[i]
        best, cost = 0, np.inf
        for way in (-1, 1):
            k = near[i] if way > 0 else near[i] - 1
            while 0 <= k < len(table):
                error = (table[k] - value) * scale
                error *= error
                # Values farther away are worse by their error alone.
                if error >= cost:
                    break
                if error + price[k] < cost:
                    cost, best = error + price[k], k
                k += way
        levels[i] = best


@kernel
def _choose_colours(values, by_step, table, of_green, of_red, of_blue, near, levels):
    common = np.argmin(of_green)
    for i in range(len(values)):
        for k in range(values.shape[2]):
            red, green, blue = levels[i, 0, k], levels[i, 1, k], levels[i, 2, k]
            least = np.inf
            for j in range(2 * _REACH + 2):
                g = near[i, 1, k] + _offset(j) if j <= 2 * _REACH else common
                if not 0 <= g < len(table):
                    continue
                error = (table[g] - values[i, 1, k]) * by_step[i, k]
                cost = error * error + of_green[g]
                if cost >= least:
                    continue
                r, more = _level_of(
                    g, near[i, 0, k], values[i, 0, k], by_step[i, k], table, of_red, least - cost
                )
                cost += more
                if r < 0:
                    continue
                b, more = _level_of(
                    g, near[i, 2, k], values[i, 2, k], by_step[i, k], table, of_blue, least - cost
                )
                cost += more
                if b >= 0 and cost < least:
                    red, green, blue = r, g, b
                    least = cost
            levels[i, 0, k], levels[i, 1, k], levels[i, 2, k] = red, green, blue


@kernel
def _level_of(green, near, value, by_step, table, price, least):
    """The level of another channel, and its cost; -1 if none costs less than `least`."""
    best = np.int64(-1)
    for j in range(2 * _REACH + 2):
        level = near + _offset(j) if j <= 2 * _REACH else green
        if not 0 <= level < len(table):
            continue
        error = (table[level] - value) * by_step
        error *= error
        if error < least:
            cost = error + price[(level - green) & 255]
            if cost < least:
                least, best = cost, level
    return best, least


@inlined
def _offset(j):
    """Offsets of the levels tried around the nearest: powers of two, the least first."""
    return (1 << ((j - 1) >> 1)) * (1 if j & 1 else -1) if j else 0

"""Tables of values and of vectors, and rounding to them with the lowest error and bits.

Errors and bits are weighted as in `cells`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gs_codec.formats.cells import WORTH, row_means, split_cells
from gs_codec.formats.packed_values import spans
from gs_codec.runtime.arrays import empty
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.threads import run_all

#: Maximum number of values that are sorted to make a table.
_SORTED = 1 << 22

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
    weights = empty(steps.shape, np.float64)
    np.maximum(steps, _TINY, out=weights, dtype=np.float64)
    weights **= -2.0
    return weights


def every(size: int) -> slice:
    """Every k-th value of `size`, so that at most `_SORTED` are sorted."""
    return slice(None, None, max(-(-size // _SORTED), 1))


def make_table(
    values: NDArray[np.floating], steps: NDArray[np.floating], most: int = 256
) -> NDArray[np.float32]:
    """Choose 1 to `most` ascending values that approximate all values best.

    Parameters
    ----------
    values : ndarray, shape (n,) or (C, n)
    steps : ndarray, shape (n,) or that of `values`
        Units of the errors.
    """
    if not values.size:
        return np.zeros(1, np.float32)
    some = every(values.size)
    steps = np.broadcast_to(steps, values.shape)[..., some].ravel()
    values = values[..., some].ravel()
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
    count, known, by_step = len(values), table.astype(np.float64), _by_step(steps)
    levels, above = empty((count,), np.uint8), empty((count,), np.uint16)
    for some in spans(count):
        levels[some] = _nearest(values[some], known)
        above[some] = np.searchsorted(known, values[some])
    for _ in range(_ROUNDS):
        price = _price(levels.__getitem__, count, len(known))
        for some in spans(count):
            wide = values[some].astype(np.float64)
            _choose(wide, by_step[some], known, price, above[some], levels[some])
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
    count, known, by_step = len(values), table.astype(np.float64), _by_step(steps)
    near, levels = empty(values.shape, np.uint8), empty(values.shape, np.uint8)
    for some in spans(count):
        near[some] = levels[some] = _nearest(values[some], known)

    def run(start: int) -> None:
        some = slice(start, start + _CHUNK)
        _choose_colours(values[some], by_step[some], known, *prices, near[some], levels[some])

    stored = (
        lambda some: levels[some, 1],
        lambda some: levels[some, 0] - levels[some, 1],
        lambda some: levels[some, 2] - levels[some, 1],
    )
    for _ in range(_ROUNDS):
        prices = [_price(of_channel, count, 256) for of_channel in stored]
        run_all(run, range(0, count, _CHUNK))
    return levels


def _by_step(steps: NDArray[np.floating]) -> NDArray[np.float64]:
    """Inverse step sizes."""
    weights = weights_of(steps)
    return np.sqrt(weights, out=weights)


def _price(
    levels_of: Callable[[slice], NDArray[np.uint8]], count: int, size: int
) -> NDArray[np.float64]:
    """Price of each of `size` levels, from the levels of spans of `count` values."""
    frequencies = np.zeros(size, np.int64)
    for some in spans(count):
        frequencies += np.bincount(levels_of(some).ravel(), minlength=size)
    return WORTH * label_bits(frequencies)


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

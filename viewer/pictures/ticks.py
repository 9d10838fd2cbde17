"""Round values for the marks of scales and axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Steps of a linear scale, and the factors between marks of a logarithmic one, times powers of ten.
_STEPS = (1, 1.5, 2, 2.5, 3, 4, 5, 6, 8)
_FACTORS = (2, 3, 4, 5, 6, 8, 10, 20, 50, 100, 1000)

#: Digits of a logarithmic axis, from many to few.
_DIGITS = ((1, 2, 5), (1, 3), (1,))

#: Marks of a scale.
MARKS = 5


def scale_marks(low: float, high: float, scale: str) -> NDArray[np.float64]:
    """`MARKS` round values, evenly spaced on a linear or logarithmic scale, around a range.

    Parameters
    ----------
    low, high : float
        Both above 0 if `scale` is ``log``.
    scale : {"linear", "log"}
    """
    steps = np.arange(MARKS)
    if scale == "log":
        power = 10.0 ** np.floor(np.log10(low))
        first = max(digit * power for digit in (1, 2, 5) if digit * power <= low * _MORE)
        tries = [first * float(factor) ** steps for factor in (*_FACTORS, 10.0**75)]
    else:
        step = 10.0 ** np.floor(np.log10((high - low or 1.0) / MARKS))
        sizes = [k * ten * step for ten in (1, 10, 100) for k in _STEPS]
        tries = [size * (np.floor(low / size + _LESS) + steps) for size in sizes]
    return next((marks for marks in tries if marks[-1] * _MORE >= high), tries[-1])


def axis_ticks(low: float, high: float, most: int, log: bool = False) -> NDArray[np.float64]:
    """At most so many round values within a range; logarithms of round values if `log`."""
    if log:
        powers = np.arange(np.floor(low), np.ceil(high) + 1)
        for digits in _DIGITS:
            ticks = np.sort(np.add.outer(powers, np.log10(digits)).ravel())
            ticks = ticks[(ticks >= low) & (ticks <= high)]
            if 2 <= len(ticks) <= most:
                return ticks
        if len(ticks) > most:
            return ticks[:: -(-len(ticks) // most)]
        return np.log10(axis_ticks(10.0**low, 10.0**high, most))
    step = 10.0 ** np.floor(np.log10((high - low) / most))
    for size in (k * ten * step for ten in (1, 10) for k in (1, 2, 5)):
        first, last = np.ceil(low / size - _LESS), np.floor(high / size + _LESS)
        if last - first < most:
            return size * np.arange(first, last + 1) + 0.0  # not -0
    return np.array([low, high])


#: Rounding errors that are passed over: of values, and of numbers of steps.
_MORE, _LESS = 1 + 1e-9, 1e-9

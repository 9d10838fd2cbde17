"""Round values for marks on scales and axes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

#: Steps and first marks of linear scales, and factors between marks of logarithmic ones, times
#: powers of ten.
_STEPS = (1, 1.5, 2, 2.5, 3, 4, 5, 6, 8)
_FACTORS = (1.5, 2, 2.5, 3, 4, 5, 6, 8, 10, 20, 50, 100, 1000, 10.0**75)

#: Digits on a logarithmic axis, from many to few.
_DIGITS = ((1, 2, 5), (1, 3), (1,))

#: Number of marks on a scale.
MARKS = 5

#: Minimum number of marks on a logarithmic scale.
LEAST = 3

#: Minimum share of a logarithmic scale that the range should fill.
_FILLED = 0.7


def scale_marks(low: float, high: float, scale: str) -> NDArray[np.float64]:
    """Round values, evenly spaced on a linear or logarithmic scale, that enclose a range.

    There are `MARKS` values; fewer, but at least `LEAST`, on a logarithmic scale that would
    otherwise be much wider than the range.

    Parameters
    ----------
    low, high : float
        Both above 0 if `scale` is ``log``.
    scale : {"linear", "log"}
    """
    if scale == "log":
        return _log_marks(low, high)
    step = 10.0 ** np.floor(np.log10((high - low or 1.0) / MARKS))
    sizes = [k * ten * step for ten in (1, 10, 100) for k in _STEPS]
    candidates = [size * (np.floor(low / size + _LESS) + np.arange(MARKS)) for size in sizes]
    return next((marks for marks in candidates if marks[-1] * _MORE >= high), candidates[-1])


def _log_marks(low: float, high: float) -> NDArray[np.float64]:
    power = 10.0 ** np.floor(np.log10(low))
    firsts = [step * power for step in reversed(_STEPS) if step * power <= low * _MORE]
    for count in range(MARKS, LEAST - 1, -1):
        candidates = [first * float(k) ** np.arange(count) for first in firsts for k in _FACTORS]
        around = [marks for marks in candidates if marks[-1] * _MORE >= high and _is_round(marks)]
        found = min(around, key=lambda marks: round(marks[-1] / marks[0], 6))
        if np.log(high / low) >= _FILLED * np.log(found[-1] / found[0]):
            break
    return found


def _is_round(marks: NDArray[np.float64]) -> bool:
    """Whether three digits show all marks exactly."""
    return np.allclose(marks, [float(f"{mark:.3g}") for mark in marks], rtol=_LESS, atol=0)


def axis_ticks(low: float, high: float, most: int, log: bool = False) -> NDArray[np.float64]:
    """At most `most` round values within a range; logarithms of round values if `log`."""
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


def texts_of(values: Sequence[float], step: float) -> list[str]:
    """Values with the fewest digits, at least three, that are exact to a hundredth of a step."""
    for digits in range(3, 18):
        texts = [f"{value:.{digits}g}" for value in values]
        pairs = zip(texts, values, strict=True)
        if not any(abs(float(text) - value) > step / 100 for text, value in pairs):
            break
    return texts


#: Tolerance factor for rounding errors of values.
_MORE = 1 + 1e-9

#: Tolerance for rounding errors of step counts.
_LESS = 1e-9

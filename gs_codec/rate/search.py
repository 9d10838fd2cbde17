"""Search for the coarseness of steps at which a measure meets its limit."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

from scipy.optimize import brentq

#: Log2 of the finest and of the coarsest steps tried, over those of the profile.
FINEST, COARSEST = -6.0, 6.0

#: Where in its interval a measure is aimed at.
_AIM = 0.7

#: How far `expected` looks from a place at most.
_FARTHEST = 2.0

#: How far the next place is taken, as a share of the way a line points; and the least of it.
_BEYOND, _LEAST_STEP = 1.25, 0.02

#: How near to each other places are told apart; and, in such, where else a measure that is rough
#: there is tried.
_NARROW = 1e-3
_BESIDE = (3, -3, 6, -6, 9, -9, 12, -12)

#: Measures below this are not told apart.
_LEAST = 1e-6


def expected(value: float, low: float, high: float, place: float, slope: float) -> float:
    """Where a measure that is `value` at a place would be well within its interval."""
    aim = (1 - _AIM) * low + _AIM * high
    reach = math.log2(max(aim, _LEAST) / max(value, _LEAST)) / slope
    return min(max(place + min(max(reach, -_FARTHEST), _FARTHEST), FINEST), COARSEST)


class _Met(Exception):
    """The measure is in its interval; holds where."""


def search(
    measure: Callable[[float], float], low: float, high: float, start: float, slope: float
) -> float | None:
    """Log2 of a coarseness at which `measure` of it is from `low` to `high`.

    Parameters
    ----------
    measure : callable
        Falls or grows all the way from `FINEST` to `COARSEST`.
    low, high : float
    start : float
        Where to begin.
    slope : float
        About how much log2 of the measure changes with each doubling of the coarseness.

    Returns
    -------
    float or None
        The last place that was measured. Where the measure jumps over the interval, there and
        beside, that of the highest value below it; None where it never comes so far.
    """
    aim = math.log2(max((1 - _AIM) * low + _AIM * high, _LEAST))
    below: dict[float, float] = {}

    @cache
    def height(place: float) -> float:
        value = measure(place)
        if low <= value <= high:
            raise _Met(place)
        if value < low:
            below[value] = place
        return math.log2(max(value, _LEAST)) - aim

    try:
        bracket = _bracket(height, min(max(start, FINEST), COARSEST), slope)
        if bracket is not None:
            place = brentq(height, *bracket, xtol=_NARROW)
            for shift in _BESIDE:
                height(min(max(place + shift * _NARROW, FINEST), COARSEST))
            place = below[max(below)]
            measure(place)
            return place
    except _Met as met:
        return float(met.args[0])
    return None


def _bracket(
    height: Callable[[float], float], start: float, slope: float
) -> tuple[float, float] | None:
    """Places between which the height changes its sign; None where it does not."""
    found = height(start)
    before, reach = start, -found / slope
    while True:
        place = min(max(start + reach, FINEST), COARSEST)
        if place == before:
            return None
        value = height(place)
        if value * found < 0:
            return before, place
        # On to beyond where a line through both points to, or as far again, if that is nearer.
        line = (value - found) / (place - start)
        further = abs(_BEYOND * value / line) if line * slope > 0 else math.inf
        further = min(max(further, _LEAST_STEP), abs(reach))
        before, reach = place, reach + math.copysign(further, reach)

"""Search for the coarseness at which a measurement is inside an interval."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

#: Log2 of the smallest coarseness that is tried.
FINEST = -6.0

#: Log2 of the largest coarseness that is tried.
COARSEST = 6.0

#: Target of the search within the interval, 0 to 1.
_AIM = 0.7

#: Maximum change of log2 of the coarseness that `_expected` returns.
_FARTHEST = 2.0

#: Factor on the distance to the secant's root, to overshoot it.
_BEYOND = 1.25

#: Minimum step of the search, log2.
_LEAST_STEP = 0.02

#: Resolution of the search, log2; and the offsets, in units of it, of further points that are tried
#: if the measurement is noisy.
_NARROW = 1e-3
_BESIDE = (3, -3, 6, -6, 9, -9, 12, -12)

#: Lower bound of measurements.
_LEAST = 1e-6

#: Colours are refitted again if the coarseness changes by more than this, log2.
_RECOLOUR_AGAIN = 0.05
_MOST_RECOLOURINGS = 5


class _Met(Exception):
    """The measurement is inside its interval; the argument is log2 of the coarseness."""


def search(
    measure: Callable[[float], float], low: float, high: float, start: float, slope: float
) -> float | None:
    """Find log2 of a coarseness at which `measure` is from `low` to `high`.

    Parameters
    ----------
    measure : callable
        A monotonic function of log2 of the coarseness, from `FINEST` to `COARSEST`.
    low, high : float
    start : float
        Log2 of the coarseness to start at.
    slope : float
        Approximate change of log2 of the measurement when the coarseness doubles.

    Returns
    -------
    float or None
        Log2 of the coarseness measured last. If the measurement jumps over the interval, that of
        the highest value below it. None if the interval is never reached.
    """
    aim = math.log2(max((1 - _AIM) * low + _AIM * high, _LEAST))
    below: dict[float, float] = {}

    @cache
    def height(octaves: float) -> float:
        value = measure(octaves)
        if low <= value <= high:
            raise _Met(octaves)
        if value < low:
            below[value] = octaves
        return math.log2(max(value, _LEAST)) - aim

    try:
        bracket = _bracket(height, min(max(start, FINEST), COARSEST), slope)
        if bracket is not None:
            octaves = _root(height, *bracket)
            for shift in _BESIDE:
                height(min(max(octaves + shift * _NARROW, FINEST), COARSEST))
            octaves = below[max(below)]
            measure(octaves)
            return octaves
    except _Met as met:
        return float(met.args[0])
    return None


def _root(height: Callable[[float], float], before: float, now: float) -> float:
    """A point within `_NARROW` of a sign change of `height` (Brent 1973, chapter 4)."""
    last, at_last = before, height(before)
    at_before, at_now = at_last, height(now)
    step = step_before = now - before
    while True:
        if at_before * at_now < 0:
            last, at_last = before, at_before
            step = step_before = now - before
        if abs(at_last) < abs(at_now):
            before, now, last = now, last, now
            at_before, at_now, at_last = at_now, at_last, at_now
        least, half = _NARROW / 2, (last - now) / 2
        if at_now == 0 or abs(half) < least:
            return now
        tried = math.inf
        if abs(step_before) > least and abs(at_now) < abs(at_before):
            slope = (at_before - at_now) / (before - now)
            if before == last:  # linear interpolation
                tried = -at_now / slope
            else:  # inverse quadratic interpolation
                chord = (at_last - at_now) / (last - now)
                tried = -at_now * (at_last * chord - at_before * slope)
                tried /= chord * slope * (at_last - at_before)
        if 2 * abs(tried) < min(abs(step_before), 3 * abs(half) - least):
            step_before, step = step, tried
        else:
            step_before = step = half
        before, at_before = now, at_now
        now += step if abs(step) > least else math.copysign(least, half)
        at_now = height(now)


def _bracket(
    height: Callable[[float], float], start: float, slope: float
) -> tuple[float, float] | None:
    """Two points between which `height` changes sign; None if it does not."""
    found = height(start)
    before, reach = start, -found / slope
    while True:
        octaves = min(max(start + reach, FINEST), COARSEST)
        if octaves == before:
            return None
        value = height(octaves)
        if value * found < 0:
            return before, octaves
        # Overshoot the root of the secant, but at most double the distance from the start.
        line = (value - found) / (octaves - start)
        further = abs(_BEYOND * value / line) if line * slope > 0 else math.inf
        further = min(max(further, _LEAST_STEP), abs(reach))
        before, reach = octaves, reach + math.copysign(further, reach)


def search_recoloured(
    recolour: Callable[[float], None],
    measure: Callable[[float], float],
    interval: tuple[float, float],
    start: float,
    slope: float,
) -> float | None:
    """Like `search`, with colours refitted for approximately the final step sizes."""
    octaves = start
    for _ in range(_MOST_RECOLOURINGS):
        recolour(octaves)
        value = measure(octaves)
        if interval[0] <= value <= interval[1]:
            return octaves
        following = _expected(value, *interval, octaves, slope)
        if following == octaves:
            return None
        moved, octaves = abs(following - octaves), following
        if moved <= _RECOLOUR_AGAIN:
            break
    return search(measure, *interval, octaves, slope)


def _expected(value: float, low: float, high: float, octaves: float, slope: float) -> float:
    """Log2 of the coarseness predicted to move a measurement from `value` into its interval."""
    aim = (1 - _AIM) * low + _AIM * high
    reach = math.log2(max(aim, _LEAST) / max(value, _LEAST)) / slope
    return min(max(octaves + min(max(reach, -_FARTHEST), _FARTHEST), FINEST), COARSEST)

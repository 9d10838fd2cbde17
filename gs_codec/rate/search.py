"""Search for the coarseness at which a measurement is inside an interval, by trial encodings."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.decode import decode_as
from gs_codec.codecs.encode import code_shaped, encode_scene, shape_scene
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.config import EGS, AdaptiveProfile, Config, RateTarget
from gs_codec.guidance.guide import Guidance, Shaped, guide
from gs_codec.preparation.reference_views import ReferenceViews, ViewSplit
from gs_codec.report import EncodeReport, Progress, RateReport, RenderedLoss, StageTimes
from gs_codec.scene import Scene

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
_SHIFTS = (3, -3, 6, -6, 9, -9, 12, -12)

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
            for shift in _SHIFTS:
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


@dataclass(frozen=True)
class Seen:
    """Views, and the mean squared errors of the held-out ones ``(views,)`` before encoding.

    `check` measures instead of the held-out views, if it is given and can.
    """

    views: ViewSplit
    before: NDArray[np.float64]
    progress: Progress | None
    check: Callable[[Scene], RenderedLoss | None] | None = None

    def loss(self, coded: Scene) -> float:
        """PSNR loss of a decoded scene, dB."""
        if self.check is not None and (found := self.check(coded)) is not None:
            return found.loss
        measured = self.views.held_out
        return measured.drop(measured.errors(coded, self.progress), self.before)


@dataclass
class RateSearch:
    """A rate target, and the time and encodings spent on it so far.

    Without `references`, the encoder is camera-free. `limit` (bytes) is None if the target is a
    loss; a loss needs `seen`.
    """

    config: Config
    target: RateTarget
    limit: int | None
    references: ReferenceViews | None
    seen: Seen | None
    progress: Progress | None
    times: StageTimes = field(default_factory=StageTimes)
    encodings: int = 0


@dataclass
class Trials:
    """Trial encodings of a scene, with the most recently refitted colours.

    Attributes
    ----------
    scene : Scene
        As given.
    job : RateSearch
    guidance : Guidance or None
    coloured : Scene
        The scene with the most recently refitted colours.
    octaves : float
        Log2 of the coarseness of `last`.
    last : tuple
        File and report of the last encoding.
    loss : float or None
        PSNR loss of `last`, dB; None if it was not measured.
    compacting : bool
        Whether `refit` compacts SH first.
    predicted_bytes, predicted_drop : number or None
        As in `RateReport`.
    at_end : bool
        Whether the target is out of reach for any step sizes.
    """

    scene: Scene
    job: RateSearch
    guidance: Guidance | None = field(init=False, default=None)
    coloured: Scene = field(init=False)
    octaves: float = 0.0
    last: tuple[bytes, EncodeReport] = field(init=False)
    loss: float | None = None
    compacting: bool = True
    predicted_bytes: int | None = None
    predicted_drop: float | None = None
    at_end: bool = False

    def __post_init__(self) -> None:
        self.coloured = self.scene
        if self.job.references is not None:
            with self.job.times.stage("views"):
                self.guidance = guide(self.scene, self.job.references, self.job.progress)

    @property
    def rounds_jointly(self) -> bool:
        """Whether `finish` rounds values jointly."""
        return self.guidance is not None and self.job.config.adaptive_profile().looks > 0

    def config_at(self, octaves: float) -> Config:
        """The configuration at a coarseness, log2."""
        return replace(self.job.config, coarseness=2.0**octaves)

    def size(self, octaves: float) -> int:
        """Encode with the current colours; return the file's size, bytes."""
        config = self.config_at(octaves)
        with self.job.times.stage("search"):
            steps = None
            if self.guidance is not None:
                steps = self.guidance.steps(config.adaptive_profile())
            self.last = encode_scene(self.coloured, config, self.job.progress, steps)
        self.octaves = octaves
        self.job.encodings += 1
        return len(self.last[0])

    def finish(self, octaves: float) -> int:
        """Like `size`, with values rounded jointly, which takes longer; see `rounds_jointly`."""
        assert self.guidance is not None
        config, progress = self.config_at(octaves), self.job.progress
        profile = config.adaptive_profile()
        with self.job.times.stage("round"):
            steps = self.guidance.steps(profile)
            shaped = shape_scene(self.coloured, config, steps, StageTimes(), progress)
            shaped = self.guidance.round(shaped, profile)
            parts, report = code_shaped(shaped, StageTimes(), progress)
        self.last = b"".join(parts), replace(report, coarseness=config.coarseness)
        self.octaves = octaves
        self.job.encodings += 1
        return len(self.last[0])

    def compact(self, octaves: float) -> None:
        """Compact SH for steps of this coarseness, without deciding whether it pays off."""
        self._recolour(octaves, lambda guidance, *to: guidance.compact(*to, decide=False))

    def settle(self, octaves: float) -> None:
        """Like `compact`, but first decide, once, whether compaction pays off."""
        self._recolour(octaves, lambda guidance, *to: guidance.compact(*to))

    def refit(self, octaves: float) -> None:
        """Compact and refit SH for steps of this coarseness."""
        self._recolour(octaves, lambda guidance, *to: guidance.recolour(*to, self.compacting))

    def _recolour(
        self, octaves: float, choose: Callable[[Guidance, Shaped, AdaptiveProfile], Scene]
    ) -> None:
        assert self.guidance is not None
        config = self.config_at(octaves)
        profile = config.adaptive_profile()
        with self.job.times.stage("recolour"):
            steps = self.guidance.steps(profile)
            shaped = shape_scene(self.scene, config, steps, StageTimes(), self.job.progress)
            shaped = shaped.with_colours(choose(self.guidance, shaped, profile))
        self.coloured = shaped.source
        self.job.encodings += 1

    def rate_report(self, pruned: int) -> RateReport:
        """Report how the last encoding met the target, with `pruned` Gaussians removed."""
        data = self.last[0]
        return RateReport(
            self.job.target,
            2.0**self.octaves,
            self._steps(),
            len(data),
            self.predicted_bytes,
            self.loss,
            self.predicted_drop,
            self.job.encodings,
            pruned,
            self.at_end,
        )

    def _steps(self) -> dict[str, tuple[float, float]]:
        """Finest and coarsest step size of each pass of an `.egs`."""
        if self.job.config.format != EGS:
            return {}
        passes = inspect_bytes(self.last[0]).passes
        return {each.name: (each.finest_step, each.coarsest_step) for each in passes}

    def decoded(self) -> Scene:
        """The scene of the last encoding."""
        return decode_as(self.job.config, self.last[0], self.job.progress)

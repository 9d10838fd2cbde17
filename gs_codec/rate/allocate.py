"""Rate control: one number, the price of an error in bits, decides all steps of a scene.

Profiles `l`, `m` and `s` give each parameter of each Gaussian the step at which it adds the same
error, so that a bit saves as much wherever it is spent. What is left to choose is that error:
the coarseness of all steps together.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.codec import decode_scene, encode_scene
from gs_codec.codec.clean import clean_scene
from gs_codec.codec.lattice_encode import shape_scene
from gs_codec.config import LATTICE_PROFILES, Config, Target
from gs_codec.errors import InvalidInput
from gs_codec.inspection import inspect_bytes
from gs_codec.preparation.guide import Colours, Guidance, guide
from gs_codec.preparation.leave_one_out import leave_one_out
from gs_codec.preparation.prune import keep_highest
from gs_codec.preparation.targets import Targets, Views
from gs_codec.rate.search import COARSEST, FINEST, expected, search
from gs_codec.report import EncodeReport, Progress, RateReport, StageTimes, step_counter
from gs_codec.scene import Scene

#: A size is met from below by at most this share.
_SIZE_TOLERANCE = 0.02

#: A loss is met from below by at most this, dB.
_DROP_TOLERANCE = 0.02

#: Log2 of a size, and of a loss, for each doubling of the steps; about.
_SIZE_SLOPE, _DROP_SLOPE = -0.45, 1.7

#: What SH compaction, and then the refit of colours, make of a file's size, about: for the first
#: guess.
_COMPACTION_SAVES, _REFIT_ADDS = 1.08, 1.01

#: Colours are chosen again if the steps have moved by more than this, log2.
_RECOLOUR_AGAIN = 0.05
_MOST_RECOLOURINGS = 5

#: Share of the Gaussians that goes at once, where some may, and how often.
_PART, _MOST_PARTS = 0.2, 10


@dataclass(frozen=True)
class Seen:
    """What is to be seen in views of a scene.

    Attributes
    ----------
    views : Views
        A quality is measured in those held out.
    before : ndarray, shape (views,)
        Mean squared errors in these at which nothing is lost.
    progress : callable, optional
        Is told of each view that is measured.
    """

    views: Views
    before: NDArray[np.float64]
    progress: Progress | None = None

    def loss(self, data: bytes) -> float:
        """Decibels that a file loses."""
        measured = self.views.held_out
        return measured.drop(measured.errors(decode_scene(data), self.progress), self.before)


def encode_to_target(
    scene: Scene,
    config: Config,
    target: Target,
    limit: int | None,
    targets: Targets | None = None,
    seen: Seen | None = None,
    progress: Progress | None = None,
) -> tuple[bytes, EncodeReport]:
    """Encode a scene with steps as coarse or fine as a target asks.

    Parameters
    ----------
    scene : Scene
    config : Config
        Of profile ``l``, ``m`` or ``s``; where the search begins.
    target : Target
    limit : int or None
        Its most bytes, if it is a size.
    targets : Targets, optional
        What views should look like; without them steps follow from attributes.
    seen : Seen, optional
        A quality, and pruning, need it.
    progress : callable, optional

    Raises
    ------
    InvalidInput
        If the profile has no steps to choose, or the target is out of reach: with what is in.
    """
    check_searchable(scene, config)
    if seen is None and (limit is None or target.allow_prune):
        raise InvalidInput("target: a quality, or pruning, needs views")
    clean, changed = clean_scene(scene, config)
    times = StageTimes()
    if seen is not None and target.allow_prune:
        met, encodings = _meet_pruning(clean, config, target, limit, targets, seen, times, progress)
    else:
        met = _meet(_begin(clean, config, targets, times, progress), target, limit, seen, 0.0)
        encodings = met.trials.number
    data, report = met.trials.last
    steps = {i.name: (i.finest_step, i.coarsest_step) for i in inspect_bytes(data).passes}
    rate = RateReport(
        target,
        2.0**met.trials.place,
        steps,
        len(data),
        met.predicted_bytes,
        met.trials.loss,
        met.predicted_drop,
        encodings,
        clean.count - met.trials.scene.count,
        met.at_end,
    )
    return data, replace(report, **changed, seconds=times.seconds, rate=rate)


def check_searchable(scene: Scene, config: Config) -> None:
    """Check that there are steps to choose.

    Raises
    ------
    InvalidInput
    """
    if config.profile not in LATTICE_PROFILES:
        known = ", ".join(LATTICE_PROFILES)
        raise InvalidInput(f"target: profile '{config.profile}' has fixed steps, {known} have not")
    if not scene.count:
        raise InvalidInput("target: the scene has no Gaussians")


class _OutOfReach(InvalidInput):
    """No steps meet a target."""


class _TooLarge(_OutOfReach):
    """Nor is any file small enough; of fewer Gaussians one may be."""


@dataclass
class _Trials:
    """Encodings of a scene, whose colours are those refitted last.

    Attributes
    ----------
    scene : Scene
        As given.
    config : Config
    guidance : Guidance or None
    times : StageTimes
    coloured : Scene
        With the colours chosen last.
    place : float
        Log2 of the coarseness of `last`.
    last : tuple
        File and report of the last encoding.
    number : int
        How many there were, those for colours included.
    loss : float or None
        Decibels that views lose by `last`, where that was measured.
    compacting : bool
        Whether `refit` compacts SH first.
    """

    scene: Scene
    config: Config
    guidance: Guidance | None
    times: StageTimes
    coloured: Scene = field(init=False)
    place: float = 0.0
    last: tuple[bytes, EncodeReport] = field(init=False)
    number: int = 0
    loss: float | None = None
    compacting: bool = True

    def __post_init__(self) -> None:
        self.coloured = self.scene

    def config_at(self, place: float) -> Config:
        return replace(self.config, coarseness=2.0**place)

    def size(self, place: float) -> int:
        """Encode, colours as they are; the bytes of the file."""
        config = self.config_at(place)
        with self.times.stage("search"):
            steps = None
            if self.guidance is not None:
                steps = self.guidance.steps(self.coloured, config.resolved_lattice())
            self.last = encode_scene(self.coloured, config, steps=steps)
        self.place = place
        self.number += 1
        return len(self.last[0])

    def compact(self, place: float) -> None:
        """Let views choose which SH are left, for steps as coarse: about, a part of `refit`."""
        self._recolour(place, lambda colours, *shaped: colours.sketch(*shaped))

    def settle(self, place: float) -> None:
        """As `compact`, once it is asked whether views tell enough for that, which then holds."""
        self._recolour(place, lambda colours, *shaped: colours.compact(*shaped))

    def refit(self, place: float) -> None:
        """Let views choose colours for steps as coarse."""

        def both(colours: Colours, decoded: Scene, *steps: Any) -> Scene:
            if self.compacting:
                decoded = colours.compact(decoded, *steps)
            return colours.refit(decoded)

        self._recolour(place, both)

    def _recolour(self, place: float, choose: Callable[..., Scene]) -> None:
        assert self.guidance is not None
        config = self.config_at(place)
        profile = config.resolved_lattice()
        with self.times.stage("recolour"):
            steps = self.guidance.steps(self.scene, profile)
            shaped = shape_scene(self.scene, config, steps, StageTimes())
            asked = (shaped.decoded(), shaped.order, shaped.sh_steps(), profile)
            shaped = shaped.with_colours(choose(self.guidance.colours, *asked))
        self.coloured = shaped.arranged.source
        self.number += 1


@dataclass(frozen=True)
class _Met:
    """Trials of which the last meets a target, and what was expected of it.

    `at_end` tells that there are no steps that would come nearer to the target.
    """

    trials: _Trials
    predicted_bytes: int | None = None
    predicted_drop: float | None = None
    at_end: bool = False


def _meet_pruning(
    scene: Scene,
    config: Config,
    target: Target,
    limit: int | None,
    targets: Targets | None,
    seen: Seen,
    times: StageTimes,
    progress: Progress | None,
) -> tuple[_Met, int]:
    """Meet a target with as many Gaussians as leave the least error, or the smallest file.

    They go a part at a time, by leave-one-out error, as long as each part pays. How many encodings
    that took is told too.
    """
    renders = seen.views.renders
    best: _Met | None = None
    refused: _OutOfReach | None = None
    least, place, encodings = math.inf, 0.0, 0
    for part in range(1, _MOST_PARTS + 1):
        trials = _begin(scene, config, targets, times, progress)
        try:
            met = _meet(trials, target, limit, seen, place)
        except _OutOfReach as refusal:
            refused, cost = refusal, math.inf
            if not isinstance(refusal, _TooLarge):
                break
        else:
            data = trials.last[0]
            cost = len(data) if limit is None else seen.loss(data)
            place = trials.place
        finally:
            encodings += trials.number
        if cost < least:
            best, least = met, cost
        elif best is not None:
            break
        removed = int(_PART * scene.count)
        if not removed:
            break
        with times.stage("prune"):
            advance = step_counter(progress, f"leave-one-out, part {part}", len(renders.cameras))
            scores = leave_one_out(scene, renders.cameras, renders.background, advance)
            scene = scene.take(keep_highest(scores, removed))
    if best is None:
        assert refused is not None
        raise refused
    return best, encodings


def _begin(
    scene: Scene,
    config: Config,
    targets: Targets | None,
    times: StageTimes,
    progress: Progress | None,
) -> _Trials:
    """Trials of a scene, of which there were none yet."""
    guidance = None
    if targets is not None:
        with times.stage("views"):
            guidance = guide(scene, targets, progress)
    return _Trials(scene, config, guidance, times)


def _meet(
    trials: _Trials, target: Target, limit: int | None, seen: Seen | None, start: float
) -> _Met:
    """Meet a target with all Gaussians of a scene."""
    if limit is not None:
        return _meet_size(trials, limit, start)
    assert seen is not None
    return _meet_drop(trials, float(target.psnr_drop or 0), seen)


def _meet_size(trials: _Trials, limit: int, start: float) -> _Met:
    """Search for steps at which the file is as large as it may be."""
    interval = ((1 - _SIZE_TOLERANCE) * limit, float(limit))
    predicted = None
    if trials.guidance is not None:
        # Colours as they are, then compaction, are quick, and tell most of what all will take.
        before = interval[0] / _REFIT_ADDS, interval[1] / _REFIT_ADDS
        plain = before[0] * _COMPACTION_SAVES, before[1] * _COMPACTION_SAVES
        search(trials.size, *plain, start, _SIZE_SLOPE)
        _search_recoloured(trials.compact, trials.size, before, trials.place, _SIZE_SLOPE)
        trials.settle(trials.place)
        if not before[0] <= trials.size(trials.place) <= before[1]:
            # It does not pay there, and so is left out.
            _search_recoloured(trials.compact, trials.size, before, trials.place, _SIZE_SLOPE)
        predicted, start = round(len(trials.last[0]) * _REFIT_ADDS), trials.place
    recolour = None if trials.guidance is None else trials.refit
    found = _search_recoloured(recolour, trials.size, interval, start, _SIZE_SLOPE)
    if found is None:
        least, most = (trials.size(end) for end in (COARSEST, FINEST))
        if most > limit:
            kind = _TooLarge if least > limit else _OutOfReach
            raise kind(f"target {limit:,} bytes: {least:,} to {most:,} bytes are in reach")
    return _Met(trials, predicted, at_end=found is None)


def _meet_drop(trials: _Trials, wanted: float, seen: Seen) -> _Met:
    """Search for steps at which views lose as much as they may."""
    measured, before = seen.views.held_out, float(np.mean(seen.before))

    def drop(place: float) -> float:
        trials.size(place)
        trials.loss = seen.loss(trials.last[0])
        return trials.loss

    allowed = measured.error_for(wanted, before) - before
    at_once = trials.config_at(0.0).resolved_lattice().error
    start = min(max(0.5 * math.log2(allowed / at_once), FINEST), COARSEST)
    interval = (wanted - _DROP_TOLERANCE, wanted)
    found = _search_recoloured(trials.refit, drop, interval, start, _DROP_SLOPE)
    if found is None:
        # Compaction may cost the views held out more than that, however weak it is.
        trials.compacting = False
        found = _search_recoloured(trials.refit, drop, interval, start, _DROP_SLOPE)
    if found is None:
        least, most = (drop(end) for end in (FINEST, COARSEST))
        if most > wanted:
            raise _OutOfReach(f"target {wanted:g} dB: {least:.4f} to {most:.4f} dB are in reach")
    predicted = measured.drop(before + at_once * 4.0**trials.place, before)
    return _Met(trials, None, predicted, at_end=found is None)


def _search_recoloured(
    recolour: Callable[[float], None] | None,
    measure: Callable[[float], float],
    interval: tuple[float, float],
    start: float,
    slope: float,
) -> float | None:
    """`search`, with colours for steps about as coarse as are found."""
    place = start
    for _ in range(_MOST_RECOLOURINGS):
        if recolour is None:
            break
        recolour(place)
        value = measure(place)
        if interval[0] <= value <= interval[1]:
            return place
        following = expected(value, *interval, place, slope)
        if following == place:
            return None
        moved, place = abs(following - place), following
        if moved <= _RECOLOUR_AGAIN:
            break
    return search(measure, *interval, place, slope)

"""Rate control: one number, the coarseness, scales all step sizes of a scene.

Profiles `l`, `m` and `s` give each parameter of each Gaussian the step size at which it adds the
same error, so that one more bit reduces the error equally everywhere. The coarseness sets that
error.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.codecs.adaptive.encode import ShapedScene, shape_scene
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.coding.clean import clean_scene
from gs_codec.config import ADAPTIVE_PROFILES, AdaptiveProfile, Config, RateTarget
from gs_codec.errors import InvalidInput
from gs_codec.guidance.guide import Guidance, guide
from gs_codec.guidance.search import COARSEST, FINEST, search, search_recoloured
from gs_codec.preparation.pipeline import choose_views, guiding_views
from gs_codec.preparation.prune import keep_highest, leave_one_out
from gs_codec.preparation.reference_views import ReferenceViews, ViewSplit
from gs_codec.preparation.steps import Plan
from gs_codec.report import EncodeReport, Progress, RateReport, StageTimes
from gs_codec.scene import Scene

#: A file may be smaller than asked for by at most this share.
_SIZE_TOLERANCE = 0.02

#: A loss may be smaller than asked for by at most this, dB.
_DROP_TOLERANCE = 0.02

#: Approximate change of log2 of the size, and of the loss, when the steps double.
_SIZE_SLOPE, _DROP_SLOPE = -0.45, 1.7

#: For the first guess: about how many times smaller SH compaction makes a file, and then how many
#: times larger the refit of colours makes it.
_COMPACTION_SAVES, _REFIT_ADDS = 1.08, 1.01

#: Share of the Gaussians that a round of pruning removes, and the largest number of rounds.
_PART, _MOST_PARTS = 0.2, 10


@dataclass(frozen=True)
class _Seen:
    """Views, and the mean squared errors of the held-out ones ``(views,)`` before encoding."""

    views: ViewSplit
    before: NDArray[np.float64]
    progress: Progress | None

    def loss(self, data: bytes) -> float:
        """PSNR loss of a file in the held-out views, dB."""
        measured = self.views.held_out
        return measured.drop(measured.errors(decode_scene(data), self.progress), self.before)


def encode_to_target(
    scene: Scene,
    original: Scene,
    ply_bytes: int,
    config: Config,
    target: RateTarget,
    plan: Plan | None = None,
    progress: Progress | None = None,
    views: ViewSplit | None = None,
) -> tuple[bytes, EncodeReport]:
    """Encode a scene at the coarseness that meets a target, which is relative to the original.

    With a plan, its views guide the step sizes. A loss in dB is measured in the held-out views,
    against ground-truth images if there are any. Without a plan, a loss in dB or pruning uses views
    that are chosen from the scene. `views` are the plan's, if they are known.

    Raises
    ------
    InvalidInput
        If the profile has fixed steps, or the target is unreachable; the error gives the range.
    """
    if config.profile not in ADAPTIVE_PROFILES:
        known = ", ".join(ADAPTIVE_PROFILES)
        raise InvalidInput(f"target: profile '{config.profile}' has fixed steps, expected {known}")
    if not scene.count:
        raise InvalidInput("target: the scene has no Gaussians")
    limit = target.limit(original.count, ply_bytes)
    seen = references = None
    if limit is None or target.allow_prune:
        plan = plan or Plan()
        views = views or choose_views(original, plan, progress)
        seen = _Seen(views, views.held_out.errors(original, progress), progress)
    if plan is not None:
        known_views = None if views is None else views.renders
        references = guiding_views(scene, plan, progress, known_views)
    clean, changed = clean_scene(scene, config)
    asked = _Search(config, target, limit, references, seen, progress)
    if seen is not None and target.allow_prune:
        trials = _meet_pruning(clean, asked, seen)
    else:
        trials = _begin(clean, asked)
        _meet(trials, 0.0)
    data, report = trials.last
    rate = _rate_report(trials, clean.count - trials.scene.count)
    return data, replace(report, **changed, seconds=asked.times.seconds, rate=rate)


def _rate_report(trials: _Trials, pruned: int) -> RateReport:
    data = trials.last[0]
    return RateReport(
        trials.asked.target,
        2.0**trials.octaves,
        {i.name: (i.finest_step, i.coarsest_step) for i in inspect_bytes(data).passes},
        len(data),
        trials.predicted_bytes,
        trials.loss,
        trials.predicted_drop,
        trials.asked.encodings,
        pruned,
        trials.at_end,
    )


class _OutOfReach(InvalidInput):
    """No steps meet a target."""


class _TooLarge(_OutOfReach):
    """All files are too large; with fewer Gaussians one may be small enough."""


@dataclass
class _Search:
    """What is asked for, and the time and encodings that it has taken.

    Without `references` the encoder is camera-free; `limit` (bytes) is None if the target is a
    loss, which needs `seen`.
    """

    config: Config
    target: RateTarget
    limit: int | None
    references: ReferenceViews | None
    seen: _Seen | None
    progress: Progress | None
    times: StageTimes = field(default_factory=StageTimes)
    encodings: int = 0


@dataclass
class _Trials:
    """Trial encodings of a scene, with the colours that were refitted last.

    Attributes
    ----------
    scene : Scene
        As given.
    asked : _Search
    guidance : Guidance or None
    coloured : Scene
        The scene with the colours refitted last.
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
        Whether no steps come nearer to the target.
    """

    scene: Scene
    asked: _Search
    guidance: Guidance | None
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

    def config_at(self, octaves: float) -> Config:
        return replace(self.asked.config, coarseness=2.0**octaves)

    def size(self, octaves: float) -> int:
        """Encode with the current colours; return the file's size, bytes."""
        config = self.config_at(octaves)
        with self.asked.times.stage("search"):
            steps = None
            if self.guidance is not None:
                steps = self.guidance.steps(self.coloured, config.adaptive_profile())
            self.last = encode_scene(self.coloured, config, steps=steps)
        self.octaves = octaves
        self.asked.encodings += 1
        return len(self.last[0])

    def compact(self, octaves: float) -> None:
        """Compact SH for steps of this coarseness, without deciding whether it pays."""
        self._recolour(octaves, lambda guidance, *to: guidance.compact(*to, decide=False))

    def settle(self, octaves: float) -> None:
        """As `compact`, but decide first whether compaction pays; the decision is kept."""
        self._recolour(octaves, lambda guidance, *to: guidance.compact(*to))

    def refit(self, octaves: float) -> None:
        """Compact and refit SH for steps of this coarseness."""
        self._recolour(octaves, lambda guidance, *to: guidance.recolour(*to, self.compacting))

    def _recolour(
        self, octaves: float, choose: Callable[[Guidance, ShapedScene, AdaptiveProfile], Scene]
    ) -> None:
        assert self.guidance is not None
        config = self.config_at(octaves)
        profile = config.adaptive_profile()
        with self.asked.times.stage("recolour"):
            steps = self.guidance.steps(self.scene, profile)
            shaped = shape_scene(self.scene, config, steps, StageTimes())
            shaped = shaped.with_colours(choose(self.guidance, shaped, profile))
        self.coloured = shaped.arranged.source
        self.asked.encodings += 1


def _meet_pruning(scene: Scene, asked: _Search, seen: _Seen) -> _Trials:
    """Meet a target with the number of Gaussians that gives the least loss, or the smallest file.

    Each round removes the Gaussians of lowest leave-one-out error, as long as this pays.
    """
    best: _Trials | None = None
    refused: _OutOfReach | None = None
    least, octaves = math.inf, 0.0
    for part in range(1, _MOST_PARTS + 1):
        trials = _begin(scene, asked)
        try:
            _meet(trials, octaves)
        except _OutOfReach as refusal:
            refused, cost = refusal, math.inf
            if not isinstance(refusal, _TooLarge):
                break
        else:
            data = trials.last[0]
            cost = len(data) if asked.limit is None else seen.loss(data)
            octaves = trials.octaves
        if cost < least:
            best, least = trials, cost
        elif best is not None:
            break
        removed = int(_PART * scene.count)
        if not removed:
            break
        with asked.times.stage("prune"):
            scores = leave_one_out(scene, seen.views.renders, f"part {part}", asked.progress)
            scene = scene.take(keep_highest(scores, removed))
    if best is None:
        assert refused is not None
        raise refused
    return best


def _begin(scene: Scene, asked: _Search) -> _Trials:
    """New trials of a scene, with guidance from its reference views if there are any."""
    guidance = None
    if asked.references is not None:
        with asked.times.stage("views"):
            guidance = guide(scene, asked.references, asked.progress)
    return _Trials(scene, asked, guidance)


def _meet(trials: _Trials, start: float) -> None:
    """Meet the target with all Gaussians of a scene; the search begins at `start` octaves."""
    asked = trials.asked
    if asked.limit is not None:
        _meet_size(trials, asked.limit, start)
    else:
        assert asked.seen is not None
        _meet_drop(trials, float(asked.target.psnr_drop or 0), asked.seen)


def _meet_size(trials: _Trials, limit: int, start: float) -> None:
    """Search for steps at which the file is just within the limit."""
    interval = ((1 - _SIZE_TOLERANCE) * limit, float(limit))
    if trials.guidance is None:
        found = search(trials.size, *interval, start, _SIZE_SLOPE)
    else:
        # Current colours, then compacted ones, are quick and give most of the final size.
        before = interval[0] / _REFIT_ADDS, interval[1] / _REFIT_ADDS
        plain = before[0] * _COMPACTION_SAVES, before[1] * _COMPACTION_SAVES
        search(trials.size, *plain, start, _SIZE_SLOPE)
        search_recoloured(trials.compact, trials.size, before, trials.octaves, _SIZE_SLOPE)
        trials.settle(trials.octaves)
        if not before[0] <= trials.size(trials.octaves) <= before[1]:
            # Compaction does not pay at these steps, so it is left out.
            search_recoloured(trials.compact, trials.size, before, trials.octaves, _SIZE_SLOPE)
        trials.predicted_bytes = round(len(trials.last[0]) * _REFIT_ADDS)
        start = trials.octaves
        found = search_recoloured(trials.refit, trials.size, interval, start, _SIZE_SLOPE)
    if found is None:
        least, most = (trials.size(end) for end in (COARSEST, FINEST))
        if most > limit:
            kind = _TooLarge if least > limit else _OutOfReach
            raise kind(f"target {limit:,} bytes: {least:,} to {most:,} bytes are in reach")
    trials.at_end = found is None


def _meet_drop(trials: _Trials, limit: float, seen: _Seen) -> None:
    """Search for steps at which the loss of views is just within the limit."""
    measured, before = seen.views.held_out, float(np.mean(seen.before))

    def drop(octaves: float) -> float:
        trials.size(octaves)
        trials.loss = seen.loss(trials.last[0])
        return trials.loss

    allowed = measured.error_for(limit, before) - before
    at_once = trials.config_at(0.0).adaptive_profile().error
    start = min(max(0.5 * math.log2(allowed / at_once), FINEST), COARSEST)
    interval = (limit - _DROP_TOLERANCE, limit)
    found = search_recoloured(trials.refit, drop, interval, start, _DROP_SLOPE)
    if found is None:
        # Compaction may cost held-out views more than the limit, even at its weakest.
        trials.compacting = False
        found = search_recoloured(trials.refit, drop, interval, start, _DROP_SLOPE)
    if found is None:
        least, most = (drop(end) for end in (FINEST, COARSEST))
        if most > limit:
            raise _OutOfReach(f"target {limit:g} dB: {least:.4f} to {most:.4f} dB are in reach")
    trials.predicted_drop = measured.drop(before + at_once * 4.0**trials.octaves, before)
    trials.at_end = found is None

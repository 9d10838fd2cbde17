"""Rate control: one number, the coarseness, scales all step sizes of a scene.

Profiles `l`, `m` and `s` give each parameter of each Gaussian the step size at which it adds the
same error, so that one more bit reduces the error equally everywhere. The coarseness sets that
error.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gs_codec.coding.clean import clean_scene
from gs_codec.config import Config, RateTarget
from gs_codec.errors import InvalidInput
from gs_codec.preparation.balance import ADDED, StepError
from gs_codec.preparation.prune import keep_highest, leave_one_out
from gs_codec.preparation.reference_views import ViewSplit
from gs_codec.rate.search import (
    COARSEST,
    FINEST,
    RateSearch,
    Seen,
    Trials,
    search,
    search_recoloured,
)
from gs_codec.report import EncodeReport, Progress
from gs_codec.scene import Scene

#: A file may be smaller than the target by at most this share.
_SIZE_TOLERANCE = 0.02

#: A loss may be smaller than the target by at most this, in dB.
_DROP_TOLERANCE = 0.02

#: Approximate change of log2 of the size when step sizes double.
_SIZE_SLOPE = -0.45

#: Approximate change of log2 of the loss when step sizes double.
_DROP_SLOPE = 1.7

#: Approximate factor by which SH compaction shrinks a file, for the first guess.
_COMPACTION_SAVES = 1.08

#: Approximate factor by which refitting colours then enlarges it.
_REFIT_ADDS = 1.01

#: Factor by which joint rounding may enlarge it further; and the change of log2 of the coarseness
#: if that is still too much.
_ROUNDING_ADDS = 1.004
_NUDGE = 0.01

#: Maximum number of joint roundings to meet a loss. They end earlier within `_DROP_TOLERANCE` of
#: the target, or above this share of it: then a file is about `_SIZE_TOLERANCE` too large.
_MOST_ROUNDINGS = 3
_CLOSE = (1 - _SIZE_TOLERANCE) ** (-_DROP_SLOPE / _SIZE_SLOPE)

#: Share of the Gaussians that a round of pruning removes.
_PART = 0.2

#: Maximum number of these rounds.
_MOST_PARTS = 10


def meet_rate(scene: Scene, job: RateSearch) -> tuple[bytes, EncodeReport]:
    """Encode a scene cleaned by `clean_scene` at the coarseness that meets a target.

    Raises InvalidInput if the target is unreachable; the error gives the range.
    """
    if job.seen is not None and job.target.allow_prune:
        trials = _meet_pruning(scene, job, job.seen)
    else:
        trials = Trials(scene, job)
        _meet(trials, 0.0)
    data, report = trials.last
    rate = trials.rate_report(scene.count - trials.scene.count)
    return data, replace(report, seconds=job.times.seconds, rate=rate)


def step_error_for(
    scene: Scene,
    ply_bytes: int,
    config: Config,
    target: RateTarget,
    views: ViewSplit,
    progress: Progress | None = None,
) -> StepError:
    """The error of the step sizes that would meet a target with a pruned scene; see `Balance`."""
    limit = target.limit(scene.count, ply_bytes)
    if limit is None:
        references = views.references
        before = references.error(scene, progress)
        allowed = references.error_for(float(target.psnr_drop or 0), before) - before
        return lambda size, left: max(allowed - left, 0.0) / ADDED
    clean, _ = clean_scene(scene, config)
    guiding = None if views.renders.origin == "anywhere" else views.renders
    trials = Trials(clean, RateSearch(config, target, limit, guiding, None, progress))
    if guiding is not None:
        trials.compact(0.0)
    whole = trials.size(0.0)

    def error(size: float, left: float) -> float:
        octaves = math.log2(limit / (whole * size)) / _SIZE_SLOPE
        profile = replace(config, coarseness=2.0 ** min(max(octaves, FINEST), COARSEST))
        return profile.adaptive_profile().error

    return error


class OutOfReach(InvalidInput):
    """No step sizes meet a target."""


class _TooLarge(OutOfReach):
    """All files are too large, but one with fewer Gaussians may be small enough."""


def _meet_pruning(scene: Scene, job: RateSearch, seen: Seen) -> Trials:
    """Meet a target with the number of Gaussians that gives the lowest loss, or the smallest file.

    Each round removes the Gaussians of lowest leave-one-out error, as long as this pays off.
    """
    best: Trials | None = None
    refused: OutOfReach | None = None
    least, octaves = math.inf, 0.0
    for part in range(1, _MOST_PARTS + 1):
        trials = Trials(scene, job)
        try:
            _meet(trials, octaves)
        except OutOfReach as refusal:
            refused, cost = refusal, math.inf
            if not isinstance(refusal, _TooLarge):
                break
        else:
            size = len(trials.last[0])
            cost = size if job.limit is None else seen.loss(trials.decoded())
            octaves = trials.octaves
        if cost < least:
            best, least = trials, cost
        elif best is not None:
            break
        removed = int(_PART * scene.count)
        if not removed:
            break
        with job.times.stage("prune"):
            scores = leave_one_out(scene, seen.views.renders, f"part {part}", job.progress)
            scene = scene.take(keep_highest(scores, removed))
    if best is None:
        assert refused is not None
        raise refused
    return best


def _meet(trials: Trials, start: float) -> None:
    """Meet the target with all Gaussians of a scene; the search starts at `start` octaves."""
    job = trials.job
    if job.limit is not None:
        _meet_size(trials, job.limit, start)
    else:
        assert job.seen is not None
        _meet_drop(trials, float(job.target.psnr_drop or 0), job.seen)


def _meet_size(trials: Trials, limit: int, start: float) -> None:
    """Search for step sizes at which the file is just within the limit."""
    interval = ((1 - _SIZE_TOLERANCE) * limit, float(limit))
    if trials.guidance is None:
        found = search(trials.size, *interval, start, _SIZE_SLOPE)
    else:
        # Encoding current colours, then compacted ones, is quick and predicts most of the final
        # size.
        before = interval[0] / _REFIT_ADDS, interval[1] / _REFIT_ADDS
        plain = before[0] * _COMPACTION_SAVES, before[1] * _COMPACTION_SAVES
        search(trials.size, *plain, start, _SIZE_SLOPE)
        search_recoloured(trials.compact, trials.size, before, trials.octaves, _SIZE_SLOPE)
        trials.settle(trials.octaves)
        if not before[0] <= trials.size(trials.octaves) <= before[1]:
            # Compaction does not pay off at these step sizes, so it is skipped.
            search_recoloured(trials.compact, trials.size, before, trials.octaves, _SIZE_SLOPE)
        trials.predicted_bytes = round(len(trials.last[0]) * _REFIT_ADDS)
        start = trials.octaves
        aimed = (interval[0], interval[1] / (_ROUNDING_ADDS if trials.rounds_jointly else 1))
        found = search_recoloured(trials.refit, trials.size, aimed, start, _SIZE_SLOPE)
        if found is not None and trials.rounds_jointly:
            _round_to_size(trials, limit, found)
    if found is None:
        least, most = (trials.size(end) for end in (COARSEST, FINEST))
        if most > limit:
            kind = _TooLarge if least > limit else OutOfReach
            raise kind(_beyond(trials.job.target, limit, least, most))
    trials.at_end = found is None


def _round_to_size(trials: Trials, limit: int, octaves: float) -> None:
    """Round jointly, with coarser steps if the file is otherwise above a limit, bytes."""
    while trials.finish(octaves) > limit:
        if octaves == COARSEST:
            trials.size(octaves)
            break
        octaves = min(octaves + _NUDGE, COARSEST)


def _beyond(target: RateTarget, limit: int, least: int, most: int) -> str:
    """Message that a size in bytes is out of reach, in the units of the target."""
    if target.ratio is not None:
        wanted, unit = f"{target.ratio:g}", "x"
        ends = [f"{target.ratio * limit / size:.4g}" for size in (most, least)]
    elif target.bits is not None:
        wanted, unit = f"{target.bits:g}", " bits per Gaussian"
        ends = [f"{target.bits * size / limit:.4g}" for size in (least, most)]
    else:
        wanted, unit = f"{limit:,}", " bytes"
        ends = [f"{size:,}" for size in (least, most)]
    return f"target {wanted}{unit}: unreachable, expected {ends[0]} to {ends[1]}{unit}"


def _meet_drop(trials: Trials, limit: float, seen: Seen) -> None:
    """Search for step sizes at which the loss of views is just within the limit."""
    measured, before = seen.views.held_out, float(np.mean(seen.before))

    def drop(octaves: float) -> float:
        if trials.guidance is not None:
            # Colours refitted for other quantised shapes are worse than unrefitted ones.
            trials.refit(octaves)
        trials.size(octaves)
        trials.loss = seen.loss(trials.decoded())
        return trials.loss

    allowed = measured.error_for(limit, before) - before
    at_once = trials.config_at(0.0).adaptive_profile().error
    start = min(max(0.5 * math.log2(allowed / at_once), FINEST), COARSEST)
    interval = (limit - _DROP_TOLERANCE, limit)
    found = search(drop, *interval, start, _DROP_SLOPE)
    if found is None and trials.guidance is not None:
        # Compaction may cost held-out views more than the limit, even at its lowest strength.
        trials.compacting = False
        found = search(drop, *interval, start, _DROP_SLOPE)
    if found is None:
        least, most = (drop(end) for end in (FINEST, COARSEST))
        if most > limit:
            raise OutOfReach(
                f"target {limit:g} dB: unreachable, expected {least:.4f} to {most:.4f} dB"
            )
    else:
        _round_within(trials, limit, seen)
    trials.predicted_drop = measured.drop(before + at_once * 4.0**trials.octaves, before)
    trials.at_end = found is None


def _round_within(trials: Trials, limit: float, seen: Seen) -> None:
    """Round jointly at the steps with which views should then lose just less than a limit.

    The loss of small scenes depends irregularly on step sizes and rounding, so about the smallest
    file within the limit is kept, which may be that of the last encoding.
    """
    if not trials.rounds_jointly:
        return
    best, octaves = (trials.last, trials.loss, trials.octaves), trials.octaves
    least = max(_CLOSE * limit, limit - _DROP_TOLERANCE)
    aim = (least + limit) / 2
    # Crops from other places gain too little from rounding to expect it.
    left = trials.config_at(octaves).adaptive_profile().left if seen.check is None else 1.0
    loss = float(trials.loss or 0) * left
    for _ in range(_MOST_ROUNDINGS):
        if not least <= loss <= limit:
            further = math.log2(aim / min(max(loss, aim / 2), 2 * aim)) / _DROP_SLOPE
            octaves = min(max(octaves + further, FINEST), COARSEST)
            trials.refit(octaves)
        trials.finish(octaves)
        loss = seen.loss(trials.decoded())
        if loss <= limit and len(trials.last[0]) < _ROUNDING_ADDS * len(best[0][0]):
            best = trials.last, loss, octaves
        if least <= loss <= limit:
            break
    trials.last, trials.loss, trials.octaves = best

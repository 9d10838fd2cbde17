"""The order of preparation steps."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.quantise import CentredQuantiser, fit_centred
from gs_codec.config import Config
from gs_codec.plan import AS_MANY_AS_PAY, Plan, Steps
from gs_codec.preparation.balance import ADDED, Balance, StepsOf, profile_steps
from gs_codec.preparation.compact_sh import compact_sh
from gs_codec.preparation.optimise import optimise
from gs_codec.preparation.prepare_report import LABELS, PrepareReport, StepReport, centres_checksum
from gs_codec.preparation.prune import (
    importance,
    keep_highest,
    keep_near,
    portion,
    prune_leave_one_out,
)
from gs_codec.preparation.reference_views import ViewSplit
from gs_codec.preparation.refit_colour import refit_colour
from gs_codec.preparation.view_selection import choose_views
from gs_codec.rendering.gsplat_backend import is_chosen
from gs_codec.report import Progress
from gs_codec.scene import Scene

log = logging.getLogger(__name__)

#: Iterations of refinement that pay off: looks at each image that it fits, and a minimum
#: (bench/LAB_NOTEBOOK.md).
_LOOKS = 15
_LEAST = 2000

#: What a step returns: the indices of the remaining Gaussians (None: all), the new scene, and
#: details for the report.
_Outcome = tuple[NDArray[np.int64] | None, Scene, dict[str, Any]]


class _Context(NamedTuple):
    """What the steps need besides the scene: options, views, and where to report progress."""

    plan: Plan
    views: ViewSplit
    progress: Progress | None
    steps_of: StepsOf


def prepare_scene(
    scene: Scene,
    plan: Plan,
    progress: Progress | None = None,
    steps_of: StepsOf | None = None,
    *,
    keep_pruned: bool = False,
) -> tuple[Scene, PrepareReport]:
    """Run the steps of a plan on a scene; if refinement is rejected, those of `without_refinement`.

    `steps_of` returns the step sizes that decide how much a balanced plan prunes; by default those
    of profile `m`. With `keep_pruned`, a scene whose refinement is rejected stays pruned for it.
    Raises InvalidInput if there are no cameras, no Gaussian would be left, or an image is damaged.
    Raises MissingTool if refinement needs a device, and there is none.
    """
    if plan.steps.refine:
        is_chosen(plan.device)
    chosen = steps_of or profile_steps(Config())
    prepared, report = _run(scene, plan, progress, chosen)
    if report.rejected and not keep_pruned:
        plan = without_refinement(plan)
        prepared, report = _run(scene, plan, progress, chosen, report.rejected)
    return prepared, report


def without_refinement(plan: Plan) -> Plan:
    """A plan without refinement, and thus without the pruning that only refinement makes pay."""
    return replace(plan, steps=replace(plan.steps, refine=0), checkpoint=None)


def _run(
    scene: Scene,
    plan: Plan,
    progress: Progress | None,
    steps_of: StepsOf,
    rejected: StepReport | None = None,
) -> tuple[Scene, PrepareReport]:
    """Run the steps of a plan on a scene; report a step that was rejected before in its place."""
    views = choose_views(scene, plan, progress)
    if plan.steps.refine == AS_MANY_AS_PAY:
        assert views.targets is not None
        iterations = max(_LEAST, _LOOKS * len(views.targets.cameras))
        plan = replace(plan, steps=replace(plan.steps, refine=iterations))
    context = _Context(plan, views, progress, steps_of)
    kept, centres = np.arange(scene.count), centres_checksum(scene.positions)
    labels = np.zeros(scene.count, np.uint8)
    reports = [_report("original", scene, context, 0.0, {})]
    for step in _STEPS:
        if rejected is not None and step.name == rejected.name:
            last, seconds = reports[-1], rejected.seconds
            reports.append(replace(last, name=step.name, seconds=seconds, details=rejected.details))
        if not step.is_wanted(plan.steps):
            continue
        start = time.perf_counter()
        stay, scene, details = step.run(scene, context)
        seconds = time.perf_counter() - start
        if stay is not None:
            gone = np.ones(len(kept), bool)
            gone[stay] = False
            labels[kept[gone]] = LABELS.index(step.label)
            kept = kept[stay]
        reports.append(_report(step.name, scene, context, seconds, details))
    views = views._replace(targets=None)
    report = PrepareReport(
        labels, tuple(reports), views, sh_degree=scene.sh_degree, centres=centres
    )
    if plan.steps.refine and not report.rejected:
        # Images of the input no longer guide anything, and take much memory.
        renders = replace(views.renders, images=())
        report = replace(report, views=ViewSplit(renders, None, views.held_out))
    return scene, report


def _report(
    name: str, scene: Scene, context: _Context, seconds: float, details: dict[str, Any]
) -> StepReport:
    quality = context.views.held_out.quality(scene, context.progress)
    return StepReport(name, scene.count, scene.float_bytes, quality, seconds, details)


def _prune_importance(scene: Scene, context: _Context) -> _Outcome:
    scores = importance(scene, context.views.renders.cameras, context.progress)
    stay = keep_highest(scores, portion(scene.count, context.plan.steps.prune_importance))
    return stay, scene.take(stay), {}


def _prune_geometry(scene: Scene, context: _Context) -> _Outcome:
    steps = context.plan.steps
    stay = keep_near(scene, steps.prune_geometry, steps.geometry_rule)
    return stay, scene.take(stay), {}


def _prune_loo(scene: Scene, context: _Context) -> _Outcome:
    views, steps, progress = context.views, context.plan.steps, context.progress
    balance = None
    if steps.balanced:
        fits_photographs, error = views.photographs is not None, context.steps_of(views)
        balance = Balance(scene, views.renders, fits_photographs, steps.refine, error, progress)
    stay, details = prune_leave_one_out(scene, views, steps, progress, balance)
    if balance is not None:
        # Mean squared error of the step sizes that need no pruning.
        details["unpruned"] = ADDED * balance.step_error(1.0, 0.0)
    return stay, scene.take(stay), details


def _optimise(scene: Scene, context: _Context) -> _Outcome:
    plan, targets = context.plan, context.views.targets
    assert targets is not None
    fitted, details = optimise(
        scene, targets, plan.steps.refine, plan.checkpoint, context.progress, plan.device
    )
    if plan.steps.keep_refined:
        return None, fitted, details
    against = (
        _against(scene, fitted, context) if details["iterations"] else "there is nothing to gain"
    )
    if against:
        log.warning("refine: skipped, because %s", against)
        return None, scene, {**details, "left_out": True}
    return None, fitted, details


def _against(scene: Scene, fitted: Scene, context: _Context) -> str | None:
    """The reason to reject a refined scene because of its held-out views, if any."""
    held_out, progress = context.views.held_out, context.progress
    before, after = (held_out.errors(each, progress) for each in (scene, fitted))
    lost = held_out.drop(after, before)
    return f"held-out views would lose {lost:.3f} dB" if lost > 0 else None


def _compact(scene: Scene, context: _Context) -> _Outcome:
    cameras, strength = context.views.renders.cameras, context.plan.steps.compact_sh
    compact, details = compact_sh(scene, cameras, strength, progress=context.progress)
    return None, compact, details


def _refit(scene: Scene, context: _Context) -> _Outcome:
    steps = context.plan.steps
    fitted, report = refit_colour(
        scene,
        context.views.renders,
        steps.refit_colour,
        strength=steps.compact_sh,
        # SH-AC that training left at 0 may have to compensate for removed Gaussians.
        keep_zeros=steps.compact_sh > 0,
        progress=context.progress,
    )
    psnr = [value if np.isfinite(value) else None for value in report.psnr]
    return None, fitted, {"psnr": psnr, "kept": report.kept}


def _rectify(scene: Scene, context: _Context) -> _Outcome:
    """Clip each SH-AC channel to its Laplace range; see `fit_centred`."""
    clipped = scene.f_rest.copy()
    for row in clipped:
        quantiser, _ = fit_centred(row[np.isfinite(row)], 1, context.plan.steps.rectify)
        if isinstance(quantiser, CentredQuantiser):
            centre, reach = quantiser.centre, quantiser.half_range
            np.clip(row, centre - reach, centre + reach, out=row)
    moved = int(np.count_nonzero(clipped != scene.f_rest))
    return None, replace(scene, f_rest=clipped), {"moved": moved}


class _Step(NamedTuple):
    """A step: its name, when it runs, its function, and the label of the Gaussians it removes."""

    name: str
    is_wanted: Callable[[Steps], bool]
    run: Callable[[Scene, _Context], _Outcome]
    label: str = ""


#: All steps, in the order they run.
_STEPS = (
    _Step("importance pruning", lambda s: s.prune_importance > 0, _prune_importance, "importance"),
    _Step("geometry pruning", lambda s: s.prune_geometry > 0, _prune_geometry, "geometry"),
    _Step(
        "leave-one-out pruning",
        attrgetter("by_leave_one_out"),
        _prune_loo,
        "leave-one-out",
    ),
    _Step("rectification", lambda s: s.rectify > 0, _rectify),
    _Step("optimisation", lambda s: s.refine > 0, _optimise),
    _Step("SH compaction", lambda s: s.compact_sh > 0, _compact),
    _Step("colour refit", lambda s: s.refit_colour > 0, _refit),
)

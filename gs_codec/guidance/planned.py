"""Encoding with cameras, or to a rate target."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from gs_codec.codecs.adaptive.encode import encode_shaped, shape_scene
from gs_codec.codecs.encode import encode_scene
from gs_codec.coding.clean import clean_scene
from gs_codec.config import ADAPTIVE_PROFILES, Config, RateTarget, as_rate_target
from gs_codec.report import EncodeReport, Progress, StageTimes
from gs_codec.runtime.threads import using_threads
from gs_codec.scene import Scene

if TYPE_CHECKING:
    from gs_codec.preparation.reference_views import ReferenceViews, ViewSplit
    from gs_codec.preparation.steps import Plan


def encode_by_plan(
    scene: Scene,
    ply_bytes: int,
    config: Config,
    plan: Plan | None = None,
    rate: RateTarget | Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> tuple[bytes, EncodeReport]:
    """Encode a scene, of `ply_bytes` uncompressed, as `encode` and `encode_file` do.

    Raises
    ------
    InvalidInput
        If there are no cameras, nothing would be left, or the rate cannot be reached.
    """
    views, original = None, scene
    if plan is not None and plan.steps.wanted:
        from gs_codec.preparation.pipeline import prepare_scene

        scene, prepared = prepare_scene(scene, plan, progress, config=config)
        views = prepared.views
    if rate is not None:
        target = as_rate_target(rate)
        return encode_at_rate(scene, original, ply_bytes, config, target, plan, progress, views)
    targets = None if views is None else views.renders
    return encode_planned(scene, config, plan, progress, targets)


def encode_at_rate(
    scene: Scene,
    original: Scene,
    ply_bytes: int,
    config: Config,
    rate: RateTarget,
    plan: Plan | None = None,
    progress: Progress | None = None,
    views: ViewSplit | None = None,
) -> tuple[bytes, EncodeReport]:
    """Encode a scene to a rate target, which is relative to the original.

    With a plan, its views guide the step sizes. A loss in dB is measured in the held-out views,
    against ground-truth images if there are any. Without a plan, a loss in dB or pruning uses views
    that are chosen from the scene. `views` are the plan's, if they are known.

    Raises
    ------
    InvalidInput
        If the target is unreachable, or the profile has fixed steps.
    """
    from gs_codec.guidance.allocate import Seen, check_searchable, encode_to_target

    check_searchable(scene, config)
    limit = rate.limit(original.count, ply_bytes)
    if plan is None and (limit is None or rate.allow_prune):
        from gs_codec.preparation.steps import Plan

        plan = Plan()
    if plan is None:
        return encode_to_target(scene, config, rate, limit)
    seen = None
    if limit is None or rate.allow_prune:
        from gs_codec.preparation.pipeline import choose_views

        views = views or choose_views(original, plan, progress)
        seen = Seen(views, views.held_out.errors(original, progress), progress)
    targets = reference_views_of(
        scene, plan, progress, views.renders if views is not None else None
    )
    return encode_to_target(scene, config, rate, limit, targets, seen, progress)


def encode_planned(
    scene: Scene,
    config: Config,
    plan: Plan | None,
    progress: Progress | None = None,
    targets: ReferenceViews | None = None,
) -> tuple[bytes, EncodeReport]:
    """Encode a scene, guided by a plan's views if there is a plan and the profile has step sizes.

    `targets` are the reference views, if they are known.
    """
    if plan is None or config.profile not in ADAPTIVE_PROFILES or not scene.count:
        return encode_scene(scene, config, progress)
    from gs_codec.guidance.guide import guide

    targets = reference_views_of(scene, plan, progress, targets)
    times = StageTimes()
    with using_threads(config.threads):
        with times.stage("check"):
            clean, changed = clean_scene(scene, config)
        if not clean.count:
            return encode_scene(scene, config, progress)
        with times.stage("views"):
            guidance = guide(clean, targets, progress)
        profile = config.resolved_lattice()
        shaped = shape_scene(clean, config, guidance.steps(clean, profile), times)
        with times.stage("recolour"):
            shaped = guidance.recolour(shaped, profile)
        del guidance  # It holds large arrays: a weight for each Gaussian in each view.
        parts, report = encode_shaped(shaped, times, progress)
    return b"".join(parts), replace(report, **changed)


def reference_views_of(
    scene: Scene,
    plan: Plan,
    progress: Progress | None = None,
    targets: ReferenceViews | None = None,
) -> ReferenceViews:
    """The reference views of a plan, for encoding.

    If the scene was optimised, they are its own renders; else `targets`, by default its renders.
    """
    from gs_codec.preparation.pipeline import draw_views
    from gs_codec.preparation.reference_views import draw_reference_views

    targets = targets or draw_views(scene, plan, progress)
    if plan.steps.refine:
        targets = draw_reference_views(scene, targets.cameras, targets.background, progress)
    return targets

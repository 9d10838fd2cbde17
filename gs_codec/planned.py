"""Scenes encoded by what views see of them, or to a wanted size or quality."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from gs_codec.codec.clean import clean_scene
from gs_codec.codec.encode import encode_scene
from gs_codec.codec.lattice_encode import encode_shaped, shape_scene
from gs_codec.config import LATTICE_PROFILES, Config, Target, as_target
from gs_codec.report import EncodeReport, Progress, StageTimes
from gs_codec.scene import Scene
from gs_codec.workers import using_threads

if TYPE_CHECKING:
    from gs_codec.preparation.steps import Plan
    from gs_codec.preparation.targets import Targets, Views


def encode_by_plan(
    scene: Scene,
    ply_bytes: int,
    config: Config,
    plan: Plan | None = None,
    rate: Target | Mapping[str, float] | None = None,
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
        wish = as_target(rate)
        return encode_goal(scene, original, ply_bytes, config, wish, plan, progress, views)
    targets = None if views is None else views.renders
    return encode_planned(scene, config, plan, progress, targets)


def encode_goal(
    scene: Scene,
    original: Scene,
    ply_bytes: int,
    config: Config,
    goal: Target,
    plan: Plan | None = None,
    progress: Progress | None = None,
    views: Views | None = None,
) -> tuple[bytes, EncodeReport]:
    """Encode a scene at a wanted size or quality, which counts from the original.

    Profiles go by a plan's views where there is one. A quality is measured in those that are held
    out, against photographs if it has any. Without a plan, a quality or pruning goes by views that
    are chosen from the scene.
    `views` are the plan's where they are known.

    Raises
    ------
    InvalidInput
        If the goal is out of reach, or the profile has no steps to choose.
    """
    from gs_codec.rate.allocate import Seen, check_searchable, encode_to_target

    check_searchable(scene, config)
    limit = goal.limit(original.count, ply_bytes)
    if plan is None and (limit is None or goal.allow_prune):
        from gs_codec.preparation.steps import Plan

        plan = Plan()
    if plan is None:
        return encode_to_target(scene, config, goal, limit)
    seen = None
    if limit is None or goal.allow_prune:
        from gs_codec.preparation.pipeline import choose_views

        views = views or choose_views(original, plan, progress)
        seen = Seen(views, views.held_out.errors(original, progress), progress)
    targets = wanted_of(scene, plan, progress, views.renders if views is not None else None)
    return encode_to_target(scene, config, goal, limit, targets, seen, progress)


def encode_planned(
    scene: Scene,
    config: Config,
    plan: Plan | None,
    progress: Progress | None = None,
    targets: Targets | None = None,
) -> tuple[bytes, EncodeReport]:
    """Encode a scene by what a plan's views see, if there is a plan and the profile has steps.

    `targets` are what these look like, where that is known.
    """
    if plan is None or config.profile not in LATTICE_PROFILES or not scene.count:
        return encode_scene(scene, config, progress)
    from gs_codec.preparation.guide import guide

    targets = wanted_of(scene, plan, progress, targets)
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
        del guidance  # It holds what views see of each Gaussian.
        parts, report = encode_shaped(shaped, times, progress)
    return b"".join(parts), replace(report, **changed)


def wanted_of(
    scene: Scene, plan: Plan, progress: Progress | None = None, targets: Targets | None = None
) -> Targets:
    """What a plan's views should look like, by which a scene is encoded.

    Where the scene was optimised, it is itself what they should look like, else the scene it was
    made from.
    """
    from gs_codec.preparation.pipeline import draw_views
    from gs_codec.preparation.targets import draw_targets

    targets = targets or draw_views(scene, plan, progress)
    if plan.steps.refine:
        targets = draw_targets(scene, targets.cameras, targets.background, progress)
    return targets

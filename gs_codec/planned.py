"""Scenes encoded by what views see of them, or to a wanted size or quality."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from gs_codec.config import LATTICE_PROFILES, Config, Target
from gs_codec.report import EncodeReport, Progress
from gs_codec.scene import Scene

if TYPE_CHECKING:
    from gs_codec.codec.guidance import Guidance
    from gs_codec.preparation.pipeline import Plan
    from gs_codec.preparation.targets import Targets, Views


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
        from gs_codec.preparation.pipeline import Plan
        from gs_codec.preparation.steps import Steps

        plan = Plan(Steps())
    if plan is None:
        return encode_to_target(scene, config, goal, limit)
    seen = None
    if limit is None or goal.allow_prune:
        from gs_codec.preparation.pipeline import choose_views

        views = views or choose_views(original, plan, progress)
        seen = Seen(views, views.held_out.errors(original, progress), progress)
    targets = views.renders if views is not None else None
    guide = guide_of(scene, plan, config, progress, targets)
    return encode_to_target(scene, config, goal, limit, guide, seen, progress)


def guide_of(
    scene: Scene,
    plan: Plan,
    config: Config,
    progress: Progress | None = None,
    targets: Targets | None = None,
) -> Callable[[Scene], Guidance] | None:
    """What tells `encode_scene` what a plan's views see; None for profiles that do not ask.

    `targets` are what these look like, where that is known. Where the scene was optimised, it is
    itself what its views should look like, else the scene it was made from.
    """
    if config.profile not in LATTICE_PROFILES or not scene.count:
        return None
    from gs_codec.preparation.guide import guide
    from gs_codec.preparation.pipeline import draw_views
    from gs_codec.preparation.targets import draw_targets

    targets = targets or draw_views(scene, plan, progress)
    if plan.steps.optimise:
        targets = draw_targets(scene, targets.cameras, targets.background, progress)
    return lambda clean: guide(clean, targets, config.threads, progress)

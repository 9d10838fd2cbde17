"""Apply actions in order."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from gs_codec.codecs.matching import without_order
from gs_codec.coding.extent import box_text, centre_box
from gs_codec.edit import motion, selection
from gs_codec.edit.actions import KINDS, Action
from gs_codec.edit.join import merge_scenes
from gs_codec.errors import InvalidInput
from gs_codec.formats.coordinates import turn_axes
from gs_codec.report import ActionReport, Progress
from gs_codec.scene import Scene

if TYPE_CHECKING:
    from gs_codec.edit.project_file import Project
    from gs_codec.plan import Plan


class _Context(NamedTuple):
    """What actions need besides the scene."""

    plan: Plan | None
    progress: Progress | None
    details: dict[str, int]
    is_input: bool  # whether the scene is as read


def edit_scenes(
    scenes: Sequence[Scene],
    actions: Sequence[Action],
    plan: Plan | None = None,
    progress: Progress | None = None,
    translated: bool = False,
    check: Callable[[Scene, Scene], None] | None = None,
) -> tuple[Scene, tuple[ActionReport, ...]]:
    """Merge scenes and apply actions in order; everything is in ``RDF``.

    A single scene without actions is returned unchanged. Actions that need cameras use those of the
    plan; `check` gets the scene before and after each of them. If the scenes are `translated`, the
    first action was applied when they were read. Raises InvalidInput if an action does not apply to
    the scene, or removes all Gaussians.
    """
    reports: list[ActionReport] = []
    if translated:
        count = sum(scene.count for scene in scenes)
        reports.append(ActionReport(str(actions[0]), count, count, {}, 0.0))
        actions = actions[1:]
    if actions or len(scenes) > 1:
        scenes = [without_order(turn_axes(scene)) for scene in scenes]
    whole = scene = merge_scenes(scenes)
    for action in actions:
        start, before = time.perf_counter(), scene
        context = _Context(plan, progress, {}, scene is whole and not translated)
        try:
            scene = _EDITS[action.name](scene, context, *action.arguments)
            if before.count and not scene.count:
                found = box_text(centre_box(before.positions).reshape(2, 3))
                raise InvalidInput(f"no Gaussian is left of {before.count:,}, {found}")
        except InvalidInput as error:
            raise InvalidInput(f"{action.typed}: {error}") from error
        if check is not None and KINDS[action.name].guided and scene is not before:
            check(before, scene)
        seconds = time.perf_counter() - start
        done = ActionReport(str(action), before.count, scene.count, context.details, seconds)
        reports.append(done)
    return scene, tuple(reports)


def _remove_floaters(scene: Scene, context: _Context) -> Scene:
    from gs_codec.edit.floaters import FLOATERS, find_floaters

    plan = context.plan
    # Estimated cameras add no information.
    cameras = None if plan is None or plan.estimates else plan.cameras
    labels = find_floaters(scene, cameras, context.progress)
    counts = np.bincount(labels, minlength=len(FLOATERS)).tolist()
    context.details.update(zip(FLOATERS[1:], counts[1:], strict=True))
    return scene.take(labels == 0) if any(counts[1:]) else scene


def _keep_largest_cluster(scene: Scene, context: _Context) -> Scene:
    from gs_codec.edit.clusters import keep_largest_cluster

    return keep_largest_cluster(scene)


def _apply_project(scene: Scene, context: _Context, project: Project) -> Scene:
    return motion.apply_project(scene, project, context.is_input)


def _decimate(scene: Scene, context: _Context, number: int) -> Scene:
    from gs_codec.edit.decimation import decimate

    return decimate(scene, number, context.plan, context.progress)


def _decimate_to_share(scene: Scene, context: _Context, percent: float) -> Scene:
    return _decimate(scene, context, max(1, round(scene.count * percent / 100)))


_EDITS: Mapping[str, Callable[..., Scene]] = {
    "crop-box": lambda scene, _, *x: selection.crop_box(scene, x[:3], x[3:]),
    "crop-sphere": lambda scene, _, *x: selection.crop_sphere(scene, x[:3], x[3]),
    "filter": lambda scene, _, *x: selection.select_where(scene, *x),
    "remove-nan": lambda scene, _: selection.remove_nonfinite(scene),
    "remove-floaters": _remove_floaters,
    "keep-largest-cluster": _keep_largest_cluster,
    "translate": lambda scene, _, *x: motion.translate(scene, x),
    "rotate": lambda scene, _, *x: motion.rotate(scene, x),
    "scale": lambda scene, _, x: motion.scale(scene, x),
    "transform": lambda scene, _, x: motion.transform(scene, x),
    "edits": _apply_project,
    "sh-degree": lambda scene, _, x: selection.limit_sh_degree(scene, x),
    "gaussians": _decimate,
    "keep": _decimate_to_share,
    "sort": lambda scene, _: selection.sort_morton(scene),
}

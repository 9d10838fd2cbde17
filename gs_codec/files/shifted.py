"""Scenes far from the origin: translated before their centres are rounded to float32."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gs_codec.edit.actions import Action
from gs_codec.edit.apply import edit_scenes
from gs_codec.formats.coordinates import CONVENTION, turn_shift
from gs_codec.formats.registry import open_scene
from gs_codec.report import ActionReport, Progress
from gs_codec.runtime.mapped import located
from gs_codec.scene import Scene, Shift, coordinates_of

if TYPE_CHECKING:
    from gs_codec.preparation.steps import Plan


def early_shifts(
    sources: Sequence[str | Path], actions: Sequence[Action], stated: str = ""
) -> list[Shift] | None:
    """The translation in the first action, if all sources have float64 centres.

    It is given in the axes of each source, which `stated` may override.
    """
    if not actions or actions[0].name != "translate":
        return None
    shifts = []
    for source in sources:
        with open_scene(source) as file:
            if not file.has_doubles:
                return None
            system = stated.upper() or coordinates_of(file.ply.header.comments) or CONVENTION
            with located(source):
                shifts.append(turn_shift(actions[0].arguments, CONVENTION, system))
    return shifts


def edit_shifted(
    scenes: Sequence[Scene],
    actions: Sequence[Action],
    shifts: Sequence[Shift] | None,
    plan: Plan | None = None,
    progress: Progress | None = None,
) -> tuple[Scene, tuple[ActionReport, ...]]:
    """Like `edit_scenes`; with `shifts`, the first action was already applied when reading."""
    if shifts is None:
        return edit_scenes(scenes, actions, plan, progress)
    count = sum(scene.count for scene in scenes)
    scene, done = edit_scenes(scenes, actions[1:], plan, progress)
    return scene, (ActionReport(str(actions[0]), count, count, {}, 0.0), *done)

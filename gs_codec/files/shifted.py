"""Scenes far from the origin: translated before their centres are rounded to float32."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gs_codec.edit.actions import Action
from gs_codec.formats.coordinates import CONVENTION, turn_shift
from gs_codec.formats.registry import open_scene
from gs_codec.runtime.mapped import located
from gs_codec.scene import Shift, coordinates_of


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

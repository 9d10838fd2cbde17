"""Properties and elements beyond the 3DGS layout: kept, rejected, or dropped with a warning."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from gs_codec.config import Extra
from gs_codec.errors import InvalidInput
from gs_codec.format_table import COMMENTS, FLAG, FLAT_FLAG, PROPERTIES, SceneFormat
from gs_codec.scene import NORMALS, ORDER, Scene, other_comments, render_mode

log = logging.getLogger(__name__)

#: Maximum characters of a name in a message.
_LENGTH = 60


def listed(names: Sequence[str], most: int = 8) -> str:
    """Names in one line; if there are more than `most`, the number of the others."""
    shown = [name[:_LENGTH] for name in names[:most]]
    more = len(names) - len(shown)
    return ", ".join([*shown, f"{more} more"] if more else shown)


def left_out(
    properties: Sequence[str] = (),
    elements: Sequence[str] = (),
    lines: Mapping[str, int] | None = None,
    others: Sequence[str] = (),
) -> list[str]:
    """Describe what is dropped, if anything, in one line; `lines` counts lines by kind."""
    said = [*others, *(f"{kind} ({count:,})" for kind, count in (lines or {}).items() if count)]
    kinds = (("elements", elements), ("properties", properties))
    said += [f"{kind} {listed(names)}" for kind, names in kinds if names]
    return [f"left out: {'; '.join(said)}"] if said else []


def say_left_out(
    where: str | Path,
    properties: Sequence[str] = (),
    elements: Sequence[str] = (),
    lines: Mapping[str, int] | None = None,
    others: Sequence[str] = (),
) -> None:
    """Log what is dropped from a file, if anything, in one line."""
    for line in left_out(properties, elements, lines, others):
        log.warning("%s: %s", where, line)


def left_out_of(scene: Scene, known: SceneFormat) -> list[str]:
    """What a format leaves out of a scene, if anything, as one line."""
    others = []
    if scene.sh_degree and 0 in known.sh_degrees.values():
        others.append(f"SH of degrees 1 to {scene.sh_degree}")
    if scene.antialiased and FLAG not in known.keeps:
        others.append(FLAG)
    if render_mode(scene.comments) == "2dgs" and FLAT_FLAG not in known.keeps:
        others.append(FLAT_FLAG)
    comments = () if COMMENTS in known.keeps else other_comments(scene.comments)
    lines = {COMMENTS: sum(not line.startswith(ORDER) for line in comments)}
    return left_out([] if PROPERTIES in known.keeps else [*scene.extra], (), lines, others)


def say_degree_4(where: str | Path) -> None:
    """Log that SH of degree 4 is dropped."""
    say_left_out(where, others=["SH of degree 4"])


def refuse_beyond(properties: Sequence[str], elements: Sequence[str] = ()) -> None:
    """Reject properties and elements beyond the layout, if there are any."""
    if elements:
        raise InvalidInput(
            f"element '{elements[0][:_LENGTH]}' in addition to 'vertex'; choose extra=\"drop\""
        )
    if properties:
        why = "normals are not all zero" if set(properties) <= {*NORMALS} else "beyond the layout"
        raise InvalidInput(
            f'properties {listed(properties, 4)} ({why}); choose extra="keep" or extra="drop"'
        )


def scene_without(where: str | Path, scene: Scene, extra: Extra) -> Scene:
    """Apply `extra` to a scene whose extra properties were read."""
    if extra == "error":
        refuse_beyond([*scene.extra])
    if extra == "keep" or not scene.extra:
        return scene
    say_left_out(where, [*scene.extra])
    return replace(scene, extra={})

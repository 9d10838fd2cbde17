"""Properties and elements beyond the 3DGS layout: kept, refused, or left out with a warning."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from gs_codec.config import Extra
from gs_codec.errors import InvalidInput
from gs_codec.scene import NORMALS, Scene

log = logging.getLogger(__name__)

#: Most characters of a name in a line.
_LENGTH = 60


def listed(names: Sequence[str], most: int = 8) -> str:
    """Names in one line; beyond `most`, only how many more."""
    shown = [name[:_LENGTH] for name in names[:most]]
    more = len(names) - len(shown)
    return ", ".join([*shown, f"{more} more"] if more else shown)


def say_left_out(
    where: str | Path,
    properties: Sequence[str],
    elements: Sequence[str] = (),
    lines: Mapping[str, int] | None = None,
) -> None:
    """Log what is left out of a file, if anything, in one line; `lines` counts those of a kind."""
    said = [f"{kind} ({count})" for kind, count in (lines or {}).items() if count]
    kinds = (("elements", elements), ("properties", properties))
    said += [f"{kind} {listed(names)}" for kind, names in kinds if names]
    if said:
        log.warning("%s: left out: %s", where, "; ".join(said))


def say_degree_4(where: str | Path) -> None:
    """Log that SH of degree 4 is left out."""
    log.warning("%s: SH of degree 4 left out, degrees 0 to 3 are read", where)


def refuse_beyond(properties: Sequence[str], elements: Sequence[str] = ()) -> None:
    """Refuse what is beyond the layout, if anything."""
    if elements:
        raise InvalidInput(
            f"element '{elements[0][:_LENGTH]}' beside 'vertex'; choose --extra drop"
        )
    if properties:
        why = "normals are not all zero" if set(properties) <= {*NORMALS} else "beyond the layout"
        raise InvalidInput(
            f"properties {listed(properties, 4)} ({why}); choose --extra keep or --extra drop"
        )


def scene_without(where: str | Path, scene: Scene, extra: Extra) -> Scene:
    """A scene whose extra properties were read, with what `extra` says of them."""
    if extra == "error":
        refuse_beyond([*scene.extra])
    if extra == "keep" or not scene.extra:
        return scene
    say_left_out(where, [*scene.extra])
    return replace(scene, extra={})

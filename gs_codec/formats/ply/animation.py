"""Brush's animations: a scene and, for each frame, the differences of its Gaussians, in one PLY.

Elements ``delta_vertex_*`` are the frames, in the order of the file. They have a row for each
Gaussian: differences of centres, log-scales and quaternions from ``vertex``, as floats or as
unsigned integers. These are relative to the range in the last elements ``meta_delta_min_*`` and
``meta_delta_max_*`` before them, or to 0 and 1. What is not in a row does not change.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.config import Extra
from gs_codec.errors import InvalidInput
from gs_codec.formats.ply.body import Ply
from gs_codec.formats.ply.file import scene_of
from gs_codec.formats.ply.ply_header import PlyHeader
from gs_codec.runtime.mapped import located
from gs_codec.runtime.wording import counted
from gs_codec.scene import Scene, property_names

_FRAME = "delta_vertex_"
_LOW, _HIGH = "meta_delta_min_", "meta_delta_max_"


def frame_names(header: PlyHeader) -> list[str]:
    """Names of the frames, usually numbers; empty if the PLY is not an animation."""
    return [name.removeprefix(_FRAME) for name in header.elements if name.startswith(_FRAME)]


def read_frame(ply: Ply, number: int, extra: Extra = "keep", max_bytes: int | None = None) -> Scene:
    """The scene of a frame, 0 being the first one of `frame_names`; raises like `read_ply`."""
    elements = [*ply.header.elements]
    name = _FRAME + frame_names(ply.header)[number]
    before = elements[: elements.index(name)]
    scene = scene_of(ply, extra, max_bytes, tell=False)
    with located(ply.path):
        count = ply.header.elements[name].count
        if count != scene.count:
            rows = counted(count, "row")
            raise InvalidInput(f"element '{name}': {rows}, expected {scene.count:,} as in 'vertex'")
        change = ply.rows(name).all()
        low, high = (_last_row(ply, before, prefix) for prefix in (_LOW, _HIGH))
        changes: dict[str, Any] = {}
        for group, names in property_names().items():
            planes = getattr(scene, group).copy()
            for plane, each in zip(planes, names, strict=False):
                if each in (change.dtype.names or ()):
                    start, end = low.get(each, 0.0), high.get(each, 1.0)
                    with np.errstate(all="ignore"):
                        plane += (_shares(change[each]) * (end - start) + start).astype(np.float32)
            changes[group] = planes
    return replace(scene, **changes)


def _last_row(ply: Ply, names: list[str], prefix: str) -> dict[str, float]:
    """The only row of the last of these elements with a prefix; empty if there is none."""
    found = [name for name in names if name.startswith(prefix)]
    if not found:
        return {}
    rows = ply.rows(found[-1]).all()
    if len(rows) != 1:
        raise InvalidInput(f"element '{found[-1]}': {len(rows):,} rows, expected 1")
    return {name: float(rows[name][0]) for name in rows.dtype.names or ()}


def _shares(column: NDArray) -> NDArray[np.float64]:
    """Values relative to a range; Brush divides integers by their maximum less 1."""
    if column.dtype.kind == "i":
        raise InvalidInput(f"differences of type {column.dtype.name}, expected float or unsigned")
    most = np.iinfo(column.dtype).max - 1 if column.dtype.kind == "u" else 1
    return column.astype(np.float64) / most

"""Several scenes in one."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from gs_codec.codecs.matching import without_order
from gs_codec.errors import InvalidInput
from gs_codec.formats.extra_properties import say_left_out
from gs_codec.runtime.arguments import checked
from gs_codec.scene import (
    FLAT,
    Scene,
    join_scenes,
    offset_of,
    other_comments,
    render_mode,
    stated_comments,
    with_offset,
)

if TYPE_CHECKING:
    from open3d.pybind.t.geometry import PointCloud

log = logging.getLogger(__name__)


@checked
def merge(clouds: Sequence[PointCloud]) -> PointCloud:
    """Concatenate the Gaussians of several clouds into one.

    Parameters
    ----------
    clouds : sequence of open3d.t.geometry.PointCloud
        Clouds from `gs_codec.read`. The result has the highest SH degree; missing SH are 0. Other
        attributes are kept if all clouds have them with the same type; a log message names those
        that are dropped.

    Returns
    -------
    open3d.t.geometry.PointCloud
        All Gaussians.

    Raises
    ------
    InvalidInput
        If there is no cloud, or an attribute is not in the layout of `gs_codec.read`.

    Examples
    --------
    >>> cloud = gs_codec.read("scene.ply")
    >>> both = gs_codec.edit.merge([cloud, gs_codec.edit.translate(cloud, (5, 0, 0))])
    >>> len(both.point.positions)
    4000
    """
    from gs_codec.formats.cloud import from_cloud, to_cloud

    return to_cloud(merge_scenes([from_cloud(cloud, "keep") for cloud in clouds])).clone()


def merge_scenes(scenes: Sequence[Scene]) -> Scene:
    """Concatenate scenes in one coordinate system; see `merge`.

    Comments of all are kept, without repetitions; an offset only if no scene states another.
    """
    if not scenes:
        raise InvalidInput("no scenes, expected at least one")
    if len(scenes) == 1:
        return scenes[0]
    scenes = _with_shared(scenes)
    first = scenes[0]
    if any(scene.antialiased != first.antialiased for scene in scenes):
        log.warning(
            "merged scenes differ in antialiasing; all are rendered %s, like the first",
            "with it" if first.antialiased else "without",
        )
    others = [line for scene in scenes for line in other_comments(without_order(scene).comments)]
    if len({offset_of(scene.comments) for scene in scenes} - {None}) > 1:
        log.warning("merged scenes differ in CoordinateOffset, so it is dropped; none is moved")
        others = [*with_offset(others, None)]
    if all(render_mode(scene.comments) == render_mode([FLAT]) for scene in scenes):
        others.append(FLAT)
    stated = stated_comments(first.coordinates, first.antialiased)
    return replace(join_scenes(scenes), comments=(*dict.fromkeys(others), *stated))


def _with_shared(scenes: Sequence[Scene]) -> list[Scene]:
    """Keep only the extra properties that all scenes share; a log message names the others."""
    types = [{name: column.dtype for name, column in scene.extra.items()} for scene in scenes]
    shared = [name for name, dtype in types[0].items() if all(t.get(name) == dtype for t in types)]
    others = dict.fromkeys(name for own in types for name in own if name not in shared)
    say_left_out("merged scenes with different properties", [*others])
    return [replace(scene, extra={n: scene.extra[n] for n in shared}) for scene in scenes]

"""Several scenes in one."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from gs_codec.codecs.matching import without_order
from gs_codec.errors import InvalidInput
from gs_codec.scene import Scene, join_scenes, other_comments, stated_comments

if TYPE_CHECKING:
    from open3d.t.geometry import PointCloud

log = logging.getLogger(__name__)


def merge(clouds: Sequence[PointCloud]) -> PointCloud:
    """One cloud of the Gaussians of several, in their order.

    Parameters
    ----------
    clouds : sequence of open3d.t.geometry.PointCloud
        As `gs_codec.read` gives them. SH of the highest degree are kept; others are 0.

    Returns
    -------
    open3d.t.geometry.PointCloud
        All Gaussians.

    Raises
    ------
    InvalidInput
        If there is none, or an attribute is not in all of them or differs in its type.

    Examples
    --------
    >>> cloud = gs_codec.read("scene.ply")
    >>> both = gs_codec.edit.merge([cloud, gs_codec.edit.translate(cloud, (5, 0, 0))])
    >>> len(both.point.positions)
    4000
    """
    from gs_codec.formats.cloud import from_cloud, to_cloud

    return to_cloud(merge_scenes([from_cloud(cloud, "keep") for cloud in clouds]))


def merge_scenes(scenes: Sequence[Scene]) -> Scene:
    """One scene of the Gaussians of several in one coordinate system; see `merge`.

    Comments of the first are kept, and those of the others that it does not have.
    """
    if not scenes:
        raise InvalidInput("no scenes, expected at least one")
    if len(scenes) == 1:
        return scenes[0]
    first = scenes[0]
    _check_extra(scenes)
    if any(scene.antialiased != first.antialiased for scene in scenes):
        log.warning(
            "merged scenes differ in antialiasing; all are drawn %s, as the first",
            "with it" if first.antialiased else "without",
        )
    others = [line for scene in scenes for line in other_comments(without_order(scene).comments)]
    stated = stated_comments(first.coordinates, first.antialiased)
    return replace(join_scenes(scenes), comments=(*dict.fromkeys(others), *stated))


def _check_extra(scenes: Sequence[Scene]) -> None:
    """Refuse extra properties that not all scenes have alike."""
    types = [{name: column.dtype for name, column in scene.extra.items()} for scene in scenes]
    for own in types:
        for name in {**types[0], **own}:
            if types[0].get(name) != own.get(name):
                raise InvalidInput(
                    f"property '{name}': not in all scenes alike, expected --extra drop"
                )

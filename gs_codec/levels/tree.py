"""Spark's tree of levels of detail: four neighbours in Morton order have one parent.

A viewer refines the tree Gaussian by Gaussian, so that each level needs no blocks or errors.
"""

from __future__ import annotations

import numpy as np

from gs_codec.coding.morton import spatial_order
from gs_codec.config import Effort
from gs_codec.egs.header import FANOUT
from gs_codec.errors import InvalidInput
from gs_codec.formats.attribute_steps import AttributeSteps
from gs_codec.formats.packed_values import check_finite
from gs_codec.formats.rad.writer import pack_tree
from gs_codec.levels.adding import COARSER
from gs_codec.levels.quarter import Clusters
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene, join_scenes

#: Number of Gaussians merged at once.
_AT_ONCE = 1 << 16


def pack_rad(
    scene: Scene, steps: AttributeSteps | None = None, effort: Effort = "normal"
) -> tuple[bytes, tuple[str, ...]]:
    """The bytes of a `.rad` file; sentences on what it cannot represent.

    Gaussians are in Morton order, after their coarser versions. Raises InvalidInput if there are no
    Gaussians, or a value is not finite.

    Parameters
    ----------
    scene : Scene
    steps : AttributeSteps, optional
        Values are rounded to multiples of the format's step, up to about these steps, for a smaller
        file. Default: full accuracy of the format.
    effort : {"fast", "normal", "high"}
        How long to compress.
    """
    check_finite(scene, ".rad")
    if not scene.count:
        raise InvalidInput("no Gaussians, .rad has at least one")
    steps = AttributeSteps.least(scene) if steps is None else steps
    order = spatial_order(scene.positions, scene.log_scale)
    scenes, of_levels = [scene.take(order)], [steps.take(order)]
    children = [np.zeros(scene.count, np.int64)]
    while (count := scenes[0].count) > 1:
        factor = COARSER if len(scenes) == 1 else 1
        scenes.insert(0, _merged(scenes[0]))
        of_levels.insert(0, of_levels[0].take(np.arange(0, count, FANOUT)).times(factor))
        children.insert(0, np.diff([*range(0, count, FANOUT), count]))
    wanted = AttributeSteps.joined(of_levels)
    return pack_tree(join_scenes(scenes), wanted, np.concatenate(children), effort)


def _merged(scene: Scene) -> Scene:
    """A Gaussian for each four."""

    def merged(start: int) -> Scene:
        some = scene.between(start, min(start + _AT_ONCE, scene.count))
        into = np.arange(some.count) // FANOUT
        return Clusters(some, into, int(into[-1]) + 1).merged()

    return join_scenes(run_all(merged, range(0, scene.count, _AT_ONCE)))

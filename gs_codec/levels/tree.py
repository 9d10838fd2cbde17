"""Spark's tree of levels of detail: a parent for about four similar neighbours.

A viewer refines the tree Gaussian by Gaussian, so that levels need no blocks or errors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.morton import spatial_order
from gs_codec.config import Effort
from gs_codec.egs.header import FANOUT
from gs_codec.errors import InvalidInput
from gs_codec.format_table import RAD
from gs_codec.formats.attribute_steps import AttributeSteps
from gs_codec.formats.extra_properties import left_out_of
from gs_codec.formats.packed_values import check_finite
from gs_codec.formats.rad.writer import pack_tree
from gs_codec.levels.adding import COARSER
from gs_codec.levels.quarter import Clusters, merge_group
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene, inverse_of, join_scenes

#: Maximum number of Gaussians merged at once.
_AT_ONCE = 1 << 12


def pack_rad(
    scene: Scene, steps: AttributeSteps | None = None, effort: Effort = "normal"
) -> tuple[bytes, tuple[str, ...]]:
    """The bytes of a `.rad` file; sentences on what it cannot represent.

    Gaussians are in `leaf_order`, after their coarser versions. Raises InvalidInput if there are no
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
        raise InvalidInput("no Gaussians, .rad needs at least one")
    own = AttributeSteps.least(scene) if steps is None else steps
    levels, own = _levels(scene), own.take(spatial_order(scene.positions, scene.log_scale))
    orders = _orders(levels)
    scenes: list[Scene] = []
    wanted: list[AttributeSteps] = []
    children = [np.zeros(scene.count, np.int64)]
    for number, (level, order) in enumerate(zip(levels, orders, strict=True)):
        scenes.insert(0, level.scene.take(order))
        wanted.insert(0, own.take(order))
        if level.scene.count > 1:
            firsts = np.unique(level.parents, return_index=True)[1]
            own = own.take(firsts).times(1 if number else COARSER)
            children.insert(0, np.bincount(level.parents)[orders[number + 1]])
    joined = AttributeSteps.joined(wanted)
    data, lost = pack_tree(join_scenes(scenes), joined, np.concatenate(children), effort)
    return data, (*lost, *left_out_of(scene, RAD))


def leaf_order(scene: Scene) -> NDArray[np.int64]:
    """Index in a scene of each Gaussian of its `.rad` file."""
    return spatial_order(scene.positions, scene.log_scale)[_orders(_levels(scene))[0]]


class _Level(NamedTuple):
    """Gaussians, and the index of each one's parent in the next coarser level."""

    scene: Scene
    parents: NDArray[np.int64]


def _levels(scene: Scene) -> list[_Level]:
    """A scene in Morton order, and coarser levels down to a single Gaussian."""
    levels = []
    finer = scene.take(spatial_order(scene.positions, scene.log_scale))
    while (count := finer.count) > 1:
        starts = range(0, count, _AT_ONCE)
        groups = [finer.between(start, min(start + _AT_ONCE, count)) for start in starts]
        coarser, parents = zip(*run_all(_merged, groups), strict=True)
        before = np.cumsum([0, *(each.count for each in coarser)])
        numbers = [own + first for own, first in zip(parents, before, strict=False)]
        levels.append(_Level(finer, np.concatenate(numbers)))
        finer = join_scenes(coarser)
    return [*levels, _Level(finer, np.zeros(finer.count, np.int64))]


def _merged(group: Scene) -> tuple[Scene, NDArray[np.int64]]:
    """A quarter of a group's Gaussians, and the parent of each Gaussian."""
    number = -(-group.count // FANOUT)
    with np.errstate(all="ignore"):
        into = merge_group(group, number)
        merged = Clusters(group, into, number).merged()
    # Those that hardly show are dropped from the coarser level; their parent is a neighbour's.
    kept = np.flatnonzero(into >= 0)
    nearest = np.searchsorted(kept, np.arange(group.count), side="right") - 1
    return merged, into[kept[np.maximum(nearest, 0)]]


def _orders(levels: list[_Level]) -> list[NDArray[np.int64]]:
    """Order of each level's Gaussians: children follow each other in the order of parents."""
    orders = [np.zeros(levels[-1].scene.count, np.int64)]
    for level in levels[-2::-1]:
        places = inverse_of(orders[0])
        orders.insert(0, np.argsort(places[level.parents], kind="stable"))
    return orders

"""The largest cluster of a scene: connected Gaussians, without separate bits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.neighbours import Neighbours
from gs_codec.edit.clouds import on_clouds
from gs_codec.edit.spacing import (
    NEIGHBOURS,
    Spacing,
    by_size,
    find_spacing,
    in_place_order,
    usual_distance,
)
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.scene import Scene

#: Factor on a distance, so that a search includes that distance itself.
_ABOVE = 1 + 1e-9


def largest_cluster(scene: Scene) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` belong to the largest cluster; see `keep_largest_cluster`."""
    finite = in_place_order(scene)
    cluster = np.zeros(scene.count, bool)
    if len(finite):
        spacing = find_spacing(scene.take(finite))
        limit = usual_distance(spacing)
        labels = _link_nearest(spacing, limit)
        first = int(np.argmax(np.bincount(labels)))
        cluster[finite[_grow(spacing, limit, labels, first)]] = True
    return cluster


def linked_neighbours(scene: Scene) -> NDArray[np.int32]:
    """The neighbours ``(N, K)`` that each Gaussian is linked to; itself in place of missing ones.

    Of the eight nearest, those that `keep_largest_cluster` follows first.
    """
    finite = in_place_order(scene)
    linked = np.arange(scene.count, dtype=np.int32)[:, None].repeat(NEIGHBOURS, axis=1)
    if len(finite):
        spacing = find_spacing(scene.take(finite))
        near = spacing.in_sizes() <= usual_distance(spacing)
        own, others = finite[:, None], finite[spacing.nearest]
        linked[finite, : near.shape[1]] = np.where(near, others, own)
    return linked


def connected(
    neighbours: NDArray[np.int32], allowed: NDArray[np.bool_], row: int
) -> NDArray[np.bool_]:
    """Mask ``(N,)`` of the Gaussians reached from one by links between the allowed ones.

    `neighbours` is from `linked_neighbours`; `allowed` is a mask ``(N,)``.
    """
    labels = np.arange(len(neighbours))
    _join(neighbours, allowed[:, None] & allowed[neighbours], labels)
    return allowed & (labels == labels[row])


@on_clouds
def keep_largest_cluster(scene: Scene) -> Scene:
    """Keep the largest cluster of connected Gaussians, and remove all others.

    Two Gaussians are linked if their distance is at most the scene's usual distance (see
    `remove_floaters`) to the eighth nearest, in units of their sizes. A cluster consists of all
    Gaussians reachable through links. To find the largest, links between each Gaussian and its
    eight nearest centres are followed first; the largest of these clusters (the first if tied) is
    then extended by everything linked to it.

    An object on a floor is one cluster with the floor. Gaussians with a value that is not finite
    belong to no cluster.

    Parameters
    ----------
    scene : open3d.t.geometry.PointCloud
        A cloud from `gs_codec.read`.

    Returns
    -------
    open3d.t.geometry.PointCloud
        The Gaussians of the cluster, in their original order, with all attributes.

    Raises
    ------
    InvalidInput
        If the cloud lacks an attribute of a scene.

    Examples
    --------
    >>> cloud = gs_codec.edit.keep_largest_cluster(gs_codec.read("scene.ply"))
    """
    cluster = largest_cluster(scene)
    return scene if cluster.all() else scene.take(cluster)


def _link_nearest(spacing: Spacing, limit: float) -> NDArray[np.int64]:
    """Cluster label ``(M,)`` of each Gaussian (its first member), by links to neighbours."""
    labels = np.arange(len(spacing.points))
    _join(spacing.nearest, spacing.in_sizes() <= limit, labels)
    return labels


@kernel
def _join(nearest, linked, labels):
    """Give linked Gaussians one label, that of the first; `labels` starts as the indices."""
    for i in range(len(labels)):
        for k in range(nearest.shape[1]):
            if linked[i, k]:
                first, second = _first_of(labels, i), _first_of(labels, nearest[i, k])
                labels[max(first, second)] = min(first, second)
    for i in range(len(labels)):
        labels[i] = labels[labels[i]]


@inlined
def _first_of(labels, i):
    """Follow labels to the root; halves the path for later calls."""
    while labels[i] != i:
        labels[i] = labels[labels[i]]
        i = labels[i]
    return i


def _grow(
    spacing: Spacing, limit: float, labels: NDArray[np.int64], first: int
) -> NDArray[np.bool_]:
    """Which Gaussians ``(M,)`` are in cluster `first`, or connected to it."""
    cluster = labels == first
    edge, rest = np.flatnonzero(cluster), np.flatnonzero(~cluster)
    while len(edge) and len(rest):
        joined = np.unique(labels[rest[_any_linked(spacing, limit, rest, edge)]])
        joins = np.isin(labels[rest], joined)
        edge, rest = rest[joins], rest[~joins]
        cluster[edge] = True
    return cluster


def _any_linked(
    spacing: Spacing, limit: float, asking: NDArray[np.int64], others: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Which of the Gaussians `asking` are linked to any of `others`, in the order of `asking`."""
    linked = np.zeros(len(asking), bool)
    for size, other in ((spacing.length, spacing.width), (spacing.width, spacing.length)):
        for members, reach in by_size(other, others):
            neighbours = Neighbours(spacing.points[members])
            # With a single size on both sides, the search can stop at the link distance.
            for group, own in by_size(size[asking], np.flatnonzero(~linked)):
                farthest = limit * (own + reach)
                places = spacing.points[asking[group]]
                away, _ = neighbours.nearest(places, 1, within=_ABOVE * farthest)
                linked[group] |= away[:, 0] <= farthest
    return linked

"""The largest cluster of a scene: Gaussians that hang together, without bits apart from them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.neighbours import Neighbours
from gs_codec.edit.clouds import on_clouds
from gs_codec.edit.spacing import (
    Spacing,
    by_size,
    find_spacing,
    in_place_order,
    usual_distance,
)
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.scene import Scene

#: Factor on a distance that is still to be found.
_ABOVE = 1 + 1e-9


def largest_cluster(scene: Scene) -> NDArray[np.bool_]:
    """Which Gaussians are of the largest cluster, ``(N,)``; see `keep_largest_cluster`."""
    finite = in_place_order(scene)
    cluster = np.zeros(scene.count, bool)
    if len(finite):
        spacing = find_spacing(scene.take(finite))
        limit = usual_distance(spacing)
        labels = _link_nearest(spacing, limit)
        first = int(np.argmax(np.bincount(labels)))
        cluster[finite[_grow(spacing, limit, labels, first)]] = True
    return cluster


@on_clouds
def keep_largest_cluster(scene: Scene) -> Scene:
    """Keep the largest cluster of Gaussians that are near each other, and remove all the rest.

    Two Gaussians are linked if their distance is at most the scene's usual distance (see
    `remove_floaters`) to the eighth nearest, in units of their sizes. A cluster is all that can be
    reached by links. The largest has the most Gaussians: of clusters by links of each Gaussian to
    its eight nearest by centre, the first with the most, and all that is linked to it.

    An object on a floor is one cluster with the floor. Gaussians with a value that is not finite
    are of no cluster.

    Parameters
    ----------
    scene : open3d.t.geometry.PointCloud
        As `gs_codec.read` gives it.

    Returns
    -------
    open3d.t.geometry.PointCloud
        The Gaussians of the cluster, in their order, with all of their attributes.

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
    """Label ``(M,)`` of each Gaussian's cluster, by links to its nearest others: its first."""
    labels = np.arange(len(spacing.points))
    _join(spacing.nearest, spacing.in_sizes() <= limit, labels)
    return labels


@kernel
def _join(nearest, linked, labels):
    """Give linked Gaussians one label, that of the first; `labels` begin as their indices."""
    for i in range(len(labels)):
        for k in range(nearest.shape[1]):
            if linked[i, k]:
                first, second = _first_of(labels, i), _first_of(labels, nearest[i, k])
                labels[max(first, second)] = min(first, second)
    for i in range(len(labels)):
        labels[i] = labels[labels[i]]


@inlined
def _first_of(labels, i):
    """The Gaussian that labels lead to; the way there is halved for the next time."""
    while labels[i] != i:
        labels[i] = labels[labels[i]]
        i = labels[i]
    return i


def _grow(
    spacing: Spacing, limit: float, labels: NDArray[np.int64], first: int
) -> NDArray[np.bool_]:
    """Which Gaussians ``(M,)`` are of cluster `first`, or of those linked to it, in any steps."""
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
    """Which of the Gaussians `asking` are linked to any of `others`, in the order of the first."""
    linked = np.zeros(len(asking), bool)
    for size, other in ((spacing.length, spacing.width), (spacing.width, spacing.length)):
        for members, reach in by_size(other, others):
            neighbours = Neighbours(spacing.points[members])
            # Of one size on both sides, the search ends at the distance of a link.
            for group, own in by_size(size[asking], np.flatnonzero(~linked)):
                farthest = limit * (own + reach)
                places = spacing.points[asking[group]]
                away, _ = neighbours.nearest(places, 1, within=_ABOVE * farthest)
                linked[group] |= away[:, 0] <= farthest
    return linked

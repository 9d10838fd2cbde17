"""The largest cluster of a scene: Gaussians that hang together, without bits apart from them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.edit.touching import Spheres, any_touching, find_spheres, finite_mask
from gs_codec.scene import Scene


def largest_cluster(scene: Scene) -> NDArray[np.bool_]:
    """Which Gaussians are of the largest cluster, ``(N,)``; see `keep_largest_cluster`."""
    finite = np.flatnonzero(finite_mask(scene))
    cluster = np.zeros(scene.count, bool)
    if len(finite):
        spheres = find_spheres(scene.take(finite))
        labels = _link_nearest(spheres)
        cluster[finite[_grow(spheres, labels, int(np.argmax(np.bincount(labels))))]] = True
    return cluster


def keep_largest_cluster(scene: Scene) -> Scene:
    """Keep the largest cluster of Gaussians that touch, and remove all the rest.

    Two Gaussians touch if spheres around them do: of two standard deviations along their longest
    axes, rounded to a power of two; or of as many standard deviations as nine in ten Gaussians
    need to touch their eight nearest neighbours. A cluster is all that can be reached from one
    Gaussian to the next. The largest has the most Gaussians: of clusters linked by the eight
    nearest neighbours the first with the most, and all that touches it.

    An object on a floor is one cluster with the floor. Gaussians with a value that is not finite
    are of no cluster.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    Scene
        The Gaussians of the cluster, in their order; the same object if that is all.
    """
    cluster = largest_cluster(scene)
    return scene if cluster.all() else scene.take(cluster)


def _link_nearest(spheres: Spheres) -> NDArray[np.int32]:
    """Label ``(M,)`` of each sphere's cluster, of links to nearest neighbours that it touches."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    touching, count = spheres.touching, len(spheres.points)
    starts = np.concatenate([[0], np.cumsum(np.count_nonzero(touching, axis=1))])
    links = np.ones(starts[-1], bool), spheres.nearest[touching], starts
    return connected_components(csr_array(links, shape=(count, count)), directed=False)[1]


def _grow(spheres: Spheres, labels: NDArray[np.int32], first: int) -> NDArray[np.bool_]:
    """Which spheres ``(M,)`` are of cluster `first` or of others that touch it, over any others."""
    cluster = labels == first
    edge, rest = np.flatnonzero(cluster), np.flatnonzero(~cluster)
    while len(edge) and len(rest):
        joined = np.unique(labels[rest[any_touching(spheres, rest, edge)]])
        joins = np.isin(labels[rest], joined)
        edge, rest = rest[joins], rest[~joins]
        cluster[edge] = True
    return cluster

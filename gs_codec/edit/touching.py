"""Which Gaussians touch: spheres around their centres, as wide as the scene needs them to be.

The sphere of a Gaussian goes by its largest standard deviation, to the nearest power of two, so
that neighbours of each size can be searched for apart: a large Gaussian touches others from farther
away than all the small ones between them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.runtime.arrays import empty
from gs_codec.runtime.threads import available_threads
from gs_codec.scene import GROUPS, Scene

#: Neighbours that a Gaussian of a surface touches.
NEIGHBOURS = 8

#: Spheres reach this many standard deviations, and farther if fewer than this share of the
#: Gaussians then touch all of their nearest neighbours.
_SIGMAS, _SHARE = 2.0, 0.9

#: Powers of two of sizes are within those of float32.
_OCTAVES = 126

#: Gaussians whose neighbours are searched for at once.
_CHUNK = 1 << 17


class Spheres(NamedTuple):
    """Spheres of M Gaussians, and their nearest neighbours by centre.

    Attributes
    ----------
    points : ndarray, shape (M, 3), float64
    radius : ndarray, shape (M,), float64
        Scene units. Two spheres touch if their centres are nearer than the sum of their radii.
    nearest : ndarray, shape (M, K), int32
        The nearest first; K is `NEIGHBOURS`, or M - 1 if that is less.
    distance : ndarray, shape (M, K), float64
    """

    points: NDArray[np.float64]
    radius: NDArray[np.float64]
    nearest: NDArray[np.int32]
    distance: NDArray[np.float64]

    @property
    def touching(self) -> NDArray[np.bool_]:
        """Which of the nearest neighbours are touched, ``(M, K)``."""
        return self.distance < self.radius[:, None] + self.radius[self.nearest]


def finite_mask(scene: Scene) -> NDArray[np.bool_]:
    """Which Gaussians have only finite values, ``(N,)``."""
    finite = np.ones(scene.count, bool)
    for group in GROUPS:
        for row in getattr(scene, group):
            finite &= np.isfinite(row)
    return finite


def find_spheres(scene: Scene) -> Spheres:
    """Spheres of a scene, at least one Gaussian, all of them finite."""
    points = np.ascontiguousarray(scene.positions.T, np.float64)
    octaves = np.rint(scene.log_scale.max(axis=0).astype(np.float64) / math.log(2.0))
    sizes = np.exp2(np.clip(octaves, -_OCTAVES, _OCTAVES))
    nearest, distance = _find_nearest(points)
    reach = _SIGMAS
    if nearest.shape[1]:
        ratios = (distance / (sizes[:, None] + sizes[nearest])).max(axis=1)
        reach = max(reach, float(np.quantile(ratios, _SHARE)))
    return Spheres(points, reach * sizes, nearest, distance)


def _find_nearest(points: NDArray[np.float64]) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Indices and distances ``(M, K)`` of the nearest others of each point."""
    from scipy.spatial import cKDTree

    count = len(points)
    number = min(NEIGHBOURS, count - 1)
    tree = cKDTree(points)
    nearest, distance = empty((count, number), np.int32), empty((count, number), np.float64)
    for start in range(0, count if number else 0, _CHUNK):
        part = np.arange(start, min(start + _CHUNK, count))
        away, found = tree.query(points[part], number + 1, workers=available_threads())
        # Of points in one place, a point is not always the first, nor among those found.
        own = found == part[:, None]
        own[~own.any(axis=1), -1] = True
        nearest[part] = found[~own].reshape(len(part), number)
        distance[part] = away[~own].reshape(len(part), number)
    return nearest, distance


def count_touching(spheres: Spheres) -> NDArray[np.int64]:
    """How many others each sphere touches, ``(M,)``; `NEIGHBOURS` stands for any larger number."""
    touching = spheres.touching
    counts = np.count_nonzero(touching, axis=1)
    few = np.flatnonzero(counts < NEIGHBOURS) if spheres.nearest.shape[1] == NEIGHBOURS else []
    if not len(few):
        return counts
    farthest, own = spheres.distance[few, -1], spheres.radius[few]
    # Spheres beyond the nearest neighbours are touched if they are large; those are counted by
    # size, and not again among the nearest.
    beyond = farthest < own + spheres.radius[spheres.nearest[few]].T
    counts[few] = np.count_nonzero(touching[few] & ~beyond.T, axis=1)
    for members, radius in by_size(spheres, np.arange(len(spheres.points))):
        asking = few[(farthest < own + radius) & (counts[few] < NEIGHBOURS)]
        if len(asking):
            away = _search(spheres.points[members], spheres.points[asking], NEIGHBOURS + 1)
            reached = away < (spheres.radius[asking] + radius)[:, None]
            itself = spheres.radius[asking] == radius
            counts[asking] += np.count_nonzero(reached, axis=1) - itself
    return np.minimum(counts, NEIGHBOURS)


def any_touching(
    spheres: Spheres, asking: NDArray[np.int64], others: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Which of the spheres `asking` touch any of `others`, in the order of the first."""
    touched = np.zeros(len(asking), bool)
    for members, radius in by_size(spheres, others):
        left = np.flatnonzero(~touched)
        if len(left):
            away = _search(spheres.points[members], spheres.points[asking[left]], 1)[:, 0]
            touched[left] = away < spheres.radius[asking[left]] + radius
    return touched


def by_size(
    spheres: Spheres, members: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], float]]:
    """Members of each radius, and the radius, the largest first."""
    for radius in np.unique(spheres.radius[members])[::-1]:
        yield members[spheres.radius[members] == radius], float(radius)


def _search(
    points: NDArray[np.float64], places: NDArray[np.float64], number: int
) -> NDArray[np.float64]:
    """Distances ``(P, number)`` from places to the nearest points; infinity if there are fewer."""
    from scipy.spatial import cKDTree

    tree = cKDTree(points)
    return tree.query(places, np.arange(1, number + 1), workers=available_threads())[0]

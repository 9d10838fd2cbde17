"""Distances between Gaussians, in units of their sizes.

The distance from one Gaussian to another is divided by the first one's largest standard deviation
plus the geometric mean of the other's. So a large Gaussian in a sparse background is not far from
its neighbours; and flat Gaussians, such as those of walls, are not near to everything in front of
them. Sizes are rounded to powers of two, and neighbours of each size are searched separately: a
large Gaussian may be nearer in these units than all the small ones in between.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.clean import finite_gaussians
from gs_codec.coding.morton import spatial_order
from gs_codec.coding.neighbours import Neighbours
from gs_codec.runtime.arrays import empty
from gs_codec.scene import Scene

#: A Gaussian's distance from others is that to its eighth nearest neighbour.
NEIGHBOURS = 8

#: The usual distance is this quantile of the distances.
_SHARE = 0.9

#: Number of Gaussians for estimating it, evenly spaced in the scene.
_SAMPLE = 4096

#: Range of the exponents of sizes in float32.
_OCTAVES = 126

#: Number of Gaussians whose neighbours are searched at once.
_CHUNK = 1 << 17


class Spacing(NamedTuple):
    """Centres and sizes of M Gaussians, and the nearest neighbours of each by centre.

    Attributes
    ----------
    points : ndarray, shape (M, 3), float64
    length : ndarray, shape (M,), float64
        Largest standard deviation, rounded to a power of two, scene units.
    width : ndarray, shape (M,), float64
        Geometric mean of the three, likewise rounded.
    nearest : ndarray, shape (M, K), int32
        The nearest first; K is `NEIGHBOURS`, or M - 1 if that is less.
    distance : ndarray, shape (M, K), float64
        Scene units.
    """

    points: NDArray[np.float64]
    length: NDArray[np.float64]
    width: NDArray[np.float64]
    nearest: NDArray[np.int32]
    distance: NDArray[np.float64]

    def in_sizes(self, which: NDArray[np.int64] | slice = slice(None)) -> NDArray[np.float64]:
        """Distances ``(m, K)`` to the nearest by centre, in units of sizes."""
        sizes = self.length[which, None] + self.width[self.nearest[which]]
        return self.distance[which] / sizes


def in_place_order(scene: Scene) -> NDArray[np.int64]:
    """Indices of the finite Gaussians along a Morton curve, for faster neighbour search."""
    finite = np.flatnonzero(finite_gaussians(scene))
    return finite[spatial_order(scene.positions[:, finite], scene.log_scale[:, finite])]


def find_spacing(scene: Scene) -> Spacing:
    """Sizes and neighbours in a scene of at least one Gaussian, all of them finite."""
    points = np.ascontiguousarray(scene.positions.T, np.float64)
    length = _rounded(scene.log_scale.max(axis=0).astype(np.float64))
    width = _rounded(scene.log_scale.mean(axis=0, dtype=np.float64))
    return Spacing(points, length, width, *_find_nearest(points))


def _rounded(log_size: NDArray[np.float64]) -> NDArray[np.float64]:
    """Round each size, given as a natural logarithm, to the nearest power of two."""
    return np.exp2(np.clip(np.rint(log_size / math.log(2.0)), -_OCTAVES, _OCTAVES))


def _find_nearest(points: NDArray[np.float64]) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Indices and distances ``(M, K)`` of the nearest neighbours of each point, without itself."""
    count = len(points)
    number = min(NEIGHBOURS, count - 1)
    neighbours = Neighbours(points)
    nearest, distance = empty((count, number), np.int32), empty((count, number), np.float64)
    for start in range(0, count if number else 0, _CHUNK):
        part = np.arange(start, min(start + _CHUNK, count))
        away, found = neighbours.nearest(points[part], number + 1)
        # Among coincident points, a point may not be the first found, or not be found at all.
        own = found == part[:, None]
        own[~own.any(axis=1), -1] = True
        nearest[part] = found[~own].reshape(len(part), number)
        distance[part] = away[~own].reshape(len(part), number)
    return nearest, distance


def usual_distance(spacing: Spacing) -> float:
    """The 90th percentile of the distance to the eighth nearest, in units of sizes."""
    count = len(spacing.points)
    some = np.arange(0, count, -(-count // _SAMPLE))
    return float(np.quantile(far_from_others(spacing, some), _SHARE))


def far_from_others(spacing: Spacing, which: NDArray[np.int64]) -> NDArray[np.float64]:
    """Distance ``(m,)`` of some Gaussians to their eighth nearest, in units of sizes.

    With fewer neighbours, to the farthest of them; 0 if there are none.
    """
    number = spacing.nearest.shape[1]
    if not number:
        return np.zeros(len(which))
    found = spacing.in_sizes(which)
    length, beyond = spacing.length[which], spacing.distance[which, -1]
    # Beyond the nearest centres, only Gaussians above a certain size can be nearer in units of
    # sizes. They are searched by size, together with the nearest.
    least = beyond / np.maximum(found.max(axis=1), np.finfo(float).tiny) - length
    found[spacing.width[spacing.nearest[which]] > least[:, None]] = np.inf
    for members, width in by_size(spacing.width, np.arange(len(spacing.points))):
        asking = np.flatnonzero(width > least)
        if not len(asking):
            continue
        places = spacing.points[which[asking]]
        away, _ = Neighbours(spacing.points[members]).nearest(places, number + 1)
        # A Gaussian finds itself among those of its own size.
        itself = spacing.width[which[asking]] == width
        away = np.where(itself[:, None], away[:, 1:], away[:, :-1])
        both = np.concatenate([found[asking], away / (length[asking, None] + width)], axis=1)
        found[asking] = np.partition(both, number - 1, axis=1)[:, :number]
    return found.max(axis=1)


def by_size(
    sizes: NDArray[np.float64], members: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], float]]:
    """Members and size of each of the distinct sizes ``(M,)``, the largest first."""
    of_members = sizes[members]
    for size in np.unique(of_members)[::-1]:
        yield members[of_members == size], float(size)

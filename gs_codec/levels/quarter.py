"""Reduce Gaussians to a quarter that looks the same from a distance.

In rounds, neighbours along Morton curves are merged in pairs, or hardly visible Gaussians are
dropped, whichever costs less. Only then are the attributes of each cluster computed, from all of
its Gaussians: their mean, weighted by mass, and their covariance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.morton import encode_morton
from gs_codec.merging.moments import axes_of, logits
from gs_codec.merging.pairs import (
    OPAQUE,
    Blobs,
    areas_of,
    blobs_of,
    cheapest,
    colours_of,
    contrast,
    lone_errors,
    merge_moments,
)
from gs_codec.runtime.arrays import empty
from gs_codec.runtime.kernels import kernel
from gs_codec.scene import Scene, inverse_of

#: Share of the remaining Gaussians that a round may remove.
_ROUND = 0.3

#: Number of following Gaussians on a Morton curve that are searched for neighbours.
_WINDOW = 24

#: Number of nearest neighbours that a Gaussian may merge with.
_NEAREST = 6

#: Start of the curve of each round, as a share of the extent: pairs separated by one curve are
#: close on another.
_STARTS = (0.0, 0.37, 0.21, 0.11, 0.29)

_DEPTH = 21

#: Variance that rasterisers add to each splat, squared pixels.
LOW_PASS = 0.3

_TINY = 1e-300


def merge_group(scene: Scene, number: int, footprint: float = 0.0) -> NDArray[np.int64]:
    """Cluster of each Gaussian of a scene, ``(N,)``, 0 to `number` - 1; -1 if dropped.

    Clusters are numbered in the scene's order of their heaviest Gaussians.
    """
    blobs, colours = widened(blobs_of(scene), footprint), colours_of(scene)
    into = np.arange(scene.count)
    turn = 0
    while (count := len(blobs.mass)) > number:
        order = _curve(blobs.means, _STARTS[turn % len(_STARTS)])
        turn += 1
        blobs, colours = Blobs(*(column[order] for column in blobs)), colours[:, order]
        near = np.empty((count, _NEAREST + 1), np.int64)
        _find_after(blobs.means, _WINDOW, near)
        quota = min(count - number, max(1, int(_ROUND * count)))
        seen = contrast(colours, blobs, near)
        first, second = cheapest(blobs, seen, lone_errors(blobs, seen), near, quota)
        blobs, colours, moved = _merged(blobs, colours, first, second)
        rank = np.empty(count, np.int64)
        rank[order] = moved
        into[into >= 0] = rank[into[into >= 0]]
    return _renumbered(into, scene, number)


def widened(blobs: Blobs, footprint: float) -> Blobs:
    """Gaussians widened by the low-pass of a rasteriser with pixels of this size."""
    covariances = blobs.covariances + LOW_PASS * footprint**2 * np.array([1, 1, 1, 0, 0, 0])
    mass = np.maximum(blobs.opacity * areas_of(covariances), _TINY)
    return blobs._replace(covariances=covariances, mass=mass)


def _curve(means: NDArray[np.float64], start: float) -> NDArray[np.int64]:
    """Order of ``means (N, 3)`` along a Morton curve."""
    low = means.min(axis=0)
    side = float((means.max(axis=0) - low).max()) or 1.0
    scale = ((1 << _DEPTH) - 1) / (side * (1 + max(_STARTS)))
    cells = ((means - low + start * side) * scale).astype(np.uint32)
    return np.argsort(encode_morton(np.ascontiguousarray(cells.T), (_DEPTH,) * 3), kind="stable")


@kernel
def _find_after(points, window, near):
    """Fill ``near (N, K + 1)``: each point, and the nearest of the `window` points after it.

    If there are fewer, the point itself is repeated.
    """
    wanted = near.shape[1]
    distances = np.empty(wanted)
    for i in range(len(points)):
        near[i, :] = i
        distances[:] = np.inf
        distances[0] = -1.0
        for j in range(i + 1, min(i + 1 + window, len(points))):
            dx, dy, dz = (
                points[j, 0] - points[i, 0],
                points[j, 1] - points[i, 1],
                points[j, 2] - points[i, 2],
            )
            distance = dx * dx + dy * dy + dz * dz
            place = wanted - 1
            if not distance < distances[place]:
                continue
            while distance < distances[place - 1]:
                distances[place], near[i, place] = distances[place - 1], near[i, place - 1]
                place -= 1
            distances[place], near[i, place] = distance, j


def _merged(
    blobs: Blobs,
    colours: NDArray[np.float64],
    first: NDArray[np.int64],
    second: NDArray[np.int64],
) -> tuple[Blobs, NDArray[np.float64], NDArray[np.int64]]:
    """The Gaussians that remain after merging pairs (equal pairs are dropped); where each went."""
    count = len(blobs.mass)
    moved = np.ones(count, np.int64)
    moved[second] = 0
    kept = np.flatnonzero(moved)
    moved = np.cumsum(moved) - 1
    moved[second] = np.where(first == second, -1, moved[first])
    first, second = first[first != second], second[first != second]
    covariances, (share, opacity) = merge_moments(blobs, first, second)
    left, places = Blobs(*(column[kept] for column in blobs)), moved[first]
    left.means[places] += share[:, None] * (blobs.means[second] - blobs.means[first])
    left.covariances[places] = covariances
    left.opacity[places] = opacity
    left.mass[places] = np.maximum(opacity * areas_of(covariances), _TINY)
    mixed = colours[:, first] * (1 - share) + colours[:, second] * share
    colours = colours[:, kept]
    colours[:, places] = mixed
    return left, colours, moved


def _renumbered(into: NDArray[np.int64], scene: Scene, number: int) -> NDArray[np.int64]:
    """Renumber clusters in the order of the first Gaussian of each."""
    members = np.flatnonzero(into >= 0)
    first = np.full(number, scene.count)
    np.minimum.at(first, into[members], members)
    into[members] = inverse_of(np.argsort(first, kind="stable"))[into[members]]
    return into


class Clusters:
    """Clusters of a scene's Gaussians, and the Gaussians that replace them."""

    def __init__(self, scene: Scene, into: NDArray[np.int64], number: int) -> None:
        self.members = np.flatnonzero(into >= 0)
        # Sort members by cluster, so that sums are over runs.
        self.members = self.members[np.argsort(into[self.members], kind="stable")]
        self.starts = np.searchsorted(into[self.members], np.arange(number))
        self.of = into[self.members]
        self.scene = scene.take(self.members)
        self.blobs = blobs_of(self.scene)

    def _sum(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sums of ``values (M, ...)`` of the members of each cluster."""
        return np.add.reduceat(values, self.starts, axis=0)

    def merged(self, footprint: float = 0.0) -> Scene:
        """The Gaussian that replaces each cluster.

        `footprint` is the pixel size in scene units of a rasteriser that widens splats by its
        low-pass. Opacities are chosen so that the cluster covers as much as its members; 0 means no
        widening.
        """
        blobs, widened = self.blobs, LOW_PASS * footprint * footprint
        mass = np.maximum(blobs.opacity * areas_of(blobs.covariances, widened), _TINY)
        whole = self._sum(mass)
        share = mass / whole[self.of]
        means = self._sum(share[:, None] * blobs.means)
        a = blobs.means - means[self.of]
        between = np.stack([a[:, i] * a[:, j] for i, j in _PAIRS], axis=1)
        covariances = self._sum(share[:, None] * (blobs.covariances + between))
        opacity = np.minimum(whole / areas_of(covariances, widened), OPAQUE)
        log_scale, rot = axes_of(covariances)
        weights = share.astype(np.float32)

        def mean(planes: NDArray[np.float32]) -> NDArray[np.float32]:
            found = empty((len(planes), len(self.starts)), np.float32)
            for row, plane in zip(found, planes, strict=True):
                row[:] = np.add.reduceat(plane * weights, self.starts)
            return found

        return Scene(
            positions=means.T.astype(np.float32),
            f_dc=mean(self.scene.f_dc),
            f_rest=mean(self.scene.f_rest),
            opacity=logits(opacity)[None],
            log_scale=log_scale,
            rot=rot,
        )


#: Axes of the entries of a covariance.
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))


def spacing(blobs: Blobs) -> float:
    """Spacing of Gaussians: median distance of neighbours, weighted by mass."""
    order = _curve(blobs.means, 0.0)
    means, mass = blobs.means[order], blobs.mass[order]
    near = np.empty((len(means), 2), np.int64)
    _find_after(means, _WINDOW, near)
    spacings = np.sqrt(((means[near[:, 1]] - means) ** 2).sum(axis=1))
    # The median by mass.
    order = np.argsort(spacings, kind="stable")
    sums = np.cumsum(mass[order])
    return float(spacings[order][np.searchsorted(sums, 0.5 * sums[-1])])

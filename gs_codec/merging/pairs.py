"""Merge pairs of Gaussians, preserving mass, mean, covariance and colour; choose the pairs.

The mass of a Gaussian is its opacity times the root mean square of its projected area over all
directions, because views show its area, not its volume.

The error of a merge is measured in three views along the axes: the integral of the squared
difference between the two Gaussians and the merged one, in closed form.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.exact_math import exact_exp
from gs_codec.merging.moments import axes_of, covariances_of, logits
from gs_codec.runtime.arrays import empty
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.threads import run_all
from gs_codec.scene import SH_C0, Scene

#: Maximum opacity of a merged Gaussian, because the rasteriser draws no more.
OPAQUE = 0.99

#: Minimum mass and area, to avoid division by 0.
_TINY = 1e-300

_CHUNK = 1 << 13


class Blobs(NamedTuple):
    """The properties of Gaussians that determine merging, float64.

    Attributes
    ----------
    means : ndarray, shape (N, 3)
    covariances : ndarray, shape (N, 6)
        xx, yy, zz, xy, yz, zx.
    opacity : ndarray, shape (N,)
        0-1.
    mass : ndarray, shape (N,)
        Opacity times area, in squared scene units.
    """

    means: NDArray[np.float64]
    covariances: NDArray[np.float64]
    opacity: NDArray[np.float64]
    mass: NDArray[np.float64]


def blobs_of(scene: Scene) -> Blobs:
    """Moments and masses of a scene's Gaussians; attributes must be finite."""
    covariances, opacity = covariances_of(scene)
    mass = np.maximum(opacity * areas_of(covariances), _TINY)
    return Blobs(np.ascontiguousarray(scene.positions.T, np.float64), covariances, opacity, mass)


def areas_of(covariances: NDArray[np.float64], widened: float = 0.0) -> NDArray[np.float64]:
    """Root mean square of the areas over all directions, of ``covariances (N, 6)``, over 2 pi.

    `widened` is a variance added along all axes.
    """
    xx, yy, zz, xy, yz, zx = covariances.T
    xx, yy, zz = xx + widened, yy + widened, zz + widened
    minors = (xx * yy - xy * xy) + (yy * zz - yz * yz) + (zz * xx - zx * zx)
    return np.sqrt(np.maximum(minors / 3, _TINY))


def merge_pairs(
    scene: Scene, blobs: Blobs, first: NDArray[np.int64], second: NDArray[np.int64]
) -> Scene:
    """Merge pairs of Gaussians; the result is in the pairs' order.

    Parameters
    ----------
    scene : Scene
    blobs : Blobs
        `blobs_of` the scene.
    first, second : ndarray, shape (M,), int64
        Indices of each pair's Gaussians. Extra properties come from `first`.
    """
    covariances, (share, opacity) = merge_moments(blobs, first, second)
    log_scale, rot = axes_of(covariances)

    def mean(planes: NDArray[np.float32]) -> NDArray[np.float32]:
        merged = empty((len(planes), len(first)), np.float32)
        for row, plane in zip(merged, planes, strict=True):
            row[:] = plane[first] * (1 - share) + plane[second] * share
        return merged

    return replace(
        scene.take(first),
        positions=mean(scene.positions),
        f_dc=mean(scene.f_dc),
        f_rest=mean(scene.f_rest),
        opacity=logits(opacity)[None],
        log_scale=log_scale,
        rot=rot,
    )


def merge_moments(
    blobs: Blobs, first: NDArray[np.int64], second: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Covariances ``(M, 6)`` of merged pairs; ``(2, M)``: shares of `second`, and opacities."""
    covariances, of_pair = np.empty((len(first), 6)), np.empty((2, len(first)))
    _merge_all(blobs.means, blobs.covariances, blobs.mass, first, second, covariances, of_pair)
    return covariances, of_pair


def lone_errors(blobs: Blobs, colours: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squared error in three views after removing each Gaussian, ``(N,)``; see `merge_errors`."""
    xx, yy, zz, xy, yz, zx = blobs.covariances.T
    minors = (xx * yy - xy * xy, yy * zz - yz * yz, zz * xx - zx * zx)
    areas = np.sum([np.sqrt(np.maximum(minor, 0.0)) for minor in minors], axis=0)
    return blobs.opacity**2 * (colours * colours).sum(axis=1) * areas


def merge_errors(
    blobs: Blobs, colours: NDArray[np.float64], near: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Squared error in three views after merging each Gaussian with each of its neighbours.

    Parameters
    ----------
    blobs : Blobs
    colours : ndarray, shape (N, C)
        Contribution of a Gaussian to a pixel where its alpha is 1.
    near : ndarray, shape (N, K)
        Indices of neighbours.

    Returns
    -------
    ndarray, shape (N, K)
        Infinite for a Gaussian with itself, and for pairs that an earlier row also has.
    """
    errors = empty(near.shape, np.float64)
    alone = lone_errors(blobs, colours)

    def run(start: int) -> None:
        _merge_errors(*blobs, colours, alone, near, start, errors[start : start + _CHUNK])

    run_all(run, range(0, len(near), _CHUNK))
    return errors


@inlined
def _minor(covariance, axis):
    """Determinant of a covariance projected along an axis, and its entries."""
    a, b, c = covariance[axis], covariance[3 + axis], covariance[(axis + 1) % 3]
    return max(a * c - b * b, 0.0), a, b, c


@inlined
def _merge_two(means, covariances, mass, i, j, offset, merged):
    """Fill ``offset (3,)``, the vector from i to j, and the merged covariance, ``merged (6,)``.

    Returns the share of j in the mass, and the merged opacity.
    """
    whole = mass[i] + mass[j]
    share = mass[j] / whole
    minors = 0.0
    for axis in range(3):
        offset[axis] = means[j, axis] - means[i, axis]
    for axis in range(3):
        for k, other in ((axis, axis), (3 + axis, (axis + 1) % 3)):
            between = share * (1.0 - share) * offset[axis] * offset[other]
            mean = covariances[i, k] + share * (covariances[j, k] - covariances[i, k])
            merged[k] = mean + between
    for axis in range(3):
        minors += _minor(merged, axis)[0]
    return share, min(whole / np.sqrt(max(minors / 3.0, _TINY)), OPAQUE)


@kernel
def _merge_all(means, covariances, mass, first, second, merged, of_pair):
    """Fill ``merged (M, 6)`` and ``of_pair (2, M)``: mass shares of `second`, and opacities."""
    offset = np.empty(3)
    for n in range(len(first)):
        share, opacity = _merge_two(
            means, covariances, mass, first[n], second[n], offset, merged[n]
        )
        of_pair[0, n], of_pair[1, n] = share, opacity


@inlined
def _product(first, second, offset, axis, share):
    """Integral over pi of the product of two splats of height 1, at distance `share * offset`."""
    area, a, b, c = _minor(first, axis)
    other_area, d, e, f = _minor(second, axis)
    a, b, c = a + d, b + e, c + f
    sharp = a * c - b * b
    if not sharp > 0.0:
        return 0.0
    x, y = share * offset[axis], share * offset[(axis + 1) % 3]
    q = (x * x * c - 2.0 * x * y * b + y * y * a) / sharp
    return 2.0 * np.sqrt(area / sharp * other_area) * exact_exp(-0.5 * q)


@kernel
def _merge_errors(means, covariances, opacity, mass, colours, alone, near, start, errors):
    merged, offset = np.empty(6), np.empty(3)
    for row, column in np.ndindex(errors.shape):
        i, j = start + row, near[start + row, column]
        errors[row, column] = np.inf
        if i == j or (j < i and _is_in(near[j], i)):
            continue
        share, height = _merge_two(means, covariances, mass, i, j, offset, merged)
        both = with_i = with_j = itself = 0.0
        for channel in range(colours.shape[1]):
            a, b = opacity[i] * colours[i, channel], opacity[j] * colours[j, channel]
            mean = (1.0 - share) * colours[i, channel] + share * colours[j, channel]
            both += a * b
            with_i += a * height * mean
            with_j += b * height * mean
            itself += (height * mean) ** 2
        error = alone[i] + alone[j]
        for axis in range(3):
            error += itself * np.sqrt(_minor(merged, axis)[0])
            error += 2.0 * both * _product(covariances[i], covariances[j], offset, axis, 1.0)
            error -= 2.0 * with_i * _product(covariances[i], merged, offset, axis, share)
            error -= 2.0 * with_j * _product(covariances[j], merged, offset, axis, 1.0 - share)
        if error < np.inf:
            errors[row, column] = max(error, 0.0)


@inlined
def _is_in(row, number):
    found = False
    for value in row:
        found |= value == number
    return found


#: Weight of alpha relative to the three colours.
_ALPHA = 0.3


def colours_of(scene: Scene) -> NDArray[np.float64]:
    """Colours of a scene's Gaussians without SH-AC, ``(3, N)``, at least 0."""
    return np.maximum(0.5 + SH_C0 * scene.f_dc.astype(np.float64), 0.0)


def contrast(
    colours: NDArray[np.float64], blobs: Blobs, near: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Colours ``(3, N)`` minus the neighbours' mean, and a constant for alpha, ``(N, 4)``."""
    weights = blobs.mass[near]
    weights /= weights.sum(axis=1, keepdims=True)
    around = [(colour[near] * weights).sum(axis=1) for colour in colours]
    return np.column_stack([*(colours - around), np.full(len(near), _ALPHA)])


def cheapest(
    blobs: Blobs,
    colours: NDArray[np.float64],
    scores: NDArray[np.float64],
    near: NDArray[np.int64],
    quota: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs to merge, and Gaussians to drop (paired with themselves): `quota` in total.

    The cost of a merge is compared with the scores of its two Gaussians, which are the costs of
    dropping them.
    """
    count, errors = len(near), merge_errors(blobs, colours, near).ravel()
    at = np.flatnonzero(errors < np.inf)
    first, second = at // near.shape[1], near.ravel()[at]
    with np.errstate(over="ignore", invalid="ignore"):
        seen = np.sqrt(scores / np.maximum(lone_errors(blobs, colours), _TINY))
        costs = errors[at] * seen[first] * seen[second]
    # In other pairs, one Gaussian would be dropped before they merge.
    pays = costs < np.minimum(scores[first], scores[second])
    alone = np.arange(count)
    first, second = np.append(alone, first[pays]), np.append(alone, second[pays])
    order = np.argsort(np.append(scores, costs[pays]), kind="stable")
    chosen = np.empty(quota, np.int64)
    _choose(order, first, second, np.zeros(count, bool), chosen)
    return first[chosen], second[chosen]


@kernel
def _choose(order, first, second, used, chosen):
    """Fill `chosen` with pairs in order, skipping pairs with a Gaussian that is already used."""
    number = 0
    for pair in order:
        if number == len(chosen):
            break
        if not (used[first[pair]] or used[second[pair]]):
            used[first[pair]] = used[second[pair]] = True
            chosen[number] = pair
            number += 1

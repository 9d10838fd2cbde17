"""A round of reduction: choose the Gaussians to drop and the pairs to merge at the lowest error."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.merging.pairs import Blobs, lone_errors, merge_errors
from gs_codec.runtime.kernels import kernel
from gs_codec.scene import SH_C0, Scene

#: Weight of alpha relative to the three colours.
_ALPHA = 0.3

#: Lower bound of errors that scores are divided by.
_TINY = 1e-300


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

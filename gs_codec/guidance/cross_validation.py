"""How well views predict the sensitivities in other views: cross-validation between regions.

The sensitivity measured in views is blended with the one that camera-free rules expect from a
Gaussian's shape and opacity. The share of the rules is chosen so that step sizes from all regions
of camera space but one suit the views of that region best.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.codecs.adaptive.step_sizes import Sensitivity, expected_sensitivity
from gs_codec.coding.axes import sort_axes
from gs_codec.coding.exact_math import combine, main_axis
from gs_codec.scene import Scene

#: Number of times the cameras are halved: 16 regions.
_HALVINGS = 4

#: Candidate shares of the camera-free rules in a blend.
_SHARES = (
    0.003,
    0.005,
    0.01,
    0.02,
    0.03,
    0.05,
    0.07,
    0.1,
    0.15,
    0.2,
    0.3,
    0.4,
    0.5,
    0.6,
    0.7,
    0.8,
    0.9,
    0.95,
)

#: Minimum share with estimated cameras, because real cameras may have been elsewhere.
_ESTIMATED = 0.15

#: Approximate number of Gaussians that are compared.
_SAMPLE = 20_000


def blind_share(
    scene: Scene, weights: NDArray[np.float32], cameras: Sequence[Camera], estimated: bool = False
) -> float:
    """The share of the camera-free rules with which each region is best predicted by the others.

    With step sizes from sensitivities s, and the same bits, views of sensitivity t lose ``mean(t /
    s)`` times the geometric mean of s. If all views are from one place, the largest share is used.

    Parameters
    ----------
    scene : Scene
    weights : ndarray, shape (views, N), float32
        `squared_weights` of the scene.
    cameras : sequence of Camera
    estimated : bool
        Whether cameras were estimated from the scene.
    """
    some = np.arange(0, scene.count, max(1, scene.count // _SAMPLE))
    sample, by_view = scene.take(some), weights[:, some].astype(np.float64, "C")
    scales = sort_axes(sample.log_scale, sample.rot)[1]
    blind = expected_sensitivity(sample.opacity[0], scales).colour
    total = by_view.sum(axis=0)
    losses = np.zeros(len(_SHARES))
    for region in regions(cameras, _HALVINGS):
        there = by_view[region].sum(axis=0)
        rest = np.maximum(total - there, 0.0)
        level = (rest / blind).mean()
        if not (there.any() and level > 0):
            continue
        for k, share in enumerate(_SHARES):
            blended = (1 - share) * rest + share * level * blind
            losses[k] += np.log((there / blended).mean()) + np.log(blended).mean()
    share = _SHARES[int(np.argmin(losses))] if losses.any() else _SHARES[-1]
    return max(share, _ESTIMATED) if estimated else share


def blend(found: Sensitivity, expected: Sensitivity, share: float) -> Sensitivity:
    """Blend measured and expected sensitivities; `share` is that of `expected`."""

    def mixed(s: NDArray[np.float64], e: NDArray[np.float64]) -> NDArray[np.float64]:
        return (1 - share) * s + share * (s / e).mean(axis=-1, keepdims=True) * e

    return Sensitivity(*(mixed(s, e) for s, e in zip(found, expected, strict=True)))


def regions(cameras: Sequence[Camera], halvings: int) -> list[NDArray[np.int64]]:
    """Parts of camera space: cameras halved along their main axis, recursively.

    A single camera has no regions.
    """
    where = np.array([camera.position for camera in cameras])
    spread = np.sqrt(np.mean((where - where.mean(axis=0)) ** 2))
    forward = np.array([camera.rotation[2] for camera in cameras])
    rows = np.concatenate([where / max(spread, 1e-12), forward], axis=1).T
    found = [np.arange(len(cameras))]
    for _ in range(halvings):
        halves = []
        for region in found:
            part = rows[:, region] - rows[:, region].mean(axis=1, keepdims=True)
            order = region[np.argsort(combine(main_axis(part), part), kind="stable")]
            halves += [order[: len(order) // 2], order[len(order) // 2 :]]
        found = [half for half in halves if len(half)]
    return found if len(cameras) > 1 else []

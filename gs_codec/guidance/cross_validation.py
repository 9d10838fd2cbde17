"""How far views can be trusted to tell what other views see: cross-validation between regions.

The sensitivity that views sum up is blended with what the camera-free rules expect of a Gaussian of
this shape and opacity. How much of the blend they are is chosen so that the step sizes of all
regions but one of camera space suit the views of that region best.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.codecs.adaptive.step_sizes import Sensitivity, expected_sensitivity
from gs_codec.coding.axes import sort_axes
from gs_codec.coding.linear import combine, main_axis
from gs_codec.scene import Scene

#: Times that the cameras are halved: 16 regions.
_HALVINGS = 4

#: Shares of the camera-free rules in a blend that are tried.
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

#: The least share with estimated cameras: others may have been where none is.
_ESTIMATED = 0.15

#: Gaussians that are compared are about this many.
_SAMPLE = 20_000


def blind_share(
    scene: Scene, weights: NDArray[np.float32], cameras: Sequence[Camera], estimated: bool = False
) -> float:
    """The share of the camera-free rules with which views of a region suit all others best.

    With step sizes by sensitivities s, and the same bits, views of sensitivity t lose
    ``mean(t / s)`` times the geometric mean of s. Views of one place cannot tell, and get the
    largest share.

    Parameters
    ----------
    scene : Scene
    weights : ndarray, shape (views, N), float32
        `squared_weights` of the scene.
    cameras : sequence of Camera
    estimated : bool
        Whether cameras were guessed from the scene.
    """
    some = np.arange(0, scene.count, max(1, scene.count // _SAMPLE))
    sample, by_view = scene.take(some), weights[:, some].astype(np.float64)
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
    """Replace this share of the sensitivities of views by what is expected, at the same level."""

    def mixed(s: NDArray[np.float64], e: NDArray[np.float64]) -> NDArray[np.float64]:
        return (1 - share) * s + share * (s / e).mean(axis=-1, keepdims=True) * e

    return Sensitivity(*(mixed(s, e) for s, e in zip(found, expected, strict=True)))


def regions(cameras: Sequence[Camera], halvings: int) -> list[NDArray[np.int64]]:
    """Parts of camera space: the cameras halved along their main axis, and the halves again.

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

"""Fewer Gaussians: the least seen are dropped and neighbours merged, whichever costs less.

Rounds go on until the number is reached. Each compares the error without a Gaussian, as views or,
without cameras, rules tell it, with that of a merge; see `merge`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.step_sizes import expected_sensitivity
from gs_codec.coding.axes import sort_axes
from gs_codec.coding.clean import identity_for_zero
from gs_codec.edit.merge import Blobs, blobs_of, lone_errors, merge_errors, merge_pairs
from gs_codec.errors import InvalidInput
from gs_codec.preparation.pipeline import choose_views
from gs_codec.preparation.prune import keep_highest, leave_one_out
from gs_codec.preparation.reference_views import ReferenceViews
from gs_codec.preparation.refit_colour import refit_colour
from gs_codec.preparation.steps import Plan, Steps
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.threads import available_threads
from gs_codec.scene import GROUPS, SH_C0, Scene

#: Share of the remaining Gaussians that a round may remove.
_ROUND = 0.2

#: Neighbours that a Gaussian may merge with.
_NEIGHBOURS = 10

#: Weight of alpha beside the three colours.
_ALPHA = 0.3

#: Conjugate-gradient iterations on the colours.
_REFIT = 10


def decimate(
    scene: Scene, number: int, plan: Plan | None = None, progress: Progress | None = None
) -> Scene:
    """A scene of `number` Gaussians that looks alike; the scene itself if it has no more."""
    if number < 1:
        raise InvalidInput(f"gaussians {number}: expected at least 1")
    if scene.count <= number:
        return scene
    scene = _finite(scene, number)
    scene, _ = identity_for_zero(scene)
    if plan is None:
        return _reduce(scene, number, None, progress)
    views = choose_views(scene, replace(plan, steps=Steps(), gt_images=None), progress).renders
    reduced = _reduce(scene, number, views, progress)
    return refit_colour(reduced, views, _REFIT, keep_zeros=False, progress=progress)[0]


def _finite(scene: Scene, number: int) -> Scene:
    """The scene without values that are not finite, unless fewer than `number` would remain."""
    finite = np.ones(scene.count, bool)
    for group in GROUPS:
        for row in getattr(scene, group):
            finite &= np.isfinite(row)
    gone = min(np.count_nonzero(~finite), scene.count - number)
    return scene.take(keep_highest(finite, gone)) if gone else scene


def _reduce(
    scene: Scene, number: int, views: ReferenceViews | None, progress: Progress | None
) -> Scene:
    quotas = list(_quotas(scene.count, number))
    advance = step_counter(progress, "decimate", len(quotas))
    for turn, quota in enumerate(quotas, 1):
        blobs, near = blobs_of(scene), _neighbours(scene.positions)
        colours = _contrast(scene, blobs, near)
        alone = lone_errors(blobs, colours)
        if views is None:
            scores = _expected(scene) * alone / blobs.opacity / blobs.mass
        else:
            scores = leave_one_out(scene, views, f"round {turn}", progress)
        factor = scores / np.maximum(alone, 1e-300)
        errors = merge_errors(blobs, colours, near) * combine_factors(factor, near)
        scene = _round(scene, blobs, scores, errors, near, quota)
        advance()
    return scene

def combine_factors(f, near):
    return np.sqrt(f[:, None] * f[near])

def _quotas(count: int, number: int) -> Iterator[int]:
    """How many Gaussians each round removes."""
    while count > number:
        yield (removed := min(count - number, max(1, int(_ROUND * count))))
        count -= removed


def _neighbours(positions: NDArray[np.float32]) -> NDArray[np.int64]:
    """Indices ``(N, K + 1)`` of the Gaussians nearest to each, itself among them."""
    from scipy.spatial import cKDTree

    count = positions.shape[1]
    extent = max(float(np.ptp(positions.astype(np.float64), axis=1).max()), 1.0)
    # A tree of equal points would be one leaf, searched in quadratic time.
    points = np.column_stack([positions.T, np.linspace(0, 1e-9 * extent, count)])
    near = cKDTree(points).query(points, min(_NEIGHBOURS + 1, count), workers=available_threads())
    return near[1]


def _contrast(scene: Scene, blobs: Blobs, near: NDArray[np.int64]) -> NDArray[np.float64]:
    """Colours less the mean of the neighbours', and a constant for alpha, ``(N, 4)``."""
    colours = np.maximum(0.5 + SH_C0 * scene.f_dc.astype(np.float64), 0.0)
    weights = blobs.mass[near]
    weights /= weights.sum(axis=1, keepdims=True)
    behind = [(colour[near] * weights).sum(axis=1) for colour in colours]
    return np.column_stack([*(colours - behind), np.full(scene.count, _ALPHA)])


def _expected(scene: Scene) -> NDArray[np.float64]:
    scales = sort_axes(scene.log_scale, scene.rot)[1]
    return expected_sensitivity(scene.opacity[0], scales).colour


def _round(scene, blobs, scores, errors, near, quota):
    """Remove `quota` Gaussians."""
    count = scene.count
    at = np.flatnonzero(np.isfinite(errors))
    first = np.concatenate([np.arange(count), at // near.shape[1]])
    second = np.concatenate([np.arange(count), near.ravel()[at]])
    order = np.argsort(np.concatenate([scores, errors.ravel()[at]]), kind="stable")
    chosen = order[_choose(order, first, second, np.zeros(count, bool), np.zeros(len(order), bool), quota)]
    first, second = first[chosen], second[chosen]
    kept = np.ones(count, bool)
    lighter = blobs.mass[first] < blobs.mass[second]
    first, second = np.where(lighter, second, first), np.where(lighter, first, second)
    kept[second] = False
    pairs = first != second
    first, second = first[pairs], second[pairs]
    merged = merge_pairs(scene, blobs, first, second)
    left = scene.take(kept)
    places = (np.cumsum(kept) - 1)[first]
    for group in GROUPS:
        getattr(left, group)[:, places] = getattr(merged, group)
    return left


@kernel
def _choose(order, first, second, used, chosen, quota):
    for place in range(len(order)):
        i, j = first[order[place]], second[order[place]]
        if quota and not used[i] and not used[j]:
            used[i] = used[j] = chosen[place] = True
            quota -= 1
    return chosen

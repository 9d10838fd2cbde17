"""Reduce the number of Gaussians: drop the least visible or merge neighbours, at least cost.

Rounds repeat until the number is reached. Each compares the error of dropping a Gaussian, from
views or camera-free rules, with that of a merge; see `pairs`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.clean import finite_gaussians, identity_for_zero
from gs_codec.coding.morton import spatial_order
from gs_codec.coding.neighbours import Neighbours
from gs_codec.edit.clouds import on_clouds
from gs_codec.errors import InvalidInput
from gs_codec.merging.pairs import Blobs, blobs_of, cheapest, colours_of, contrast, merge_pairs
from gs_codec.plan import Plan, Steps
from gs_codec.preparation.prune import expected_weight, keep_highest, leave_one_out
from gs_codec.preparation.reference_views import ReferenceViews
from gs_codec.preparation.refit_colour import refit_colour
from gs_codec.preparation.view_selection import choose_views
from gs_codec.report import Progress, step_counter
from gs_codec.scene import GROUPS, Scene

#: Share of the remaining Gaussians that a round may remove.
_ROUND = 0.2

#: Number of neighbours that a Gaussian may merge with.
_NEIGHBOURS = 10

#: Conjugate-gradient iterations on the colours; with 10, few views would be overfitted.
_REFIT = 4


@on_clouds
def decimate(
    scene: Scene, number: int, plan: Plan | None = None, progress: Progress | None = None
) -> Scene:
    """Reduce a scene to a number of Gaussians that look as similar as possible.

    In rounds, the least visible Gaussians are dropped, and pairs of neighbours are merged into one
    with their mass, mean and covariance. Gaussians with values that are not finite are dropped
    first.

    Parameters
    ----------
    scene : open3d.t.geometry.PointCloud
        A cloud from `gs_codec.read`.
    number : int
        1 or more.
    plan : Plan, optional
        Cameras that measure visibility, and to which colours are fitted at the end; only the
        cameras, their number, width and background are used. Without a plan, a rule based on
        opacity, size and the colours of neighbours is used.
    progress : callable, optional
        As in `gs_codec.read`.

    Returns
    -------
    open3d.t.geometry.PointCloud
        Exactly `number` Gaussians, in the scene's order; all if there are no more. A merged
        Gaussian takes the index and the extra properties of the heavier one.

    Raises
    ------
    InvalidInput
        If the number is below 1, or the plan has no cameras.

    Examples
    --------
    >>> cloud = gs_codec.read("scene.ply")
    >>> fewer = gs_codec.edit.decimate(cloud, 800)
    >>> fewer.point.positions.shape
    SizeVector[800, 3]

    With cameras, which measure visibility and refit colours:

    >>> fewer = gs_codec.edit.decimate(cloud, 800, gs_codec.Plan(cameras="cameras.json", width=48))
    """
    if number < 1:
        raise InvalidInput(f"gaussians {number}: expected at least 1")
    number = int(number)
    if scene.count <= number:
        return scene
    finite, _ = identity_for_zero(_finite(scene, number))
    if finite.count == number:
        return finite
    if plan is None:
        return _reduce(finite, number, None, progress)
    plan = replace(plan, steps=Steps(), gt_images=None, checkpoint=None)
    views = choose_views(finite, plan, progress).renders.drawn(progress)
    reduced = _reduce(finite, number, views, progress)
    return refit_colour(reduced, views, _REFIT, keep_zeros=False, progress=progress)[0]


def _finite(scene: Scene, number: int) -> Scene:
    """The scene without values that are not finite, unless too few others remain."""
    finite = finite_gaussians(scene)
    gone = min(int(np.count_nonzero(~finite)), scene.count - number)
    return scene.take(keep_highest(finite, gone)) if gone else scene


def _reduce(
    scene: Scene, number: int, views: ReferenceViews | None, progress: Progress | None
) -> Scene:
    """Remove Gaussians in rounds."""
    # Gaussians not visible in these views count too, because other views may show them. On a room,
    # held-out views lose 6 dB less.
    anywhere = views and replace(views, origin="anywhere")
    quotas = list(_quotas(scene.count, number))
    advance = step_counter(progress, "decimate", len(quotas))
    # Neighbours in space are then near in memory, which is several times as fast.
    places = spatial_order(scene.positions, scene.log_scale)
    scene = scene.take(places)
    for turn, quota in enumerate(quotas, 1):
        blobs, near = blobs_of(scene), _neighbours(scene.positions)
        colours = contrast(colours_of(scene), blobs, near)
        if anywhere is None:
            scores = expected_weight(scene) * (colours * colours).sum(axis=1)
        else:
            scores = leave_one_out(scene, anywhere, f"round {turn}", progress)
        first, second = cheapest(blobs, colours, scores, near, quota)
        scene, kept = _merge(scene, blobs, first, second)
        places = places[kept]
        advance()
    return scene.take(np.argsort(places))


def _quotas(count: int, number: int) -> Iterator[int]:
    """Number of Gaussians that each round removes."""
    while count > number:
        removed = min(count - number, max(1, int(_ROUND * count)))
        yield removed
        count -= removed


def _neighbours(positions: NDArray[np.float32]) -> NDArray[np.int64]:
    """Indices ``(N, K + 1)`` of the Gaussians nearest to each, including itself."""
    wanted = min(_NEIGHBOURS + 1, positions.shape[1])
    return Neighbours(positions.T).nearest(positions.T, wanted)[1]


def _merge(
    scene: Scene, blobs: Blobs, first: NDArray[np.int64], second: NDArray[np.int64]
) -> tuple[Scene, NDArray[np.bool_]]:
    """Replace each pair by one Gaussian, equal pairs by none; also return which remain."""
    heavier = blobs.mass[first] >= blobs.mass[second]
    first, second = np.where(heavier, first, second), np.where(heavier, second, first)
    kept = np.ones(scene.count, bool)
    kept[second] = False
    first, second = first[first != second], second[first != second]
    left, places = scene.take(kept), (np.cumsum(kept) - 1)[first]
    if not len(first):
        return left, kept
    merged = merge_pairs(scene, blobs, first, second)
    for group in GROUPS:
        getattr(left, group)[:, places] = getattr(merged, group)
    return left, kept

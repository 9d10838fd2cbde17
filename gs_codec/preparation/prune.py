"""Select Gaussians to prune: by position, by importance, or by leave-one-out error.

Every rule returns the indices of the remaining Gaussians, in the scene's order. Ties are removed in
the scene's order. A Gaussian whose score is NaN is removed first.

Removing splat k changes the pixels that it covers by ``S alpha / (1 - alpha) - alpha T c``, where S
is the light of everything behind it. The leave-one-out error sums the squared change over pixels
and views.

Errors of overlapping Gaussians do not add up, so scores are recomputed after each round.

Views that are merely spread around a scene may miss what its cameras saw. With those, the error
expected from a Gaussian's opacity and size counts as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.codecs.adaptive.step_sizes import expected_sensitivity
from gs_codec.coding.axes import sort_axes
from gs_codec.errors import InvalidInput
from gs_codec.formats.packed_values import sigmoid
from gs_codec.plan import GeometryRule, Steps
from gs_codec.preparation.balance import Balance
from gs_codec.preparation.reference_views import ReferenceViews, ViewSplit
from gs_codec.rendering.frame import make_frame
from gs_codec.rendering.renderer import render
from gs_codec.rendering.tiles_float32 import sum_errors_without
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.wording import counted
from gs_codec.scene import Scene

#: Exponent of a Gaussian's volume in LightGaussian's score.
_VOLUME_POWER = 0.1

#: Volumes are divided by this quantile of all volumes.
_VOLUME_QUANTILE = 0.9

#: Maximum share of the remaining Gaussians that a round may remove.
_ROUND = 0.2

#: Weight of the expected error, if views are merely spread around the scene.
_EXPECTED = 0.05

#: Number of bisections in the last round, which reaches the loss limit.
_BISECTIONS = 6


def portion(count: int, percent: float) -> int:
    """Number of Gaussians in `percent` percent of `count`, rounded down.

    Raises InvalidInput if no Gaussian would remain.
    """
    # The 1e-6 compensates for binary rounding of percentages: 7 % of 100 is 7.
    number = int(np.floor(count * percent / 100 + 1e-6))
    if number >= count > 0:
        raise InvalidInput(
            f"pruning {percent:g} % of {counted(count, 'Gaussian')} would leave none"
        )
    return number


def keep_highest(scores: NDArray, number: int) -> NDArray[np.int64]:
    """Indices of all but the `number` lowest of ``scores (N,)``."""
    return np.sort(np.argsort(scores, kind="stable")[number:])


def keep_near(scene: Scene, percent: float, rule: GeometryRule) -> NDArray[np.int64]:
    """Remove the `percent` farthest from the centre along x, then from the rest along y, then z.

    The paper's geometry pruning (Section 4.2): N (1 - theta2)^3 remain. The paper removes the
    largest absolute values (rule ``largest``), so its centre is the origin, wherever that lies in a
    capture; our default is the median.
    """
    centre = np.zeros(3)
    known = scene.positions[:, np.isfinite(scene.positions).all(axis=0)]
    if rule == "median" and known.size:
        centre = np.median(known.astype(np.float64), axis=1)
    kept = np.arange(scene.count)
    for axis in range(3):
        distance = np.abs(scene.positions[axis, kept].astype(np.float64) - centre[axis])
        nearness = np.nan_to_num(-distance, nan=-np.inf, neginf=-np.inf)
        kept = kept[keep_highest(nearness, portion(len(kept), percent))]
    return kept


def importance(
    scene: Scene, cameras: Sequence[Camera], progress: Progress | None = None
) -> NDArray[np.float64]:
    """LightGaussian's score (Fan et al. 2023, Section 3.2; the paper's Section 4.2), ``(N,)``.

    The score is opacity times the transmittance in front of the Gaussian, summed over pixels and
    views, times (volume / 90th percentile of volumes)^0.1. Larger volumes count as the 90th
    percentile.
    """
    seen = np.zeros(scene.count)
    advance = step_counter(progress, "importance", len(cameras))
    for camera in cameras:
        sums = render(scene, camera, accumulate=True).accumulations
        assert sums is not None
        seen += sums.transmittance
        advance()
    log_volume = scene.log_scale.sum(axis=0, dtype=np.float64)
    known = log_volume[np.isfinite(log_volume)]
    largest = np.quantile(known, _VOLUME_QUANTILE) if known.size else 0.0
    volume = np.exp(_VOLUME_POWER * np.minimum(log_volume - largest, 0.0))
    return np.nan_to_num(seen * sigmoid(scene.opacity[0].astype(np.float64)) * volume)


def leave_one_out(
    scene: Scene, views: ReferenceViews, stage: str, progress: Progress | None = None
) -> NDArray[np.float64]:
    """Squared error of a scene's views from removing each single Gaussian, ``(N,)``.

    Errors against other images are not a better guide: all Gaussians whose removal reduces the
    same error would be removed together, which is too many.
    """
    scores = np.zeros(scene.count)
    behind = np.array(views.background, np.float64)
    advance = step_counter(progress, f"leave-one-out, {stage}", len(views.cameras))
    for camera in views.cameras:
        frame = make_frame(scene, camera)
        errors = np.zeros((frame.pairs, 1))
        frame.over_tiles(sum_errors_without, camera.width, camera.height, behind, errors)
        scores[frame.splats.gaussians] += frame.sum_pairs(errors)[:, 0]
        advance()
    if views.origin == "anywhere":
        scores += _EXPECTED / (1 - _EXPECTED) * scores.mean() * expected_weight(scene)
    return scores


def expected_weight(scene: Scene) -> NDArray[np.float64]:
    """Weight ``(N,)`` that camera-free rules expect of each Gaussian, normalised to a mean of 1."""
    finite = np.isfinite(scene.log_scale).all(axis=0) & np.isfinite(scene.opacity[0])
    usable, expected = scene.take(np.flatnonzero(finite)), np.zeros(scene.count)
    scales = sort_axes(usable.log_scale, usable.rot)[1]
    expected[finite] = expected_sensitivity(usable.opacity[0], scales).colour
    return expected / max(expected.mean(), 1e-300)


def prune_leave_one_out(
    scene: Scene,
    views: ViewSplit,
    steps: Steps,
    progress: Progress | None = None,
    balance: Balance | None = None,
) -> tuple[NDArray[np.int64], dict[str, Any]]:
    """Prune in rounds; return indices of the remaining Gaussians, and details of the rounds.

    Scores use the renders of `views`; the PSNR loss is measured on its photographs if there are
    any. With a limit on the loss but no number, as many are removed as the limit allows. With a
    balance, rounds continue as long as they pay off.
    """
    max_drop = steps.prune_max_psnr_drop
    wanted = portion(scene.count, steps.prune or 0.0)
    least = scene.count - wanted
    if steps.gaussians is not None:
        least = min(steps.gaussians, scene.count)
    elif not wanted and (max_drop is not None or balance is not None):
        least = 1
    kept = np.arange(scene.count)
    rounds: list[dict[str, Any]] = []
    references = views.references
    before = references.errors(scene, progress) if max_drop is not None else np.zeros(1)
    while len(kept) > least:
        current = scene.take(kept)
        scores = leave_one_out(current, views.renders, f"round {len(rounds) + 1}", progress)
        rounds.append({"gaussians": len(kept)})
        planned = removed = min(len(kept) - least, max(1, int(_ROUND * len(kept))))
        if max_drop is not None:
            removed = _allowed(current, scores, planned, references, before, max_drop, progress)
        left = kept[keep_highest(scores, removed)]
        if balance is not None and not balance.pays(scene.take(left)):
            break
        kept = left
        if removed < planned:
            break
    return kept, {"rounds": rounds}


def _allowed(
    scene: Scene,
    scores: NDArray[np.float64],
    most: int,
    references: ReferenceViews,
    before: NDArray[np.float64],
    max_drop: float,
    progress: Progress | None,
) -> int:
    """How many of the lowest scores, at most `most`, can be removed within `max_drop`."""

    def fits(number: int) -> bool:
        left = scene.take(keep_highest(scores, number))
        return references.drop(references.errors(left, progress), before) <= max_drop

    if fits(most):
        return most
    low, high = 0, most
    for _ in range(_BISECTIONS):
        middle = (low + high) // 2
        if fits(middle):
            low = middle
        else:
            high = middle
    return low

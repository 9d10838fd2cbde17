"""Error of images without one Gaussian (after POTR, arXiv 2601.14821), and pruning by it.

Without splat k, the pixels that it covers change by ``S alpha / (1 - alpha) - alpha T c``, where S
is the light of everything behind it. The squared change is summed over pixels and views.

Errors of single Gaussians do not add up where they cover each other, so scores are computed
again after each round.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.preparation.prune import keep_highest, portion
from gs_codec.preparation.reference_views import ReferenceViews, ViewSplit
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.frame import make_frame
from gs_codec.rendering.project import RED, TILE
from gs_codec.rendering.trace import tile_bounds, trace_down_to
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.kernels import kernel
from gs_codec.scene import Scene

#: Transmittance where a pixel ends; low, as the removal of an opaque splat shows what it hid.
_LEAST = 1e-6


def leave_one_out(
    scene: Scene,
    cameras: Sequence[Camera],
    background: Sequence[float] = (0.0, 0.0, 0.0),
    advance: Callable[[], None] | None = None,
) -> NDArray[np.float64]:
    """Squared error that the images of a scene would have without each single Gaussian.

    Errors against other images are not a better guide: all Gaussians whose removal reduces the
    same error would be removed together, which is too many.

    Parameters
    ----------
    scene : Scene
    cameras : sequence of Camera
    background : sequence of three float
        RGB behind the scene.
    advance : callable, optional
        Called after each view.

    Returns
    -------
    ndarray, shape (N,), float64
        Sum over views, pixels and colours.
    """
    scores = np.zeros(scene.count)
    behind = np.array(background, np.float64)
    for camera in cameras:
        frame = make_frame(scene, camera)
        errors = np.zeros((frame.pairs, 1))
        frame.over_tiles(_leave_out, camera.width, camera.height, behind, errors)
        scores += frame.sum_pairs(scene.count, errors)[:, 0]
        if advance is not None:
            advance()
    return scores


@kernel
def _leave_out(fields, splats, starts, first, end, columns, width, height, background, errors):
    """Fill ``errors (pairs, 1)``."""
    left = np.empty(TILE * TILE)
    pixels = np.empty(TILE * TILE, np.int64)
    alphas = np.empty(TILE * TILE)
    before = np.empty(TILE * TILE)
    behind = np.empty((TILE * TILE, 3))
    for tile in range(first, end):
        x0, x1, y0, y1 = tile_bounds(tile, columns, width, height)
        # First sum all light of each pixel; then go front to back and subtract what is passed.
        behind[:] = 0.0
        left[:] = 1.0
        for pair in range(starts[tile], starts[tile + 1]):
            field = fields[splats[pair]]
            count, _ = trace_down_to(_LEAST, field, x0, x1, y0, y1, left, pixels, alphas, before)
            for i in range(count):
                for channel in range(3):
                    behind[pixels[i], channel] += alphas[i] * before[i] * field[RED + channel]
        for pixel in range(TILE * TILE):
            for channel in range(3):
                behind[pixel, channel] += abs(left[pixel]) * background[channel]
        left[:] = 1.0
        for pair in range(starts[tile], starts[tile + 1]):
            field = fields[splats[pair]]
            count, _ = trace_down_to(_LEAST, field, x0, x1, y0, y1, left, pixels, alphas, before)
            added = 0.0
            for i in range(count):
                pixel = pixels[i]
                uncovered = alphas[i] / (1.0 - alphas[i])
                for channel in range(3):
                    own = alphas[i] * before[i] * field[RED + channel]
                    behind[pixel, channel] -= own
                    change = behind[pixel, channel] * uncovered - own
                    added += change * change
            errors[pair, 0] = added


#: Share of the remaining Gaussians that a round may remove.
_ROUND = 0.2

#: Bisections of the last round, where the loss reaches its limit.
_BISECTIONS = 6


def prune_leave_one_out(
    scene: Scene,
    views: ViewSplit,
    percent: float,
    max_drop: float | None,
    progress: Progress | None = None,
) -> tuple[NDArray[np.int64], dict[str, Any]]:
    """Prune in rounds; return indices of the Gaussians that stay, and details of the rounds.

    Parameters
    ----------
    scene : Scene
    views : ViewSplit
        Scores use its renders; `max_drop` is measured on its photographs if there are any.
    percent : float
        Largest percentage to remove; 0 with `max_drop` means as many as that allows.
    max_drop : float or None
        Largest PSNR loss of the views, dB; see `ReferenceViews.drop`.
    progress : callable, optional
    """
    wanted = portion(scene.count, percent)
    least = scene.count - wanted if wanted or max_drop is None else 1
    kept = np.arange(scene.count)
    rounds: list[dict[str, Any]] = []
    cameras, targets = views.renders.cameras, views.wanted
    before = targets.errors(scene, progress) if max_drop is not None else np.zeros(1)
    while len(kept) > least:
        current = scene.take(kept)
        stage = f"leave-one-out, round {len(rounds) + 1}"
        advance = step_counter(progress, stage, len(cameras))
        scores = leave_one_out(current, cameras, views.renders.background, advance)
        rounds.append({"gaussians": len(kept)})
        asked = removed = min(len(kept) - least, max(1, int(_ROUND * len(kept))))
        if max_drop is not None:
            removed = _allowed(current, scores, asked, targets, before, max_drop, progress)
        kept = kept[keep_highest(scores, removed)]
        if removed < asked:
            break
    return kept, {"rounds": rounds}


def _allowed(
    scene: Scene,
    scores: NDArray[np.float64],
    most: int,
    targets: ReferenceViews,
    before: NDArray[np.float64],
    max_drop: float,
    progress: Progress | None,
) -> int:
    """How many of the lowest scores, at most `most`, can be removed within `max_drop`."""

    def fits(number: int) -> bool:
        left = scene.take(keep_highest(scores, number))
        return targets.drop(targets.errors(left, progress), before) <= max_drop

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

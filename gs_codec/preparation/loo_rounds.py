"""Pruning by leave-one-out error, a part at a time.

Errors of single Gaussians do not add up where they cover each other, so scores are computed
again after each round.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.preparation.leave_one_out import leave_one_out
from gs_codec.preparation.prune import keep_highest, portion
from gs_codec.preparation.targets import Targets, Views
from gs_codec.report import Progress, step_counter
from gs_codec.scene import Scene

#: Share of the remaining Gaussians that a round may remove.
_ROUND = 0.2

#: Bisections of the last round, where the loss reaches its limit.
_BISECTIONS = 6


def prune_leave_one_out(
    scene: Scene,
    views: Views,
    percent: float,
    max_drop: float | None,
    progress: Progress | None = None,
) -> tuple[NDArray[np.int64], dict[str, Any]]:
    """Prune in rounds; return indices of the Gaussians that stay, and details of the rounds.

    Parameters
    ----------
    scene : Scene
    views : Views
        Scores use its renders; `max_drop` is measured on its photographs if there are any.
    percent : float
        Largest percentage to remove; 0 with `max_drop` means as many as that allows.
    max_drop : float or None
        Largest PSNR loss of the views, dB; see `Targets.drop`.
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
    targets: Targets,
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

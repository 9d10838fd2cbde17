"""SH energy compaction: fewer non-zero SH-AC for the same images (POTR, arXiv 2601.14821)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.preparation.sh_weights import (
    coefficients_of,
    fill_matrix,
    sh_row,
    solve,
    squared_weights,
    with_coefficients,
)
from gs_codec.rendering.camera import Camera
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene

#: Default of `smallest`: half a step of coarse quantisation.
SMALLEST = 0.018

#: Rounds; each takes its penalties from the solution before. One more solve leaves out zeros.
_ROUNDS = 5

#: Weight that holds a solution to the one before it, as a share of the weight of all views.
_INERTIA = 1e-9

_CHUNK = 1 << 12


def compact_sh(
    scene: Scene,
    cameras: Sequence[Camera],
    strength: float,
    *,
    smallest: float | NDArray[np.float32] = SMALLEST,
    weights: NDArray[np.float32] | None = None,
    progress: Progress | None = None,
) -> tuple[Scene, dict[str, Any]]:
    """Replace SH by sparser ones that give the cameras nearly the same colours.

    For each Gaussian and colour, coefficients a minimise ::

        sum over views of S_v (colour_v(a) - colour_v)^2  +  L sum over AC of d_k a_k^2

    where S_v sums (alpha T)^2 over the pixels of a view, and d_k = 1 / (abs(a_k) + smallest / 2)^2
    is taken from the solution before. At the end each non-zero coefficient costs at most L, so it
    is kept if it explains more squared error than L. In views where a colour is clamped at black,
    any value below black is equally good.

    Errors of Gaussians that overlap in a pixel are treated as independent. `refit_colour` includes
    their cross terms and recovers some of the loss.

    Parameters
    ----------
    scene : Scene
    cameras : sequence of Camera, at least one
        Colours that they do not see are lost; a Gaussian that none of them sees keeps only its DC.
    strength : float, above 0
        Mean squared error of an image value (0-1) if every SH-AC costs the full L, which is
        ``L = strength * pixels / (K N)``, with the pixels of all cameras. 1e-5 is 50 dB.
    smallest : float or ndarray (N,), from 0 up
        SH-AC nearer to 0 become 0, and the others compensate; usually half a quantisation step.
    weights : ndarray, shape (views, N), float32, optional
        `squared_weights` of the scene, if already computed.
    progress : callable, optional

    Returns
    -------
    Scene
    dict
        For reports: ``count`` of Gaussians; those that no camera sees, whose SH-AC are 0 now,
        ``unseen``; those left unchanged because of values that are not finite, ``unsolved``; those
        whose SH-AC were all 0 before, as training leaves colours that stay black, ``without_ac``;
        and SH-AC that are exactly 0, ``zeros_before`` and ``zeros_after``.
    """
    if weights is None:
        weights = squared_weights(scene, cameras, progress)
    least = np.full(scene.count, smallest, np.float32)
    before = coefficients_of(scene)
    after = before.copy()
    unseen = unsolved = 0
    if scene.sh_degree and scene.count:
        pixels = sum(camera.width * camera.height for camera in cameras)
        penalty = penalty_of(scene, pixels, strength)
        centres = np.array([camera.position for camera in cameras])

        def run(start: int) -> tuple[int, int]:
            stop = min(start + _CHUNK, scene.count)
            return _compact(
                scene.positions, before, weights, centres, penalty, least, after, start, stop
            )

        starts = range(0, scene.count, _CHUNK)
        counts = run_all(run, starts, advance=step_counter(progress, "compact", len(starts)))
        unseen, unsolved = (sum(count) for count in zip(*counts, strict=True))
    result = with_coefficients(scene, after)
    return result, {
        "count": scene.count,
        "unseen": unseen,
        "unsolved": unsolved,
        "without_ac": int((~scene.f_rest.any(axis=0)).sum()),
        "zeros_before": int((scene.f_rest == 0).sum()),
        "zeros_after": int((result.f_rest == 0).sum()),
    }


def penalty_of(scene: Scene, pixels: int, strength: float) -> float:
    """Squared error that one SH-AC may cost; `pixels` is the total of all cameras."""
    return strength * pixels / max(len(scene.f_rest) // 3 * scene.count, 1)


@kernel
def _compact(positions, before, weights, centres, penalty, smallest, after, start, stop):
    """Solve for Gaussians `start` to `stop`; return how many are unseen, and unsolved."""
    views, size = len(weights), before.shape[1]
    rows = np.empty((views, size))
    seen = np.empty(views)
    shared = np.empty((size, size))
    solution = np.empty(size)
    unseen = unsolved = 0
    for i in range(start, stop):
        count = _list_views(positions, i, weights, centres, rows, seen)
        unseen += count == 0
        fill_matrix(rows[:count], seen, shared)
        failed = False
        for channel in range(3):
            finite, any_ac = True, False
            for k in range(size):
                solution[k] = before[channel, k, i]
                finite = finite and abs(solution[k]) < np.inf
                any_ac = any_ac or (k > 0 and solution[k] != 0.0)
            if not finite:
                failed = True
            elif any_ac and count == 0:
                after[channel, 1:, i] = 0.0
            elif any_ac and _sparsify(rows[:count], seen, shared, penalty, smallest[i], solution):
                after[channel, :, i] = solution
            elif any_ac:
                failed = True
        unsolved += failed
    return unseen, unsolved


@kernel
def _list_views(positions, i, weights, centres, rows, seen):
    """List SH basis and weight of the views that see Gaussian i; return how many they are."""
    count = 0
    for view in range(len(weights)):
        if weights[view, i] > 0.0:
            sh_row(positions, i, centres[view], rows[count])
            seen[count] = weights[view, i]
            count += 1
    return count


@kernel
def _sparsify(rows, seen, shared, penalty, smallest, solution):
    """Solve for one colour channel in place; return whether all solutions were found.

    `shared` is the matrix of all views. A view where the colour is clamped at black does not count
    until a solution is above black there. From then on it counts, so that solutions do not
    alternate.
    """
    count, size = rows.shape
    right, sums = np.empty(size), np.empty(size)
    matrix, evident = np.empty((size, size)), shared
    targets, evidence = np.empty(count), np.empty(count)
    dark, inertia = False, 0.0
    for j in range(count):
        colour = 0.5 + _dot(rows[j], solution)
        targets[j] = max(0.0, colour) - 0.5
        evidence[j] = seen[j] if colour >= 0.0 else 0.0
        dark = dark or colour < 0.0
        inertia += _INERTIA * seen[j]
    if dark:
        evident = np.empty((size, size))
    for turn in range(_ROUNDS + 1):
        changed = turn == 0
        for j in range(count):
            if evidence[j] == 0.0 and 0.5 + _dot(rows[j], solution) > 0.0:
                evidence[j] = seen[j]
                changed = True
        if changed:
            if dark:
                fill_matrix(rows, evidence, evident)
            sums[:] = 0.0
            for j in range(count):
                weight = evidence[j] * targets[j]
                for k in range(size):
                    sums[k] += weight * rows[j, k]
        matrix[:] = evident
        right[:] = sums
        _penalise(matrix, right, solution, inertia, penalty, smallest, turn == _ROUNDS)
        if not solve(matrix, right):
            return False
        for k in range(size):
            small = k > 0 and turn >= _ROUNDS - 1 and abs(right[k]) < smallest
            solution[k] = 0.0 if small else right[k]
    return True


@kernel
def _penalise(matrix, right, solution, inertia, penalty, smallest, settled):
    """Add penalty and inertia to the system; once `settled`, zero coefficients stay 0."""
    for k in range(len(solution)):
        matrix[k, k] += inertia
        right[k] += inertia * solution[k]
        if k > 0 and settled and solution[k] == 0.0:
            right[k] = 0.0
            for m in range(len(solution)):
                matrix[k, m] = matrix[m, k] = 1.0 if m == k else 0.0
        elif k > 0:
            matrix[k, k] += penalty / max(abs(solution[k]) + 0.5 * smallest, 1e-6) ** 2


@kernel
def _dot(row, values):
    total = 0.0
    for k in range(len(values)):
        total += row[k] * values[k]
    return total

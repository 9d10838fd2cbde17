"""SH energy compaction: fewer non-zero SH-AC for the same images (POTR, arXiv 2601.14821)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.coding.ycocg import luma_chroma, red_green_blue
from gs_codec.preparation.likely_views import LikelyViews
from gs_codec.preparation.sh_weights import (
    coefficients_of,
    fill_matrix,
    list_views,
    solve,
    squared_weights,
    with_coefficients,
)
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.simd import LANES, load, repeated, store, total
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene

#: Default of `smallest`: half a step of coarse quantisation.
SMALLEST = 0.018

#: Number of rounds; each takes its penalties from the previous solution.
_ROUNDS = 12

#: If no coefficient changes by more than this share of `smallest`, only the last two rounds follow.
_STILL = 0.02

#: SH-AC below this share of `smallest` become 0, which leaves fewer unknowns.
_TINY = 0.1

#: First round in which they become 0.
_TINY_FROM = 2

#: Weight of staying at the previous solution, relative to the weight of all views.
_INERTIA = 1e-9

_CHUNK = 1 << 12


def compact_sh(
    scene: Scene,
    cameras: Sequence[Camera],
    strength: float,
    *,
    smallest: float | NDArray[np.float32] = SMALLEST,
    weights: NDArray[np.float32] | None = None,
    seen: Sequence[int] | None = None,
    likely: LikelyViews | None = None,
    progress: Progress | None = None,
) -> tuple[Scene, dict[str, Any]]:
    """Replace SH by sparser ones that give the cameras nearly the same colours.

    For each Gaussian, coefficients a of Y, Co and Cg minimise ::

        sum over views of S_v |colour_v(a) - colour_v|^2  +  L sum over AC of d_k a_k^2

    where S_v sums (alpha T)^2 over the pixels of a view, and d_k = 1 / (abs(a_k) + smallest / 2)^2
    comes from the previous solution. At the end each non-zero coefficient costs at most L, so it is
    kept if it explains more squared error than L. If all of a channel explain no more than L, all
    become 0 at once. In views where R, G or B is clamped at black, any value below black is equally
    good.

    Errors of Gaussians that overlap in a pixel are treated as independent. `refit_colour` includes
    their cross terms and recovers some of the loss.

    Parameters
    ----------
    scene : Scene
    cameras : sequence of Camera, at least one
        Colours not visible in them are lost; a Gaussian visible in none keeps only its DC.
    strength : float, above 0
        Mean squared error of an image value (0-1) if every SH-AC costs the full L, which is
        ``L = strength * pixels / (K N)``, with the pixels of all cameras. 1e-5 is 50 dB.
    smallest : float or ndarray (N,), from 0 up
        SH-AC below this magnitude become 0, and the others compensate; usually half a quantisation
        step.
    weights : ndarray, shape (views, N), float32, optional
        `squared_weights` of the scene, if already computed.
    seen : sequence of int, optional
        Numbers of the cameras that count; by default all.
    likely : LikelyViews, optional
        Extra views whose colours should be preserved; they do not count as pixels.
    progress : callable, optional

    Returns
    -------
    Scene
    dict
        Numbers for reports: ``count`` of Gaussians; ``unseen``, not visible to any camera, whose
        SH-AC are now 0; ``unsolved``, unchanged because of values that are not finite;
        ``without_ac``, whose SH-AC were all 0 before, as in black Gaussians; ``zeros_before`` and
        ``zeros_after``, the SH-AC of Y, Co and Cg that are 0.
    """
    if weights is None:
        weights = squared_weights(scene, cameras, progress)
    least = np.full(scene.count, smallest, np.float32)
    before = coefficients_of(scene)
    after = before.copy()
    unseen = unsolved = 0
    if scene.sh_degree and scene.count:
        chosen = np.array(range(len(cameras)) if seen is None else seen, np.int64)
        pixels = sum(cameras[view].width * cameras[view].height for view in chosen)
        penalty = penalty_of(scene, pixels, strength)
        centres = np.array([camera.position for camera in cameras])
        if likely is None:
            likely = LikelyViews(centres[:0], weights[:0])
        by_gaussian = [np.ascontiguousarray(each.T) for each in (weights, likely.weights)]

        def run(start: int) -> tuple[int, int]:
            stop = min(start + _CHUNK, scene.count)
            return _compact(
                scene.positions, before, *by_gaussian, chosen, centres, likely.centres, penalty,
                least, after, start, stop,
            )  # fmt: skip

        starts = range(0, scene.count, _CHUNK)
        counts = run_all(run, starts, advance=step_counter(progress, "compact", len(starts)))
        unseen, unsolved = (sum(count) for count in zip(*counts, strict=True))
    return with_coefficients(scene, after), {
        "count": scene.count,
        "unseen": unseen,
        "unsolved": unsolved,
        "without_ac": int((~scene.f_rest.any(axis=0)).sum()),
        "zeros_before": int((before[:, :, 1:] == 0).sum()),
        "zeros_after": int((after[:, :, 1:] == 0).sum()),
    }


def penalty_of(scene: Scene, pixels: int, strength: float) -> float:
    """Squared error that one SH-AC may cost; `pixels` is the total of all cameras."""
    return strength * pixels / max(len(scene.f_rest) // 3 * scene.count, 1)


@kernel
def _compact(
    positions, before, weights, likely, chosen, centres, away, penalty, smallest, after, start, stop
):  # fmt: skip
    """Solve for Gaussians `start` to `stop`; return how many are unseen, and unsolved."""
    views, size = len(chosen) + len(away), before.shape[2]
    rows, seen, every = np.zeros((views, LANES)), np.empty(views), np.arange(len(away))
    shared, solution = np.empty((LANES, LANES)), np.zeros((3, LANES))
    unseen = unsolved = 0
    for i in range(start, stop):
        count = list_views(positions, i, weights, chosen, centres, size, rows, seen)
        count += list_views(positions, i, likely, every, away, size, rows[count:], seen[count:])
        unseen += count == 0
        fill_matrix(rows[:count], seen, size, shared)
        finite, any_ac = True, False
        for channel in range(3):
            for k in range(size):
                solution[channel, k] = before[i, channel, k]
                finite = finite and abs(solution[channel, k]) < np.inf
                any_ac = any_ac or (k > 0 and solution[channel, k] != 0.0)
        if not finite:
            unsolved += 1
        elif any_ac and count == 0:
            for channel in range(3):
                for k in range(1, size):
                    after[i, channel, k] = 0.0
        elif any_ac and _sparsify(rows[:count], seen, shared, size, penalty, smallest[i], solution):
            for channel in range(3):
                for k in range(size):
                    after[i, channel, k] = solution[channel, k]
        else:
            unsolved += any_ac
    return unseen, unsolved


@kernel
def _sparsify(rows, seen, shared, size, penalty, smallest, solution):
    """Solve for Y, Co and Cg in place; return whether all solutions were found.

    `shared` is the matrix of all views. Where R, G or B is clamped at black in a view, the target
    of each round is the previous solution's value, if that is also below black.
    """
    count = len(rows)
    matrix, right, used = np.zeros((LANES, LANES)), np.empty(size), np.empty(size, np.int64)
    sums, targets = np.empty((3, LANES)), np.full((count, 3), np.inf)
    dark, inertia = _sum_up(rows, seen, solution, targets, sums), 0.0
    if dark:
        _darken(rows, targets, solution)
    flat = np.empty(3, np.bool_)
    for channel in range(3):
        flat[channel] = _flatten(shared, size, penalty, solution[channel])
    if flat[0] and flat[1] and flat[2] and not dark:
        return True
    for j in range(count):
        inertia += _INERTIA * seen[j]
    turn = 0
    while turn < _ROUNDS:
        if dark:
            _sum_up(rows, seen, solution, targets, sums)
        least, moved = _least(turn) * smallest, 0.0
        for channel in range(3):
            now, number = solution[channel], np.int64(0)
            for k in range(size):
                if k == 0 or now[k] != 0.0 or (turn == 0 and not flat[channel]):
                    used[number] = k
                    number += 1
            _set_up(
                shared, sums[channel], now, used[:number], inertia, penalty, smallest, matrix, right
            )
            if not solve(matrix, right, number):
                return False
            for n in range(number):
                k = used[n]
                found = right[n] if k == 0 or abs(right[n]) >= least else 0.0
                moved = max(moved, abs(found - now[k]))
                now[k] = found
        turn += 1
        if moved < _STILL * smallest:
            turn = max(turn, _ROUNDS - 2)
    return True


@inlined
def _least(turn):
    """Minimum magnitude of SH-AC in a round, as a share of `smallest`; smaller ones become 0."""
    if turn < _TINY_FROM:
        return 0.0
    return 1.0 if turn >= _ROUNDS - 2 else _TINY


@kernel
def _sum_up(rows, seen, solution, targets, sums):
    """Fill right-hand sides ``sums (3, 16)``; return whether a colour is clamped at black.

    ``targets (views, 3)`` are R, G, B; infinite ones become the solution's colours.
    """
    dark = False
    by_y = by_o = by_g = repeated(0.0)
    y, o, g = load(solution, 0), load(solution, LANES), load(solution, 2 * LANES)
    aims = np.empty(3)
    for j in range(len(rows)):
        row = load(rows, j * LANES)
        colour = red_green_blue(total(row * y), total(row * o), total(row * g))
        for channel in range(3):
            if targets[j, channel] == np.inf:
                targets[j, channel] = max(colour[channel], -0.5)
                dark = dark or colour[channel] < -0.5
            aims[channel] = targets[j, channel]
            if aims[channel] == -0.5:
                aims[channel] = min(colour[channel], -0.5)
        aims[0], aims[1], aims[2] = luma_chroma(aims[0], aims[1], aims[2])
        by_y += (seen[j] * aims[0]) * row
        by_o += (seen[j] * aims[1]) * row
        by_g += (seen[j] * aims[2]) * row
    store(sums, 0, by_y)
    store(sums, LANES, by_o)
    store(sums, 2 * LANES, by_g)
    return dark


@kernel
def _darken(rows, targets, solution):
    """Let channels that are black in every view vary like the others, below black.

    A change common to all three takes one coefficient instead of three.
    """
    size = len(solution[0])
    lit, colour, highest = np.zeros(3, np.bool_), np.empty((size, 3)), np.full(3, -np.inf)
    for j in range(len(rows)):
        for channel in range(3):
            lit[channel] |= targets[j, channel] > -0.5
    for k in range(size):
        colour[k, 0], colour[k, 1], colour[k, 2] = red_green_blue(
            solution[0, k], solution[1, k], solution[2, k]
        )
        mean = colour[k, 0] * lit[0] + colour[k, 1] * lit[1] + colour[k, 2] * lit[2]
        mean /= max(lit[0] + lit[1] + lit[2], 1)
        for channel in range(3):
            if k > 0 and not lit[channel]:
                colour[k, channel] = mean
    for j in range(len(rows)):
        for channel in range(3):
            highest[channel] = max(highest[channel], _dot(rows[j, 1:], colour[1:, channel]))
    for channel in range(3):
        if not lit[channel]:
            limit = (-0.5 - highest[channel]) / rows[0, 0]
            colour[0, channel] = min(colour[0, channel], limit)
    for k in range(size):
        values = luma_chroma(colour[k, 0], colour[k, 1], colour[k, 2])
        for channel in range(3):
            solution[channel, k] = values[channel]


@kernel
def _flatten(matrix, size, penalty, solution):
    """Set SH-AC to 0 if all together explain no more than one may cost; return whether they do."""
    dc, of_dc, by_ac = solution[0], 0.0, repeated(0.0)
    solution[0] = 0.0
    for k in range(1, size):
        by_ac += solution[k] * load(matrix, k * LANES)
        of_dc += solution[k] * matrix[k, 0]
    explained = total(by_ac * load(solution, 0)) - of_dc * of_dc / matrix[0, 0]
    solution[0] = dc
    if not explained <= penalty:
        return False
    solution[0] += of_dc / matrix[0, 0]
    for k in range(1, size):
        solution[k] = 0.0
    return True


@kernel
def _set_up(shared, sums, solution, used, inertia, penalty, smallest, matrix, right):
    """Fill the system of the coefficients in use; `solve` reads the matrix's upper half."""
    for n in range(len(used)):
        k = used[n]
        right[n] = sums[k] + inertia * solution[k]
        for m in range(n, len(used)):
            matrix[n, m] = shared[k, used[m]]
        matrix[n, n] += inertia
        if k > 0:
            matrix[n, n] += penalty / max(abs(solution[k]) + 0.5 * smallest, 1e-6) ** 2


@kernel
def _dot(row, values):
    total = 0.0
    for k in range(len(values)):
        total += row[k] * values[k]
    return total

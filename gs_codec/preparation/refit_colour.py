"""Refit SH to images by conjugate gradients: an image is linear in SH."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.preparation.compact_sh import SMALLEST, penalty_of
from gs_codec.preparation.image_operator import ImageOperator, Linear, Places
from gs_codec.preparation.reference_views import ReferenceViews, evenly
from gs_codec.preparation.sh_weights import coefficients_of, with_coefficients
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene

#: Weight of the squared change of SH, in pixels. A Gaussian whose sum of (alpha T)^2 over all views
#: equals it makes about half of the change that its views demand. A larger value lowers the gain in
#: held-out views; with 0, hardly visible Gaussians would change freely.
_RIDGE = 0.03

#: Added to SH-AC in the denominators of their penalty, as in `compact_sh`.
_HALF = SMALLEST / 2

#: Lower bound of a divisor.
_EPS = 1e-30

#: Number of views that measure the length of the last step, and whether the result is better.
_MEASURING = 16

_CHUNK = 1 << 17


class RefitReport(NamedTuple):
    """How well a refit matches its references.

    Attributes
    ----------
    psnr : list of float
        PSNR of all views together, dB, values not clipped: before, then after each iteration as
        predicted by the linear model. Infinite if there is no error.
    objective : list of float
        The minimised function, before and after each iteration; it never increases.
    kept : bool
        Whether the input was returned, because the refitted scene renders no better.
    """

    psnr: list[float]
    objective: list[float]
    kept: bool


def refit_colour(
    scene: Scene,
    views: ReferenceViews,
    iterations: int,
    *,
    strength: float = 0.0,
    keep_zeros: bool = True,
    operator: ImageOperator | None = None,
    progress: Progress | None = None,
) -> tuple[Scene, RefitReport]:
    """Change SH so that views match their references better.

    Minimises the sum over views, pixels and colours of the squared residual, `_RIDGE` times the
    squared change of SH, and the penalty on SH-AC of `compact_sh`, by conjugate gradients on the
    normal equations, with their diagonal as preconditioner. The last step needs no gradient
    afterwards, so a few views suffice for its length. Memory is six times the size of the SH,
    plus at most about 1 GiB for the weights alpha T of views; if these would take more, only some
    of each view's tiles count. A colour that is clamped at black in a view has no gradient there;
    clamping is determined once, at the start.

    Parameters
    ----------
    scene : Scene
    views : ReferenceViews
    iterations : int, from 0 up
        Each takes about as long as rendering all views.
    strength : float, from 0 up
        Penalty on SH-AC as in `compact_sh`, with the scene's own SH-AC in the denominators.
        Without it, SH-AC that compaction made small would grow again and cost more bits.
    keep_zeros : bool
        Whether SH-AC of Y, Co and Cg that are 0 stay 0: for scenes that `compact_sh` returned.
    operator : ImageOperator, optional
        Existing operator for the views and for a scene with the same shapes.
    progress : callable, optional
    """
    operator = operator or ImageOperator(scene, views)
    count = len(views.cameras)
    some = evenly(range(count), _MEASURING)
    looks = max(iterations, 1) * count + (2 if iterations else 1) * len(some)
    advance = step_counter(progress, "refit", looks)
    whole = coefficients_of(scene)
    used = whole != 0 if keep_zeros else np.ones(whole.shape, bool)
    used[:, :, 0] = True
    places, start = Places.of(used), whole[used]
    near = operator.linearise(start, places, advance)
    shares = np.array([float(operator.pixels(view)) for view in range(count)])
    pixels = int(shares.sum())
    penalty = np.full(whole.shape[2], penalty_of(scene, pixels, strength))
    penalty[0] = 0.0

    def apply(direction: NDArray, last: bool) -> tuple[NDArray, float]:
        """The product with a direction; instead, if `last`, the squared change of images.

        That is expected from some views, whose share is taken from the previous direction.
        """
        if last:
            squares = operator.errors(direction, places, some, advance, near.lit).sum()
            known = max(float(shares[some].sum()), _EPS)
            return np.zeros_like(direction), float(squares * shares.sum() / known)
        product, shares[:] = operator.apply(direction, places, near.lit, advance)
        return product, 0.0

    damping = start, places.numbers
    change, errors, objectives = _descend(apply, near, damping, penalty, iterations)
    refitted = np.add(start, change, out=change)
    grown = operator.errors(refitted, places, some, advance) - near.errors[some]
    damped = objectives[-1] - errors[-1] - (objectives[0] - errors[0])
    kept = not float(grown.sum()) * count / len(some) + damped < 0
    report = RefitReport([_psnr(error / (3 * pixels)) for error in errors], objectives, kept)
    if kept:
        return scene, report
    whole[used] = refitted
    return with_coefficients(scene, whole), report


def _psnr(error: float) -> float:
    return -10 * math.log10(error) if error > 0 else math.inf


def _descend(
    apply: Callable[[NDArray, bool], tuple[NDArray, float]],
    near: Linear,
    damping: tuple[NDArray, NDArray],
    penalty: NDArray,
    iterations: int,
) -> tuple[NDArray, list[float], list[float]]:
    """Conjugate gradients; return the change of SH, and squared errors and objectives.

    Coefficients with zero curvature do not change. Overwrites `near.gradient` and `near.curvature`.
    `damping` is the initial SH x and their numbers k, ``(M,)``; with `penalty` p ``(1 + K,)``, the
    objective is the squared error plus ``_RIDGE change^2 + p_k / (abs(x) + _HALF)^2 (x +
    change)^2``.
    """
    residual, inverse = near.gradient, near.curvature
    change, direction = np.zeros_like(residual), np.zeros_like(residual)
    slope, share = _total(_prepare, residual, inverse, *damping, last=penalty), 0.0
    error = float(near.errors.sum())
    errors, objectives = [error], [error + _total(_cost, change, inverse, *damping, last=penalty)]
    for left in range(iterations, 0, -1):
        _total(_turn, direction, residual, inverse, last=share)
        product, squares = apply(direction, left == 1)
        curved = squares + _total(_damp, product, direction, *damping, last=penalty)
        if not (0 < curved < math.inf and slope < math.inf):
            break
        before, size = slope, slope / curved
        slope = _total(_move, change, residual, direction, product, inverse, last=size)
        share = slope / before
        objectives.append(objectives[-1] - size * before)
        errors.append(objectives[-1] - _total(_cost, change, inverse, *damping, last=penalty))
    return change, errors, objectives


def _total(function: Callable, *arrays: NDArray, last: Any) -> float:
    """Sum a kernel's results over parts of arrays ``(M,)``, computed in threads.

    The kernel's last argument is given whole.
    """

    def run(first: int) -> float:
        return function(*(array[first : first + _CHUNK] for array in arrays), last)

    return sum(run_all(run, range(0, len(arrays[0]), _CHUNK)))


@inlined
def _pull(start, penalty):
    return penalty / (abs(np.float64(start)) + _HALF) ** 2


@kernel
def _prepare(residual, curvature, start, numbers, penalty):
    """Turn gradient and curvature into residual and preconditioner; return its squared norm."""
    total = 0.0
    for m in range(len(residual)):
        if not 0.0 < curvature[m] < np.inf:
            residual[m] = curvature[m] = 0.0
            continue
        pull = _pull(start[m], penalty[numbers[m]])
        residual[m] -= pull * start[m]
        curvature[m] = 1.0 / (curvature[m] + _RIDGE + pull)
        total += np.float64(residual[m]) ** 2 * curvature[m]
    return total


@kernel
def _cost(change, inverse, start, numbers, penalty):
    """Damping terms of the objective, over the coefficients that may change."""
    total = 0.0
    for m in range(len(change)):
        if inverse[m] > 0.0:
            before, step = start[m], np.float64(change[m])
            total += _RIDGE * step**2 + _pull(before, penalty[numbers[m]]) * (before + step) ** 2
    return total


@kernel
def _turn(direction, residual, inverse, share):
    """Set the next conjugate direction; `share` is the weight of the previous one in it."""
    for m in range(len(direction)):
        direction[m] = inverse[m] * residual[m] + share * direction[m]
    return 0.0


@kernel
def _damp(product, direction, start, numbers, penalty):
    """Add the damping to a product; return the curvature of the objective along the direction."""
    total = 0.0
    for m in range(len(product)):
        if direction[m] != 0.0:
            pull = _RIDGE + _pull(start[m], penalty[numbers[m]])
            product[m] += pull * direction[m]
            total += np.float64(product[m]) * direction[m]
    return total


@kernel
def _move(change, residual, direction, product, inverse, size):
    """Take a step; return the residual's squared norm under the preconditioner."""
    total = 0.0
    for m in range(len(change)):
        change[m] += size * direction[m]
        residual[m] -= size * product[m]
        total += np.float64(residual[m]) ** 2 * inverse[m]
    return total

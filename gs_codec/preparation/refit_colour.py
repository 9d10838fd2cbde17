"""Refit SH to images by conjugate gradients: an image is linear in SH."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.preparation.compact_sh import SMALLEST, penalty_of
from gs_codec.preparation.image_operator import ImageOperator, Linear
from gs_codec.preparation.reference_views import ReferenceViews
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

_CHUNK = 1 << 13


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
    normal equations, with their diagonal as preconditioner. Memory is six times the size of the SH,
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
    cameras = views.cameras
    operator = operator or ImageOperator(scene, views)
    advance = step_counter(progress, "refit", (iterations + 2) * len(cameras))
    start = coefficients_of(scene)
    near = operator.linearise(start, advance)
    pixels = sum(operator.pixels(view) for view in range(len(cameras)))
    penalty = np.full(start.shape[2], penalty_of(scene, pixels, strength))
    penalty[0] = 0.0
    if keep_zeros:
        near.curvature[:, :, 1:][start[:, :, 1:] == 0] = 0
    change, errors, objectives = _descend(operator, near, (start, penalty), iterations, advance)
    refitted = np.add(start, change, out=change)
    rendered = float(operator.errors(refitted, range(len(cameras)), advance).sum())
    kept = not rendered + (objectives[-1] - errors[-1]) < objectives[0]
    report = RefitReport([_psnr(error / (3 * pixels)) for error in errors], objectives, kept)
    return scene if kept else with_coefficients(scene, refitted), report


def _psnr(error: float) -> float:
    return -10 * math.log10(error) if error > 0 else math.inf


def _descend(
    operator: ImageOperator,
    near: Linear,
    damping: tuple[NDArray, NDArray],
    iterations: int,
    advance: Callable[[], None],
) -> tuple[NDArray, list[float], list[float]]:
    """Conjugate gradients; return the change of SH, and squared errors and objectives.

    Coefficients with zero curvature do not change. Overwrites `near.gradient` and `near.curvature`.
    `damping` is the initial SH x and factors p ``(1 + K,)``; it adds to the squared error ``_RIDGE
    change^2 + p / (abs(x) + _HALF)^2 (x + change)^2``.
    """
    residual = near.gradient
    change, direction = np.zeros_like(residual), np.zeros_like(residual)
    inverse = near.curvature
    slope, share = _total(_prepare, residual, inverse, *damping), 0.0
    errors, objectives = [near.error], [near.error + _total(_cost, change, inverse, *damping)]
    for _ in range(iterations):
        _total(_turn, direction, residual, inverse, share)
        product = operator.apply(direction, near.lit, advance)
        curved = _total(_damp, product, direction, *damping)
        if not (0 < curved < math.inf and slope < math.inf):
            break
        before, size = slope, slope / curved
        slope = _total(_move, change, residual, direction, product, inverse, size)
        share = slope / before
        objectives.append(objectives[-1] - size * before)
        errors.append(objectives[-1] - _total(_cost, change, inverse, *damping))
    return change, errors, objectives


def _total(function: Callable, *arguments: Any) -> float:
    """Sum a kernel's results over parts of arrays ``(N, 3, 1 + K)``, computed in threads."""

    def run(start: int) -> float:
        part = slice(start, start + _CHUNK)
        return function(*(x[part] if np.ndim(x) == 3 else x for x in arguments))

    return sum(run_all(run, range(0, len(arguments[0]), _CHUNK)))


@inlined
def _pull(start, penalty):
    return penalty / (abs(np.float64(start)) + _HALF) ** 2


@kernel
def _prepare(residual, curvature, start, penalty):
    """Turn gradient and curvature into residual and preconditioner; return its squared norm."""
    total = 0.0
    for i, channel, k in np.ndindex(residual.shape):
        if not 0.0 < curvature[i, channel, k] < np.inf:
            residual[i, channel, k] = curvature[i, channel, k] = 0.0
            continue
        pull = _pull(start[i, channel, k], penalty[k])
        residual[i, channel, k] -= pull * start[i, channel, k]
        curvature[i, channel, k] = 1.0 / (curvature[i, channel, k] + _RIDGE + pull)
        total += np.float64(residual[i, channel, k]) ** 2 * curvature[i, channel, k]
    return total


@kernel
def _cost(change, inverse, start, penalty):
    """Damping terms of the objective, over the coefficients that may change."""
    total = 0.0
    for i, channel, k in np.ndindex(change.shape):
        if inverse[i, channel, k] > 0.0:
            before, step = start[i, channel, k], np.float64(change[i, channel, k])
            total += _RIDGE * step**2 + _pull(before, penalty[k]) * (before + step) ** 2
    return total


@kernel
def _turn(direction, residual, inverse, share):
    """Set the next conjugate direction; `share` is the weight of the previous one in it."""
    for at in np.ndindex(direction.shape):
        direction[at] = inverse[at] * residual[at] + share * direction[at]
    return 0.0


@kernel
def _damp(product, direction, start, penalty):
    """Add the damping to a product; return the curvature of the objective along the direction."""
    total = 0.0
    for i, channel, k in np.ndindex(product.shape):
        if direction[i, channel, k] != 0.0:
            pull = _RIDGE + _pull(start[i, channel, k], penalty[k])
            product[i, channel, k] += pull * direction[i, channel, k]
            total += np.float64(product[i, channel, k]) * direction[i, channel, k]
    return total


@kernel
def _move(change, residual, direction, product, inverse, size):
    """Take a step; return the residual's squared norm under the preconditioner."""
    total = 0.0
    for at in np.ndindex(change.shape):
        change[at] += size * direction[at]
        residual[at] -= size * product[at]
        total += np.float64(residual[at]) ** 2 * inverse[at]
    return total

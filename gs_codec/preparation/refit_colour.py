"""Refit SH to images by conjugate gradients: an image is linear in SH."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.preparation.compact_sh import SMALLEST, penalty_of
from gs_codec.preparation.image_operator import ImageOperator, Images, Linear
from gs_codec.preparation.sh_weights import coefficients_of, with_coefficients
from gs_codec.rendering.camera import Camera
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene


@dataclass(frozen=True)
class RefitReport:
    """How well a refit matches its targets.

    Attributes
    ----------
    psnr : tuple of float
        PSNR of all views together against their targets, dB, values not clipped: before, and
        after each step as the linear model predicts. Infinite if no error is left.
    objective : tuple of float
        The minimised function, before and after each step; it never grows.
    rendered_psnr : float
        PSNR at the end, dB, with all colours below black clamped.
    kept : bool
        Whether the input is returned, because the refitted scene's rendered objective is no better.
    """

    psnr: tuple[float, ...]
    objective: tuple[float, ...]
    rendered_psnr: float
    kept: bool


def refit_colour(
    scene: Scene,
    cameras: Sequence[Camera],
    targets: Images,
    steps: int = 6,
    *,
    ridge: float = 0.03,
    strength: float = 0.0,
    smallest: float = SMALLEST,
    keep_zeros: bool = True,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    operator: ImageOperator | None = None,
    progress: Progress | None = None,
) -> tuple[Scene, RefitReport]:
    """Change SH so that views match their targets better.

    Minimises the sum over views, pixels and colours of ``(image - target)^2``, ``ridge`` times the
    squared change of SH, and the penalty on SH-AC of `compact_sh`, by conjugate gradients on the
    normal equations, with their diagonal as preconditioner. Memory is six times the size of the
    SH, plus up to 2 GiB for the weights alpha T of views; views beyond that are traced again in
    each step. A colour that is clamped at black in a view has no gradient there; which colours are
    clamped is decided once, at the start.

    Parameters
    ----------
    scene : Scene
    cameras : sequence of Camera
    targets : sequence of ndarray
        Image ``(H, W, 3)`` for each camera, RGB, in the values of `render`.
    steps : int, from 0 up
        Iterations; each takes about as long as drawing all views.
    ridge : float, from 0 up
        Weight of the squared change of SH, in pixels: a Gaussian whose sum of (alpha T)^2 over
        all views equals it makes about half of the change that its views ask for. A larger value
        lowers the gain in held-out views; with 0, Gaussians that are hardly seen change freely.
    strength, smallest : float, from 0 up
        Penalty on SH-AC as in `compact_sh`, with the scene's own SH-AC in the denominators.
        Without it, SH-AC that compaction made small would grow again and cost more bits.
    keep_zeros : bool
        Whether SH-AC that are exactly 0 stay 0: for scenes that `compact_sh` returned.
    background : sequence of three float
        RGB behind the scene in the targets.
    operator : ImageOperator, optional
        Operator of the cameras and of a scene with the same shapes, if there is one already.
    progress : callable, optional

    Raises
    ------
    InvalidInput
        If there is no camera, a number is out of range, or a target is missing or not of its
        camera's shape.
    """
    _check(cameras, targets, steps, ridge=ridge, strength=strength, smallest=smallest)
    operator = operator or ImageOperator(scene, cameras, background)
    advance = step_counter(progress, "refit", (steps + 2) * len(cameras))
    start = coefficients_of(scene)
    near = operator.linearise(start, targets, advance)
    pixels = sum(camera.width * camera.height for camera in cameras)
    penalty = np.full((*start.shape[:2], 1), penalty_of(scene, pixels, strength))
    penalty[:, 0] = 0.0
    damping = _Damping(start, penalty, ridge, max(smallest / 2, 1e-6))
    if keep_zeros:
        near.curvature[:, 1:][start[:, 1:] == 0] = 0
    change, errors, objectives = _descend(operator, near, damping, steps, advance)
    refitted = np.add(start, change, out=change)
    rendered = float(operator.errors(refitted, targets, advance=advance).sum())
    kept = not rendered + (objectives[-1] - errors[-1]) < objectives[0]
    psnr = tuple(_psnr(error / (3 * pixels)) for error in errors)
    last = psnr[0] if kept else _psnr(rendered / (3 * pixels))
    report = RefitReport(psnr, tuple(objectives), last, kept)
    return scene if kept else with_coefficients(scene, refitted), report


class _Damping(NamedTuple):
    """Terms that damp the change: ``ridge (x - start)^2 + penalty / (|start| + half)^2 x^2``."""

    start: NDArray
    penalty: NDArray[np.float64]
    ridge: float
    half: float


def _check(cameras: Sequence[Camera], targets: Images, steps: int, **numbers: float) -> None:
    if not cameras:
        raise InvalidInput("cameras: none, expected at least one")
    if len(targets) != len(cameras):
        raise InvalidInput(f"targets: {len(targets)}, expected one for each of {len(cameras)}")
    for name, value in {"steps": steps, **numbers}.items():
        if not 0 <= value < math.inf:
            raise InvalidInput(f"{name} {value}: expected a number from 0 up")


def _psnr(error: float) -> float:
    return -10 * math.log10(error) if error > 0 else math.inf


def _descend(
    operator: ImageOperator,
    near: Linear,
    damping: _Damping,
    steps: int,
    advance: Callable[[], None] | None,
) -> tuple[NDArray, list[float], list[float]]:
    """Conjugate gradients; return the change of SH, and squared error and objective of each step.

    Coefficients with zero curvature do not change. Overwrites `near.gradient` and `near.curvature`.
    """
    residual = near.gradient
    change, direction = np.zeros_like(residual), np.zeros_like(residual)
    inverse = near.curvature
    slope, share = _total(_prepare, residual, inverse, *damping), 0.0
    errors, objectives = [near.error], [near.error + _total(_cost, change, inverse, *damping)]
    for _ in range(steps):
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
    """Sum of a kernel's results over the rows of arrays ``(3, 1 + K, N)``, computed in threads."""
    rows = [
        x.reshape(x.shape[0] * x.shape[1], x.shape[2]) if isinstance(x, np.ndarray) else repeat(x)
        for x in arguments
    ]
    return sum(run_all(lambda row: function(*row), zip(*rows, strict=False)))


@inlined
def _pull(start, penalty, half):
    return penalty[0] / (abs(np.float64(start)) + half) ** 2


@kernel
def _prepare(residual, curvature, start, penalty, ridge, half):
    """Turn gradient and curvature into residual and preconditioner; return its squared norm."""
    total = 0.0
    for i in range(len(residual)):
        if not 0.0 < curvature[i] < np.inf:
            residual[i] = curvature[i] = 0.0
            continue
        pull = _pull(start[i], penalty, half)
        residual[i] -= pull * start[i]
        curvature[i] = 1.0 / (curvature[i] + ridge + pull)
        total += np.float64(residual[i]) ** 2 * curvature[i]
    return total


@kernel
def _cost(change, inverse, start, penalty, ridge, half):
    """Damping terms of the objective, over the coefficients that may change."""
    total = 0.0
    for i in range(len(change)):
        if inverse[i] > 0.0:
            step = np.float64(change[i])
            total += ridge * step**2 + _pull(start[i], penalty, half) * (start[i] + step) ** 2
    return total


@kernel
def _turn(direction, residual, inverse, share):
    """Set the next conjugate direction; `share` is the weight of the last one in it."""
    for i in range(len(direction)):
        direction[i] = inverse[i] * residual[i] + share * direction[i]
    return 0.0


@kernel
def _damp(product, direction, start, penalty, ridge, half):
    """Add the damping to a product; return the curvature of the objective along the direction."""
    total = 0.0
    for i in range(len(product)):
        if direction[i] != 0.0:
            product[i] += (ridge + _pull(start[i], penalty, half)) * direction[i]
            total += np.float64(product[i]) * direction[i]
    return total


@kernel
def _move(change, residual, direction, product, inverse, size):
    """Take a step; return the residual's squared norm under the preconditioner."""
    total = 0.0
    for i in range(len(change)):
        change[i] += size * direction[i]
        residual[i] -= size * product[i]
        total += np.float64(residual[i]) ** 2 * inverse[i]
    return total

"""Optimise a scene's attributes to match images, without adding or removing Gaussians."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.preparation.adam import AdamState, Rates, adam_step, new_state, step_sizes
from gs_codec.preparation.checkpoint import Checkpoint, digest_of, read_checkpoint, write_checkpoint
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.gradients import Differentiated, differentiate
from gs_codec.rendering.image_loss import LossWeights
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.atomic import check_writable
from gs_codec.runtime.threads import run_all
from gs_codec.scene import GROUPS, Scene

#: Gaussians that one task updates; with a power of two, columns would share cache lines.
_CHUNK = 1000


@dataclass(frozen=True)
class CurvePoint:
    """Iterations done, seconds, and mean PSNR (dB, unclipped) of the views since the last point."""

    iteration: int
    seconds: float
    psnr: float


@dataclass(frozen=True)
class OptimiseReport:
    """What `optimise` did.

    Attributes
    ----------
    iterations : int
    updated : int
        Gaussians that were seen and so changed.
    curve : list of CurvePoint
        One point for about every hundredth of the run.
    seconds : float
        Total time, including that before interruptions.
    """

    iterations: int
    updated: int
    seconds: float
    curve: list[CurvePoint] = field(default_factory=list)


def optimise(
    scene: Scene,
    cameras: Sequence[Camera],
    targets: Sequence[NDArray],
    iterations: int,
    *,
    rates: Rates = Rates(),  # noqa: B008
    weights: LossWeights = LossWeights(),  # noqa: B008
    background: Sequence[float] = (0.0, 0.0, 0.0),
    seed: int = 0,
    checkpoint: str | Path | None = None,
    checkpoint_every: int = 500,
    progress: Progress | None = None,
) -> tuple[Scene, OptimiseReport]:
    """Fit the attributes of a scene's Gaussians to images, one view an iteration.

    Views come in random order, each once before any comes again. The result is the same
    however often it was interrupted and taken up from `checkpoint`.

    Parameters
    ----------
    scene : Scene
        Not changed; the result has the same Gaussians in the same order.
    cameras : sequence of Camera
    targets : sequence of ndarray
        For each camera an image, shape (H, W, 3), 0-1: photographs, or renders of a scene with
        more Gaussians.
    iterations : int
    rates : Rates
    weights : LossWeights
    background : sequence of three float
        RGB behind everything.
    seed : int
        Seed of the order of views.
    checkpoint : path, optional
        Written every `checkpoint_every` iterations and at the end. If it exists, the run resumes
        from it.
    progress : callable, optional

    Raises
    ------
    InvalidInput
        If there are no cameras, an image does not fit its camera or is not finite, or the
        checkpoint is damaged, belongs to other inputs, or cannot be written.
    """
    _check(cameras, targets, iterations, seed, checkpoint_every)
    image = _images(cameras, targets)
    settings = (iterations, rates, weights, tuple(map(float, background)), scene.antialiased, seed)
    run = Checkpoint(_state_of(scene), np.zeros(0), np.zeros(0))
    save = None
    if checkpoint is not None:
        check_writable(checkpoint)
        digest = digest_of(_inputs(run.state, cameras, image, repr(settings)))
        run = read_checkpoint(Path(checkpoint), digest, run.state) or run
        save = partial(write_checkpoint, Path(checkpoint), digest)
    fitted = _with_values(scene, run.state.values)
    sizes = step_sizes(scene, cameras, rates)

    def step(iteration: int) -> float:
        view = _view(seed, iteration, len(cameras))
        result = differentiate(fitted, cameras[view], image(view), background, weights)
        decayed = sizes * rates.last ** (iteration / iterations)
        _update(run.state, result, iteration + 1, decayed)
        return result.loss.squared_error

    advance = step_counter(progress, "optimise", iterations)
    return fitted, _report(_iterate(run, iterations, step, save, checkpoint_every, advance))


def _iterate(
    run: Checkpoint,
    iterations: int,
    step: Callable[[int], float],
    save: Callable[[Checkpoint], None] | None,
    every: int,
    advance: Callable[[], None] | None,
) -> Checkpoint:
    """Run the remaining iterations; `save` after `every` iterations and at the end."""
    errors, seconds = run.errors.tolist(), run.seconds.tolist()
    done = len(errors)
    start = time.perf_counter() - (seconds[-1] if done else 0.0)
    for count in range(1, iterations + 1):
        if count > done:
            errors.append(step(count - 1))
            seconds.append(time.perf_counter() - start)
            if save is not None and (count % every == 0 or count == iterations):
                save(Checkpoint(run.state, np.array(errors), np.array(seconds)))
        if advance is not None:
            advance()
    return Checkpoint(run.state, np.array(errors), np.array(seconds))


def _check(
    cameras: Sequence[Camera], targets: Sequence[NDArray], iterations: int, seed: int, every: int
) -> None:
    if not cameras:
        raise InvalidInput("cameras: none, expected at least one")
    if len(targets) != len(cameras):
        raise InvalidInput(f"targets: {len(targets)} images of {len(cameras)} cameras")
    for name, value, least in (
        ("iterations", iterations, 0), ("seed", seed, 0), ("checkpoint_every", every, 1),
    ):  # fmt: skip
        if value < least:
            raise InvalidInput(f"{name} {value}: expected at least {least}")


def _images(
    cameras: Sequence[Camera], targets: Sequence[NDArray]
) -> Callable[[int], NDArray[np.float32]]:
    """Return a function that gives the target of a view and checks it."""

    def image(view: int) -> NDArray[np.float32]:
        camera = cameras[view]
        target = np.ascontiguousarray(targets[view], np.float32)
        if target.shape != (camera.height, camera.width, 3):
            expected = (camera.height, camera.width, 3)
            raise InvalidInput(f"image of '{camera.name}': {target.shape}, expected {expected}")
        if not np.isfinite(target).all():
            raise InvalidInput(f"image of '{camera.name}': not finite")
        return target

    return image


def _inputs(
    state: AdamState,
    cameras: Sequence[Camera],
    image: Callable[[int], NDArray[np.float32]],
    settings: str,
) -> Iterator[NDArray | str]:
    """Everything that the result depends on, for the digest."""
    yield settings
    yield state.values
    for view, camera in enumerate(cameras):
        yield repr((camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy))
        yield camera.rotation
        yield camera.position
        yield image(view)


def _state_of(scene: Scene) -> AdamState:
    return new_state(np.concatenate([getattr(scene, group) for group in GROUPS]))


def _with_values(scene: Scene, values: NDArray[np.float32]) -> Scene:
    """The scene with views of ``values (C, N)`` as attributes: it follows their changes."""
    ends = np.cumsum([len(getattr(scene, group)) for group in GROUPS])
    planes: dict[str, Any] = dict(zip(GROUPS, np.split(values, ends[:-1]), strict=True))
    return replace(scene, **planes)


def _view(seed: int, iteration: int, views: int) -> int:
    """Index of an iteration's view; derived from the seed, so checkpoints need not store it."""
    epoch, index = divmod(iteration, views)
    return int(np.random.default_rng([seed, epoch]).permutation(views)[index])


def _update(
    state: AdamState, result: Differentiated, step: int, sizes: NDArray[np.float64]
) -> None:
    """A step of Adam, number `step` from 1."""
    count = state.values.shape[1]

    def update(start: int) -> None:
        stop = min(start + _CHUNK, count)
        first, end = np.searchsorted(result.chosen, (start, stop))
        slopes = result.slopes(first, end)
        adam_step(*state, step, sizes, slopes, result.chosen[first:end], start, stop)

    run_all(update, range(0, count, _CHUNK))


def _report(run: Checkpoint) -> OptimiseReport:
    count = len(run.errors)
    every = max(1, count // 100)
    curve = []
    for start in range(0, count, every):
        stop = min(start + every, count)
        psnr = -10 * np.log10(np.maximum(run.errors[start:stop], 1e-30)).mean()
        curve.append(CurvePoint(stop, float(run.seconds[stop - 1]), float(psnr)))
    total = float(run.seconds[-1]) if count else 0.0
    return OptimiseReport(count, int(run.state.second.any(axis=0).sum()), total, curve)

"""Optimise a scene's attributes to match images, without adding or removing Gaussians."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.plan import Device
from gs_codec.preparation.adam import (
    LAST,
    RATES,
    AdamState,
    Checkpoint,
    adam_step,
    digest_of,
    new_state,
    read_checkpoint,
    step_sizes,
    write_checkpoint,
)
from gs_codec.preparation.reference_views import ReferenceViews, draw_targets
from gs_codec.rendering import gsplat_backend
from gs_codec.rendering.gradients import Differentiated, differentiate
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.atomic import check_writable
from gs_codec.runtime.threads import run_all
from gs_codec.runtime.wording import counted
from gs_codec.scene import GROUPS, Scene

#: Number of Gaussians that one task updates, so that they stay in the cache from one view to the
#: next.
_CHUNK = 1000

#: Views differentiated together, each by its own threads. This takes two thirds of the time; that
#: the second view does not see the first one's step makes no difference.
_TOGETHER = 2

#: One step at full rates may change images by at most this share of the possible improvement (both
#: as root mean squared error); if it would change more, rates are reduced (bench/LAB_NOTEBOOK.md).
_SHARE = 1 / 6

#: Number of views for estimating the possible improvement.
_VIEWS = 16

#: Iterations between checkpoints.
_CHECKPOINT_EVERY = 500

#: Minimum number of iterations whose expected time is announced.
_ANNOUNCED = 200

#: Pairs of iterations that measure the time of one; the first does not count.
_TRIALS = 4

log = logging.getLogger(__name__)


def optimise(
    scene: Scene,
    views: ReferenceViews,
    iterations: int,
    checkpoint: str | Path | None = None,
    progress: Progress | None = None,
    device: Device = "cpu",
) -> tuple[Scene, dict[str, Any]]:
    """Fit the attributes of a scene's Gaussians to images, one view per iteration.

    Views come in random order, each once before any repeats. On the CPU, the result does not depend
    on interruptions and resuming from `checkpoint`. There are no iterations if the rendered views
    already equal the images. Raises InvalidInput if an image is not finite, or the checkpoint is
    damaged, belongs to other inputs, or cannot be written. Raises MissingTool if ``cuda`` is
    requested but not available.

    Parameters
    ----------
    scene : Scene
        Not changed; the result has the same Gaussians in the same order.
    views : ReferenceViews
        Photographs, or renders of a scene with more Gaussians.
    iterations : int
    checkpoint : path, optional
        Written every 500 iterations and at the end. If it exists, the run resumes from it.
    progress : callable, optional
    device : {"auto", "cpu", "cuda"}
        Device; ``cuda`` uses gsplat. See `render`.

    Returns
    -------
    Scene
    dict
        For reports: ``iterations``; ``updated``, the number of visible and thus changed Gaussians;
        ``seconds``, including time before interruptions; and ``curve``, see `_curve`.
    """
    on_device = gsplat_backend.is_chosen(device)
    for camera, image in zip(views.cameras, views.images, strict=True):
        if not np.isfinite(image).all():
            raise InvalidInput(f"image of '{camera.name}': not finite")
    values = np.concatenate([getattr(scene, group) for group in GROUPS])
    run = Checkpoint(new_state(values), np.zeros(0), np.zeros(0))
    save = None
    if checkpoint is not None:
        check_writable(checkpoint)
        settings = (iterations, RATES, LAST, _SHARE, views.background, scene.antialiased)
        digest = digest_of(_inputs(values, views, repr(settings)))
        run = read_checkpoint(Path(checkpoint), digest, run.state) or run
        save = partial(write_checkpoint, Path(checkpoint), digest)
    sizes = step_sizes(scene, views.cameras)
    share = _rates(scene, values, views.evenly(_VIEWS), sizes, device)
    sizes *= share
    iterations = iterations if share > 0 else 0

    make_steps: Callable[[AdamState], Any] = partial(_Steps, scene, views)
    if on_device and iterations:
        from gs_codec.preparation.on_device import DeviceSteps

        make_steps = partial(DeviceSteps, views, scene.antialiased)
    if (left := iterations - len(run.errors)) >= _ANNOUNCED:
        log.info("%s", _announcement(left, _seconds_each(make_steps, values, len(views.cameras))))
    steps = make_steps(run.state)

    def step(start: int, stop: int) -> list[float]:
        order = [view_of(i, len(views.cameras)) for i in range(start, stop)]
        decayed = [sizes * LAST ** (i / iterations) for i in range(start, stop)]
        return steps.take(order, start + 1, decayed)

    advance = step_counter(progress, "optimise", iterations)
    run = _iterate(run, iterations, step, steps.state, save, advance)
    return with_values(scene, run.state.values.T), {
        "iterations": iterations,
        "updated": int(run.state.second.any(axis=1).sum()),
        "seconds": float(run.seconds[-1]) if iterations else 0.0,
        "curve": _curve(run),
    }


class _Steps:
    """Steps of Adam on the CPU, several views at once; the same interface as `DeviceSteps`."""

    def __init__(self, scene: Scene, views: ReferenceViews, state: AdamState) -> None:
        self._state, self._views = state, views
        self._fitted = with_values(scene, state.values.T)

    def take(
        self, order: Sequence[int], step: int, sizes: Sequence[NDArray[np.float64]]
    ) -> list[float]:
        """Take a step for each view index in `order`, numbered from `step`; return errors."""
        seen = run_all(self._look, order)
        take_steps(self._state, seen, step, sizes)
        return [each.squared_error for each in seen]

    def _look(self, view: int) -> Differentiated:
        camera, image = self._views.cameras[view], self._views.images[view]
        return differentiate(self._fitted, camera, image, self._views.background)

    def state(self) -> AdamState:
        """The current state, which the next step overwrites."""
        return self._state


def _seconds_each(
    make_steps: Callable[[AdamState], Any], values: NDArray[np.float32], views: int
) -> float:
    """Measure the seconds of an iteration, with steps of size 0 from a state of its own."""
    trial, still = make_steps(new_state(values)), [np.zeros(len(values))] * _TOGETHER
    seconds = []
    for i in range(_TRIALS):
        start = time.perf_counter()
        trial.take([view_of(k, views) for k in range(i, i + _TOGETHER)], 1, still)
        seconds.append((time.perf_counter() - start) / _TOGETHER)
    # The first compiles or loads kernels.
    return float(np.median(seconds[1:]))


def _announcement(iterations: int, seconds_each: float) -> str:
    """What a person reads before the iterations start."""
    seconds = max(round(iterations * seconds_each), 1)
    expected = counted(seconds, "second")
    if seconds >= 90:
        expected = counted(round(seconds / 60), "minute")
    return f"refine: {counted(iterations, 'iteration')}, about {expected}"


def _rates(
    scene: Scene,
    values: NDArray[np.float32],
    views: ReferenceViews,
    sizes: NDArray[np.float64],
    device: Device,
) -> float:
    """Factor on all step sizes, at most 1.

    Adam's steps have the same size when little can be improved, and would then do more harm than
    good.
    """
    signs = np.random.default_rng(0).integers(0, 2, values.shape, np.int8)
    with np.errstate(over="ignore"):
        moved = values + sizes.astype(np.float32)[:, None] * (2 * signs - 1)
    behind = views.background
    own = draw_targets(scene, views.cameras, behind, device)
    other = draw_targets(with_values(scene, moved), views.cameras, behind, device)
    wanted, changed = (_difference(own.images, images) for images in (views.images, other.images))
    return min(1.0, _SHARE * math.sqrt(wanted / changed)) if changed > 0 else 1.0


def _difference(first: Sequence[NDArray], second: Sequence[NDArray]) -> float:
    """Mean squared difference of images, in their displayed range."""
    pairs = zip(first, second, strict=True)
    return float(np.mean([np.mean((np.clip(a, 0, 1) - np.clip(b, 0, 1)) ** 2) for a, b in pairs]))


def _iterate(
    run: Checkpoint,
    iterations: int,
    step: Callable[[int, int], list[float]],
    state: Callable[[], AdamState],
    save: Callable[[Checkpoint], None] | None,
    advance: Callable[[], None],
) -> Checkpoint:
    """Run the remaining iterations; call `save` regularly and at the end."""
    errors, seconds = run.errors.tolist(), run.seconds.tolist()
    done = len(errors)
    start = time.perf_counter() - (seconds[-1] if done else 0.0)
    for _ in range(done):
        advance()
    while len(errors) < iterations:
        found = step(len(errors), min(len(errors) + _TOGETHER, iterations))
        errors += found
        seconds += [time.perf_counter() - start] * len(found)
        if save is not None and (len(errors) % _CHECKPOINT_EVERY == 0 or len(errors) == iterations):
            save(Checkpoint(state(), np.array(errors), np.array(seconds)))
        for _ in found:
            advance()
    return Checkpoint(state(), np.array(errors), np.array(seconds))


def _inputs(
    values: NDArray[np.float32], views: ReferenceViews, settings: str
) -> Iterator[NDArray | str]:
    """Everything that the result depends on, for the digest."""
    yield settings
    yield values
    for camera, image in zip(views.cameras, views.images, strict=True):
        yield repr((camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy))
        yield from (camera.rotation, camera.position, image)


def with_values(scene: Scene, values: NDArray[np.float32]) -> Scene:
    """The scene with views of ``values (C, N)`` as attributes, so that it follows their changes."""
    ends = np.cumsum([len(getattr(scene, group)) for group in GROUPS])
    planes: dict[str, Any] = dict(zip(GROUPS, np.split(values, ends[:-1]), strict=True))
    return replace(scene, **planes)


def view_of(iteration: int, views: int) -> int:
    """Index of an iteration's view; checkpoints need not store a generator's state."""
    epoch, index = divmod(iteration, views)
    return int(np.random.default_rng([0, epoch]).permutation(views)[index])


def take_steps(
    state: AdamState,
    seen: Sequence[Differentiated],
    step: int,
    sizes: Sequence[NDArray[np.float64]],
) -> None:
    """Take steps of Adam, numbered from `step`, by views differentiated at the same values."""
    count = len(state.values)

    def update(start: int) -> None:
        stop = min(start + _CHUNK, count)
        bounds = [np.searchsorted(view.chosen, (start, stop)) for view in seen]
        # All slopes before the first step, which changes the values they depend on.
        slopes = [view.slopes(*part) for view, part in zip(seen, bounds, strict=True)]
        for k, (first, end) in enumerate(bounds):
            chosen = seen[k].chosen[first:end]
            adam_step(*state, step + k, sizes[k], slopes[k], chosen, start, stop)

    run_all(update, range(0, count, _CHUNK))


def _curve(run: Checkpoint) -> list[dict[str, Any]]:
    """Learning curve with about 100 points.

    Each point has the number of iterations, the seconds, and the mean PSNR (dB, unclipped) of the
    views since the previous point.
    """
    count = len(run.errors)
    every = max(1, count // 100)
    curve = []
    for start in range(0, count, every):
        stop = min(start + every, count)
        psnr = -10 * np.log10(np.maximum(run.errors[start:stop], 1e-30)).mean()
        seconds = float(run.seconds[stop - 1])
        curve.append({"iteration": stop, "seconds": seconds, "psnr": float(psnr)})
    return curve

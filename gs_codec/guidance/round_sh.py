"""Rate-distortion optimised rounding of SH-AC to levels, measured in views."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.coding.binary import bit_length
from gs_codec.formats.attribute_steps import ShGrid
from gs_codec.preparation.sh_weights import (
    coefficients_of,
    fill_matrix,
    list_views,
    with_coefficients,
)
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.simd import LANES
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene, sh_bands

#: Weight of all directions alike, relative to the weight of the views. Without it, errors between
#: sparse views would grow.
_ELSEWHERE = 2.0

#: Value of a bit, relative to the squared error that it removes when spent on a finer step.
_WORTH = 0.5

#: Approximate bits of a level of magnitude 1.
_FIRST_BITS = 4.0

#: Approximate extra bits for each further octave of magnitude.
_OCTAVE_BITS = 1.5

#: Maximum number of passes over all coefficients.
_SWEEPS = 3

_CHUNK = 1 << 12


def round_sh(
    scene: Scene,
    cameras: Sequence[Camera],
    weights: NDArray[np.float32],
    steps: NDArray[np.float32],
    error: float,
    progress: Progress | None = None,
) -> Scene:
    """Round SH-AC to levels, and let SH-DC compensate for the visible error.

    The squared error of a Gaussian is a quadratic form in the rounding errors of all its SH, which
    depends on the viewing directions. Starting from the nearest levels, each level is moved by one
    if this lowers the form (with the best SH-DC) plus the cost of the bits. SH-AC of 0 stay 0.
    Gaussians not visible to any camera do not change.

    Parameters
    ----------
    scene : Scene
    cameras : sequence of Camera
    weights : ndarray, shape (views, N), float32
        `squared_weights` of the scene.
    steps : ndarray, shape (bands, N), float32
        Step sizes of SH-AC.
    error : float
        Squared error that a parameter may add, summed over the values of all views.
    progress : callable, optional
    """
    if not scene.sh_degree:
        return scene
    sh = coefficients_of(scene)
    _round_all(sh, scene, cameras, weights, steps, error, progress)
    return with_coefficients(scene, sh)


def round_rgb(
    scene: Scene,
    cameras: Sequence[Camera],
    weights: NDArray[np.float32],
    grid: ShGrid,
    progress: Progress | None = None,
) -> Scene:
    """Like `round_sh`, in R, G and B, for a format in which all levels take the same bits."""
    rest = scene.f_rest.reshape(3, -1, scene.count)
    sh = np.empty((scene.count, 3, 1 + rest.shape[1]), np.float32)
    sh[:, :, 0] = scene.f_dc.T
    shift = grid.offset * grid.steps[_bands(rest.shape[1])[1:]].T[:, None]
    sh[:, :, 1:] = rest.transpose(2, 0, 1) - shift
    _round_all(sh, scene, cameras, weights, grid.steps, 0.0, progress)
    f_rest = (sh[:, :, 1:] + shift).transpose(1, 2, 0).reshape(scene.f_rest.shape)
    f_dc = np.ascontiguousarray(sh[:, :, 0].T)
    return replace(scene, f_dc=f_dc, f_rest=np.ascontiguousarray(f_rest))


def _bands(coefficients: int) -> NDArray[np.int64]:
    """Band number of each SH-AC, from 0; the entry of SH-DC is not used."""
    bands = enumerate(sh_bands(coefficients))
    return np.array([0, *(number for number, band in bands for _ in band)])


def _round_all(
    sh: NDArray[np.float32],
    scene: Scene,
    cameras: Sequence[Camera],
    weights: NDArray[np.float32],
    steps: NDArray[np.float32],
    error: float,
    progress: Progress | None,
) -> None:
    """Round SH ``(N, 3, 1 + K)`` in place."""
    band_of = _bands(sh.shape[2] - 1)
    centres = np.array([camera.position for camera in cameras])
    by_gaussian = np.ascontiguousarray(weights.T)
    # Bits cost a factor of 4 in uniform error, hence the logarithm of 4.
    price = _WORTH * math.log(4.0) * error

    def run(start: int) -> None:
        stop = min(start + _CHUNK, scene.count)
        _round(scene.positions, by_gaussian, centres, steps, band_of, price, sh, start, stop)

    starts = range(0, scene.count, _CHUNK)
    run_all(run, starts, advance=step_counter(progress, "round", len(starts)))


@kernel
def _round(positions, weights, centres, steps, band_of, price, sh, start, stop):
    """Round the SH ``(N, 3, 1 + K)`` of Gaussians `start` to `stop` in place."""
    views, size = len(centres), sh.shape[2]
    rows, seen, every = np.zeros((views, LANES)), np.empty(views), np.arange(views)
    form, lean, step = np.empty((LANES, LANES)), np.empty(size), np.empty(size)
    for i in range(start, stop):
        count = list_views(positions, i, weights, every, centres, size, rows, seen)
        if count == 0:
            continue
        fill_matrix(rows[:count], seen, size, form)
        _leave_out_dc(form, lean)
        for k in range(1, size):
            step[k] = steps[band_of[k], i]
        for channel in range(3):
            _move_levels(form, lean, step, price, sh[i, channel])


@kernel
def _leave_out_dc(form, lean):
    """Add all directions to a form, and eliminate SH-DC by its best value.

    ``lean[k]`` becomes the change of SH-DC per unit that coefficient k decreases.
    """
    size = len(lean)
    # The basis is orthonormal: over all directions, every function has the same mean square as the
    # first.
    elsewhere = _ELSEWHERE * form[0, 0]
    for k in range(size):
        form[k, k] += elsewhere
    for k in range(size):
        lean[k] = form[0, k] / form[0, 0]
    for k in range(1, size):
        for m in range(1, size):
            form[k, m] -= lean[k] * form[0, m]


@inlined
def _bits(level):
    size = abs(level)
    return 0.0 if size == 0 else _FIRST_BITS + _OCTAVE_BITS * (bit_length(size) - 1)


@kernel
def _move_levels(form, lean, step, price, values):
    """Round the SH ``(1 + K,)`` of one channel in place."""
    size = len(values)
    levels, rest, slope = np.zeros(size, np.int64), np.zeros(size), np.zeros(size)
    for k in range(1, size):
        levels[k] = np.int64(np.floor(values[k] / step[k] + 0.5))
        rest[k] = values[k] - levels[k] * step[k]
    for k in range(1, size):
        for m in range(1, size):
            slope[k] += form[k, m] * rest[m]
    for _ in range(_SWEEPS):
        moved = False
        for k in range(1, size):
            if values[k] == 0.0:
                continue
            best, way = 0.0, 0
            for d in (-1, 1):
                gain = step[k] * (2 * d * slope[k] - step[k] * form[k, k])
                gain -= price * (_bits(levels[k] + d) - _bits(levels[k]))
                if gain > best:
                    best, way = gain, d
            if way != 0:
                moved = True
                levels[k] += way
                rest[k] -= way * step[k]
                for m in range(1, size):
                    slope[m] -= way * step[k] * form[m, k]
        if not moved:
            break
    for k in range(1, size):
        values[0] += lean[k] * rest[k]
        values[k] = levels[k] * step[k]

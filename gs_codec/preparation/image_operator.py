"""Images as a linear function of SH, and its transpose.

A colour below black is clamped; apart from that an image is linear in SH: its pixels sum up the
Gaussians' colours by their weights alpha T, which the rasteriser's own trace gives.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.kernels import kernel
from gs_codec.preparation.sh_weights import sh_row
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.frame import make_frame
from gs_codec.rendering.project import TILE
from gs_codec.rendering.trace import tile_bounds, trace_splat
from gs_codec.scene import Scene
from gs_codec.workers import available_threads, run_all

#: Image ``(H, W, 3)`` of each view, as a sequence or as a function of the view's number.
Targets = Sequence[NDArray] | Callable[[int], NDArray]

Advance = Callable[[], None] | None

#: Column of (alpha T)^2 in what is summed over pixels, after R, G, B.
_SQUARED = 3

#: Gaussians whose gradient one call adds up.
_CHUNK = 1 << 14

#: Views worked on at a time: each takes some 300 bytes a Gaussian.
_MOST_AT_ONCE = 4


class Linear(NamedTuple):
    """Images near some coefficients.

    Attributes
    ----------
    gradient : ndarray, shape (3, 1 + K, N)
        The transposed operator on the residual: minus half the gradient of `error`.
    curvature : ndarray, shape (3, 1 + K, N)
        Diagonal of the normal equations.
    lit : ndarray, shape (views, N), uint8
        Bit 0, 1, 2: whether R, G, B of the Gaussian are above black in the view.
    error : float
        Sum over views, pixels and colours of the squared residual.
    """

    gradient: NDArray
    curvature: NDArray
    lit: NDArray[np.uint8]
    error: float


@dataclass(frozen=True)
class ImageOperator:
    """What cameras see of a scene as a function of its SH; all else of it is fixed.

    Coefficients are ``(3, 1 + K, N)``, DC first, float32 or float64; results have their dtype.

    Parameters
    ----------
    scene : Scene
        Its colours are not used.
    cameras : sequence of Camera
    background : sequence of three float
    antialiased : bool, optional
        As for `render`.
    threads : int, optional
        Never changes the result.
    """

    scene: Scene
    cameras: Sequence[Camera]
    background: Sequence[float] = (0.0, 0.0, 0.0)
    antialiased: bool | None = None
    threads: int | None = None

    def linearise(self, coefficients: NDArray, targets: Targets, advance: Advance = None) -> Linear:
        """The residual ``target - image`` of all views, and what follows from it.

        Raises
        ------
        InvalidInput
            If a target has not the shape of its camera's image.
        """
        gradient, curvature = np.zeros_like(coefficients), np.zeros_like(coefficients)
        lit = np.zeros((len(self.cameras), self.scene.count), np.uint8)
        background = np.array(self.background, np.float64)

        def gather(view: int) -> tuple[NDArray, float]:
            target = _target(targets, view, self.cameras[view])
            return self._gather(view, coefficients, True, lit[view], target, background)

        error = self._add_up(gather, lit, gradient, curvature, advance)
        return Linear(gradient, curvature, lit, error)

    def error(self, coefficients: NDArray, targets: Targets, advance: Advance = None) -> float:
        """Sum over views, pixels and colours of the squared residual."""
        background, nothing = np.array(self.background, np.float64), coefficients[:0]

        def gather(view: int) -> tuple[NDArray, float]:
            lit = np.empty(self.scene.count, np.uint8)
            target = _target(targets, view, self.cameras[view])
            return self._gather(view, coefficients, True, lit, target, background)

        return self._add_up(gather, None, nothing, nothing, advance)

    def apply(self, direction: NDArray, lit: NDArray[np.uint8], advance: Advance = None) -> NDArray:
        """The normal equations on a change of SH: transposed operator on what images change by."""
        product = np.zeros_like(direction)

        def gather(view: int) -> tuple[NDArray, float]:
            camera = self.cameras[view]
            black = np.zeros((camera.height, camera.width, 3), np.float32)
            return self._gather(view, direction, False, lit[view], black, np.zeros(3))

        self._add_up(gather, lit, product, product[:0], advance)
        return np.negative(product, out=product)

    def _gather(
        self,
        view: int,
        coefficients: NDArray,
        clamp: bool,
        lit: NDArray[np.uint8],
        target: NDArray,
        background: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], float]:
        """Sums ``(N, 4)`` of alpha T times a view's residual, and of (alpha T)^2; its error."""
        scene, camera = self.scene, self.cameras[view]
        colours = np.empty((scene.count, 3))
        _fill_colours(scene.positions, camera.position, coefficients, clamp, lit, colours)
        # A thread for each view costs less than several for one.
        frame = make_frame(scene, camera, self.antialiased, threads=1)
        sums = np.zeros((frame.pairs, 4))
        errors = np.zeros(frame.columns * frame.rows)
        colours = colours[frame.splats.gaussians]
        frame.over_tiles(_transpose_tiles, colours, target, background, sums, errors)
        return frame.sum_pairs(scene.count, sums), float(errors.sum())

    def _add_up(
        self,
        gather: Callable[[int], tuple[NDArray, float]],
        lit: NDArray[np.uint8] | None,
        gradient: NDArray,
        curvature: NDArray,
        advance: Advance,
    ) -> float:
        """Add views in order to what is not empty of the two, or None; returns the error."""
        count, threads = self.scene.count, self.threads or available_threads()
        at_once = min(threads, _MOST_AT_ONCE)
        error = 0.0
        for first in range(0, len(self.cameras), at_once):
            views = range(first, min(first + at_once, len(self.cameras)))
            gathered = run_all(gather, views, at_once, advance)
            for view, (sums, squares) in zip(views, gathered, strict=True):
                error += squares
                if lit is None:
                    continue
                seen = (self.scene.positions, self.cameras[view].position, sums, lit[view])

                def add(start: int, seen: tuple = seen) -> None:
                    _add_gradient(*seen, start, min(start + _CHUNK, count), gradient, curvature)

                run_all(add, range(0, count, _CHUNK), threads)
        return error


def _target(targets: Targets, view: int, camera: Camera) -> NDArray:
    target = targets(view) if callable(targets) else targets[view]
    if target.shape != (camera.height, camera.width, 3):
        raise InvalidInput(
            f"target {view}: shape {target.shape}, "
            f"expected ({camera.height}, {camera.width}, 3) of camera '{camera.name}'"
        )
    return target


@kernel
def _fill_colours(positions, camera, coefficients, clamp, lit, colours):
    """Fill ``colours (N, 3)``: those of SH clamped at black, or the change that SH make to them.

    With `clamp`, bits 0-2 of ``lit (N,)`` are set where a colour is above black; without, they
    are read, because a change of SH does nothing to a colour that is clamped.
    """
    row = np.empty(coefficients.shape[1])
    for i in range(len(colours)):
        sh_row(positions, i, camera, row)
        if clamp:
            lit[i] = 0
        for channel in range(3):
            value = 0.5 if clamp else 0.0
            for k in range(len(row)):
                value += row[k] * coefficients[channel, k, i]
            if clamp and value > 0.0:
                lit[i] |= 1 << channel
            colours[i, channel] = value if lit[i] >> channel & 1 else 0.0


@kernel
def _transpose_tiles(
    fields, splats, starts, first, end, columns, colours, target, background, sums, errors
):
    """Fill ``sums (pairs, 4)`` and ``errors (tiles,)`` of tiles `first` to `end`."""
    height, width = target.shape[:2]
    residual = np.empty((TILE * TILE, 3))
    # What is traced forth is kept for the way back; of one tile that is little.
    pixels = np.empty(1 << 14, np.uint8)
    weights = np.empty(1 << 14)
    for tile in range(first, end):
        bounds = tile_bounds(tile, columns, width, height)
        x0, x1, y0, y1 = bounds
        residual[:] = 0.0
        for y in range(y0, y1):
            for x in range(x0, x1):
                residual[(y - y0) * TILE + x - x0] = target[y, x]
        listed = splats[starts[tile] : starts[tile + 1]]
        ends = np.empty(len(listed), np.int64)
        pixels, weights, drawn = _take_away(
            fields, listed, bounds, colours, background, residual, pixels, weights, ends
        )
        errors[tile] = np.sum(residual * residual)
        start = 0
        for i in range(drawn):
            total = sums[starts[tile] + i]
            for j in range(start, ends[i]):
                weight = weights[j]
                light = residual[pixels[j]]
                for channel in range(3):
                    total[channel] += weight * light[channel]
                total[_SQUARED] += weight * weight
            start = ends[i]


@kernel
def _take_away(
    fields, listed, bounds, colours, background, residual, pixels, weights, ends
):  # fmt: skip
    """Take a tile's splats and the background off ``residual (256, 3)``, and list their weights.

    Splat i has entries ``ends[i - 1]`` to ``ends[i]`` of `pixels` and `weights`, which are
    replaced by longer ones where needed; returns both, and how many splats have entries.
    """
    x0, x1, y0, y1 = bounds
    left = np.ones(TILE * TILE)
    traced = np.empty(TILE * TILE, np.int64)
    alphas = np.empty(TILE * TILE)
    before = np.empty(TILE * TILE)
    still_open = (x1 - x0) * (y1 - y0)
    used = drawn = 0
    while drawn < len(listed) and still_open > 0:
        splat = listed[drawn]
        count, done = trace_splat(fields[splat], x0, x1, y0, y1, left, traced, alphas, before)
        if used + count > len(pixels):
            pixels = np.concatenate((pixels, np.empty_like(pixels)))
            weights = np.concatenate((weights, np.empty_like(weights)))
        for i in range(count):
            weight = alphas[i] * before[i]
            pixels[used] = traced[i]
            weights[used] = weight
            used += 1
            for channel in range(3):
                residual[traced[i], channel] -= weight * colours[splat, channel]
        ends[drawn] = used
        drawn += 1
        still_open -= done
    for y in range(y1 - y0):
        for x in range(x1 - x0):
            pixel = y * TILE + x
            for channel in range(3):
                residual[pixel, channel] -= abs(left[pixel]) * background[channel]
    return pixels, weights, drawn


@kernel
def _add_gradient(positions, camera, sums, lit, start, stop, gradient, curvature):
    """Add a view's share to ``gradient (3, 1 + K, N)`` and, if it is not empty, `curvature`."""
    row = np.empty(gradient.shape[1])
    for i in range(start, stop):
        if sums[i, _SQUARED] == 0.0:
            continue
        sh_row(positions, i, camera, row)
        for channel in range(3):
            if lit[i] >> channel & 1:
                for k in range(len(row)):
                    gradient[channel, k, i] += row[k] * sums[i, channel]
                    if len(curvature):
                        curvature[channel, k, i] += row[k] * row[k] * sums[i, _SQUARED]

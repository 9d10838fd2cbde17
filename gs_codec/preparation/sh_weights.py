"""SH as one array of Y, Co and Cg, their weights in views, and small least squares."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.coding.ycocg import luma_chroma, red_green_blue
from gs_codec.rendering.harmonics import sh_basis
from gs_codec.rendering.renderer import render
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.simd import LANES, load, repeated, store
from gs_codec.runtime.threads import run_all
from gs_codec.scene import SH_C0, Scene

#: Rounding error of float32, relative to the largest of R, G and B.
_ROUNDING = 2.0**-22

_CHUNK = 1 << 13


@kernel
def fill_matrix(rows, evidence, size, matrix):
    """Fill the first `size` rows of a matrix with the sum of ``evidence * row row^T``.

    ``rows (views, 16)`` and ``matrix (16, 16)`` are 0 in columns from `size` on.
    """
    # Four rows at a time, because additions wait for one another.
    for k in range(0, size, 4):
        a = b = c = d = repeated(0.0)
        for j in range(len(rows)):
            row, weight = load(rows, j * LANES), evidence[j]
            a += (weight * rows[j, k]) * row
            b += (weight * rows[j, k + 1]) * row
            c += (weight * rows[j, k + 2]) * row
            d += (weight * rows[j, k + 3]) * row
        store(matrix, k * LANES, a)
        store(matrix, (k + 1) * LANES, b)
        store(matrix, (k + 2) * LANES, c)
        store(matrix, (k + 3) * LANES, d)


@kernel
def solve(matrix, right, size):
    """Solve for the first `size` unknowns in place, by Cholesky.

    Reads the upper half of ``matrix (16, 16)``. Returns False if it is not positive definite, or
    the result is not finite.
    """
    for k in range(size):
        if not matrix[k, k] > 0.0:
            return False
        root = math.sqrt(matrix[k, k])
        row = load(matrix, k * LANES) / root
        store(matrix, k * LANES, row)
        matrix[k, k] = root
        right[k] /= root
        for m in range(k + 1, size):
            factor = matrix[k, m]
            right[m] -= factor * right[k]
            store(matrix, m * LANES, load(matrix, m * LANES) - factor * row)
    finite = True
    for k in range(size - 1, -1, -1):
        right[k] /= matrix[k, k]
        finite = finite and abs(right[k]) < np.inf
        for n in range(k):
            right[n] -= matrix[n, k] * right[k]
    return finite


def coefficients_of(scene: Scene) -> NDArray[np.float32]:
    """SH of all bands in Y, Co, Cg ``(N, 3, 1 + K)``, DC first; a copy.

    Values that are only rounding errors of R, G and B become 0.
    """
    coefficients = np.empty((scene.count, 3, 1 + len(scene.f_rest) // 3), np.float32)

    def run(start: int) -> None:
        stop = min(start + _CHUNK, scene.count)
        _read_colours(scene.f_dc, scene.f_rest, start, stop, coefficients)

    run_all(run, range(0, scene.count, _CHUNK))
    return coefficients


def with_coefficients(scene: Scene, coefficients: NDArray) -> Scene:
    """The scene with SH in Y, Co, Cg ``(N, 3, 1 + K)`` in place of its own.

    Unchanged colours, and colours that are not finite, keep their exact R, G, B.
    """
    f_dc, f_rest = scene.f_dc.copy(), scene.f_rest.copy()

    def run(start: int) -> None:
        stop = min(start + _CHUNK, scene.count)
        _write_colours(coefficients, start, stop, f_dc, f_rest)

    run_all(run, range(0, scene.count, _CHUNK))
    return replace(scene, f_dc=f_dc, f_rest=f_rest)


@inlined
def _colour(f_dc, f_rest, i, k):
    """Y, Co, Cg of a coefficient; 0 where they are only rounding errors of R, G and B."""
    if k == 0:
        red, green, blue = f_dc[0, i], f_dc[1, i], f_dc[2, i]
    else:
        band = len(f_rest) // 3
        red, green, blue = f_rest[k - 1, i], f_rest[band + k - 1, i], f_rest[2 * band + k - 1, i]
    y, o, g = luma_chroma(np.float64(red), np.float64(green), np.float64(blue))
    least = _ROUNDING * max(abs(red), abs(green), abs(blue))
    y = 0.0 if abs(y) < least else y
    o = 0.0 if abs(o) < least else o
    g = 0.0 if abs(g) < least else g
    return np.float32(y), np.float32(o), np.float32(g)


@kernel
def _read_colours(f_dc, f_rest, start, stop, coefficients):
    for i in range(start, stop):
        for k in range(coefficients.shape[2]):
            y, o, g = _colour(f_dc, f_rest, i, k)
            coefficients[i, 0, k], coefficients[i, 1, k], coefficients[i, 2, k] = y, o, g


@kernel
def _write_colours(coefficients, start, stop, f_dc, f_rest):
    band = len(f_rest) // 3
    for i in range(start, stop):
        for k in range(1 + band):
            before = _colour(f_dc, f_rest, i, k)
            y, o, g = coefficients[i, 0, k], coefficients[i, 1, k], coefficients[i, 2, k]
            same = before[0] == y and before[1] == o and before[2] == g
            if same or not (np.isfinite(y) and np.isfinite(o) and np.isfinite(g)):
                continue
            red, green, blue = red_green_blue(np.float64(y), np.float64(o), np.float64(g))
            if k == 0:
                f_dc[0, i], f_dc[1, i], f_dc[2, i] = red, green, blue
            else:
                f_rest[k - 1, i], f_rest[band + k - 1, i] = red, green
                f_rest[2 * band + k - 1, i] = blue


def squared_weights(
    scene: Scene,
    cameras: Sequence[Camera],
    progress: Progress | None = None,
) -> NDArray[np.float32]:
    """Sums of (alpha T)^2 over the pixels of each view, ``(views, N)``; 0 if not visible."""
    weights = zero_weights(len(cameras), scene.count)
    advance = step_counter(progress, "weights", len(cameras))

    def weigh(view: int) -> None:
        # One thread per view is faster than several threads per view.
        drawn = render(scene, cameras[view], accumulate=True, device="cpu")
        weights[view] = drawn.accumulations.squared_weight  # type: ignore[union-attr]

    run_all(weigh, range(len(cameras)), advance=advance)
    return weights


@inlined
def sh_row(positions, i, camera, row):
    """Fill ``row (1 + K,)`` with the SH basis in the direction from a camera to Gaussian i."""
    dx = positions[0, i] - camera[0]
    dy = positions[1, i] - camera[1]
    dz = positions[2, i] - camera[2]
    distance = np.sqrt(dx * dx + dy * dy + dz * dz)
    row[0] = SH_C0
    sh_basis(dx / distance, dy / distance, dz / distance, len(row) - 1, row[1:])


def zero_weights(views: int, count: int) -> NDArray[np.float32]:
    """Zeros for the `squared_weights` of Gaussians; those of a Gaussian are side by side."""
    return np.zeros((count, views), np.float32).T


@kernel
def list_views(positions, i, weights, chosen, centres, size, rows, seen):
    """List SH basis and weight of `chosen` views where Gaussian i is visible; return their number.

    The first `size` functions are written to ``rows (views, 16)``; ``weights (N, views)``.
    """
    count = 0
    for view in chosen:
        if weights[i, view] > 0.0:
            sh_row(positions, i, centres[view], rows[count, :size])
            seen[count] = weights[i, view]
            count += 1
    return count

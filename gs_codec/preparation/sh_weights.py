"""SH as one array of Y, Co and Cg, their weights in views, and small least squares."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.ycocg import from_ycocg, to_ycocg
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.harmonics import sh_basis
from gs_codec.rendering.renderer import render
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.runtime.threads import run_all
from gs_codec.scene import SH_C0, Scene

#: Rounding of float32, relative to the largest of R, G and B.
_ROUNDING = 2.0**-22


@kernel
def fill_matrix(rows, evidence, matrix):
    """Fill ``matrix (1 + K, 1 + K)`` with the sum of ``evidence * row row^T``."""
    size = rows.shape[1]
    matrix[:] = 0.0
    for j in range(len(rows)):
        if evidence[j] == 0.0:
            continue
        for k in range(size):
            weight = evidence[j] * rows[j, k]
            for m in range(k + 1):
                matrix[k, m] += weight * rows[j, m]
    for k in range(size):
        for m in range(k):
            matrix[m, k] = matrix[k, m]


@kernel
def solve(matrix, right):
    """Solve in place by Cholesky; False if not positive definite or the result is not finite."""
    # Each column is taken from all that follow at once: no sum waits for its last term.
    size = len(right)
    for k in range(size):
        if not matrix[k, k] > 0.0:
            return False
        root = math.sqrt(matrix[k, k])
        matrix[k, k] = root
        right[k] /= root
        for m in range(k + 1, size):
            matrix[m, k] /= root
            factor = matrix[m, k]
            right[m] -= factor * right[k]
            for n in range(k + 1, m + 1):
                matrix[m, n] -= factor * matrix[n, k]
    finite = True
    for k in range(size - 1, -1, -1):
        right[k] /= matrix[k, k]
        finite = finite and abs(right[k]) < np.inf
        for n in range(k):
            right[n] -= matrix[k, n] * right[k]
    return finite


def coefficients_of(scene: Scene) -> NDArray[np.float32]:
    """SH of all bands in Y, Co, Cg ``(N, 3, 1 + K)``, DC first; a copy.

    What is only the rounding of R, G and B is 0.
    """
    planes = _planes_of(scene)
    coefficients = np.empty(planes.shape, np.float32)
    for k in range(planes.shape[1]):
        with np.errstate(invalid="ignore", over="ignore"):
            found = to_ycocg(planes[:, k])
            found[np.abs(found) < _ROUNDING * np.abs(planes[:, k]).max(axis=0)] = 0.0
            coefficients[:, k] = found
    return np.ascontiguousarray(coefficients.transpose(2, 0, 1))


def with_coefficients(scene: Scene, coefficients: NDArray) -> Scene:
    """The scene with SH in Y, Co, Cg ``(N, 3, 1 + K)`` in place of its own.

    Colours that are the same, or not finite, stay as they are in R, G, B.
    """
    planes, before = _planes_of(scene), coefficients_of(scene)
    for k in range(planes.shape[1]):
        found = coefficients[:, :, k].T
        changed = (found != before[:, :, k].T).any(axis=0) & np.isfinite(found).all(axis=0)
        planes[:, k, changed] = from_ycocg(found[:, changed].astype(np.float64))
    f_rest = np.ascontiguousarray(planes[:, 1:]).reshape(len(scene.f_rest), scene.count)
    return replace(scene, f_dc=np.ascontiguousarray(planes[:, 0]), f_rest=f_rest)


def _planes_of(scene: Scene) -> NDArray[np.float32]:
    """SH of all bands in R, G, B ``(3, 1 + K, N)``, DC first; a copy."""
    ac = scene.f_rest.reshape(3, len(scene.f_rest) // 3, scene.count)
    return np.concatenate([scene.f_dc[:, None], ac], axis=1)


def squared_weights(
    scene: Scene,
    cameras: Sequence[Camera],
    progress: Progress | None = None,
) -> NDArray[np.float32]:
    """Sums of (alpha T)^2 over the pixels of each view, ``(views, N)``; 0 where not seen."""
    weights = np.empty((len(cameras), scene.count), np.float32)
    advance = step_counter(progress, "weights", len(cameras))

    def weigh(view: int) -> None:
        # One thread for each view is faster than several for one view.
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


@kernel
def list_views(positions, i, weights, centres, rows, seen):
    """List SH basis and weight of the views that see Gaussian i; return how many they are."""
    count = 0
    for view in range(len(weights)):
        if weights[view, i] > 0.0:
            sh_row(positions, i, centres[view], rows[count])
            seen[count] = weights[view, i]
            count += 1
    return count

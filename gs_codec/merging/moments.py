"""Convert Gaussians to covariances and back, with bit-identical results on every machine."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.exact_math import exact_exp, exact_log
from gs_codec.rendering.project import quaternion_turn
from gs_codec.runtime.kernels import inlined, kernel
from gs_codec.scene import Scene

#: Log-scales are clamped to this, so that products of variances do not overflow.
_LARGEST = 80.0

#: Minimum variance and opacity, so that logarithms are finite.
_TINY = 1e-300

#: Maximum number of sweeps over all pairs of axes.
_SWEEPS = 12

#: Off-diagonal entries below this, relative to the geometric mean of their diagonal entries, count
#: as 0.
_NOTHING = 1e-17


def covariances_of(scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Covariances ``(N, 6)``, xx, yy, zz, xy, yz, zx, and opacities ``(N,)`` of Gaussians."""
    covariances, opacity = np.empty((scene.count, 6)), np.empty(scene.count)
    planes = (np.ascontiguousarray(p) for p in (scene.log_scale, scene.rot, scene.opacity[0]))
    _fill_covariances(*planes, covariances, opacity)
    return covariances, opacity


@kernel
def _fill_covariances(log_scale, rot, logits, covariances, opacity):
    for i in range(len(opacity)):
        opacity[i] = 1.0 / (1.0 + exact_exp(-np.float64(logits[i])))
        _, turn = quaternion_turn(rot, i)
        row = covariances[i]
        row[:] = 0.0
        for axis in range(3):
            scale = exact_exp(min(max(np.float64(log_scale[axis, i]), -_LARGEST), _LARGEST))
            x, y, z = scale * turn[0][axis], scale * turn[1][axis], scale * turn[2][axis]
            row[0] += x * x
            row[1] += y * y
            row[2] += z * z
            row[3] += x * y
            row[4] += y * z
            row[5] += z * x


def axes_of(
    covariances: NDArray[np.float64],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Log-scales ``(3, N)``, ascending, and quaternions ``(4, N)`` of ``covariances (N, 6)``."""
    log_scale = np.empty((3, len(covariances)), np.float32)
    rot = np.empty((4, len(covariances)), np.float32)
    _fill_axes(covariances, log_scale, rot)
    return log_scale, rot


@kernel
def _fill_axes(covariances, log_scale, rot):
    matrix, turn = np.empty((3, 3)), np.empty((3, 3))
    for i in range(len(covariances)):
        row = covariances[i]
        for axis in range(3):
            after = (axis + 1) % 3
            matrix[axis, axis] = row[axis]
            matrix[axis, after] = matrix[after, axis] = row[3 + axis]
        _diagonalise(matrix, turn)
        first, second, third = 0, 1, 2
        if matrix[second, second] < matrix[first, first]:
            first, second = second, first
        if matrix[third, third] < matrix[second, second]:
            second, third = third, second
        if matrix[second, second] < matrix[first, first]:
            first, second = second, first
        for k, axis in ((0, first), (1, second), (2, third)):
            log_scale[k, i] = 0.5 * exact_log(max(matrix[axis, axis], _TINY))
        _set_quaternion(turn[:, first], turn[:, second], rot[:, i])


@inlined
def _diagonalise(matrix, turn):
    """Diagonalise a symmetric ``matrix (3, 3)`` by Jacobi's method.

    The columns of ``turn (3, 3)`` become its axes.
    """
    turn[:] = 0.0
    for axis in range(3):
        turn[axis, axis] = 1.0
    for _ in range(_SWEEPS):
        done = True
        for p, q in ((0, 1), (1, 2), (2, 0)):
            off = matrix[p, q]
            if abs(off) <= _NOTHING * math.sqrt(abs(matrix[p, p])) * math.sqrt(abs(matrix[q, q])):
                continue
            done = False
            half = 0.5 * (matrix[q, q] - matrix[p, p]) / off
            tangent = 1.0 / (abs(half) + math.sqrt(half * half + 1.0))
            if half < 0.0:
                tangent = -tangent
            cosine = 1.0 / math.sqrt(tangent * tangent + 1.0)
            sine = tangent * cosine
            matrix[p, p] -= tangent * off
            matrix[q, q] += tangent * off
            matrix[p, q] = matrix[q, p] = 0.0
            other = 3 - p - q
            a, b = matrix[other, p], matrix[other, q]
            matrix[other, p] = matrix[p, other] = cosine * a - sine * b
            matrix[other, q] = matrix[q, other] = sine * a + cosine * b
            for axis in range(3):
                a, b = turn[axis, p], turn[axis, q]
                turn[axis, p], turn[axis, q] = cosine * a - sine * b, sine * a + cosine * b
        if done:
            break


@inlined
def _set_quaternion(x, y, quaternion):
    """Fill ``quaternion (4,)``, wxyz, of the rotation whose first two columns are x and y."""
    z = (x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0])
    # Squares of the components, times four; the largest is at least 1.
    w_w, x_x = 1.0 + x[0] + y[1] + z[2], 1.0 + x[0] - y[1] - z[2]
    y_y, z_z = 1.0 - x[0] + y[1] - z[2], 1.0 - x[0] - y[1] + z[2]
    w_x, w_y, w_z = y[2] - z[1], z[0] - x[2], x[1] - y[0]
    x_y, y_z, z_x = x[1] + y[0], y[2] + z[1], z[0] + x[2]
    most = max(w_w, x_x, y_y, z_z)
    if most == w_w:
        found = (w_w, w_x, w_y, w_z)
    elif most == x_x:
        found = (w_x, x_x, x_y, z_x)
    elif most == y_y:
        found = (w_y, x_y, y_y, y_z)
    else:
        found = (w_z, z_x, y_z, z_z)
    a, b, c, d = found
    norm = math.sqrt(a * a + b * b + c * c + d * d)
    for k, value in ((0, a), (1, b), (2, c), (3, d)):
        quaternion[k] = value / norm


def logits(opacity: NDArray[np.float64]) -> NDArray[np.float32]:
    """Logits of opacities below 1."""
    found = np.empty(len(opacity), np.float32)
    _fill_logits(opacity, found)
    return found


@kernel
def _fill_logits(opacity, found):
    for i in range(len(opacity)):
        found[i] = exact_log(max(opacity[i], _TINY) / (1.0 - opacity[i]))

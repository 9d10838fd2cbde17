"""The canonical one of 24 equivalent parameterisations: longest axis first, smallest rotation."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from gs_codec.runtime.kernels import kernel


def _turns() -> NDArray[np.float64]:
    """Quaternions ``(27, 4, 4)`` that move axes a, b, c to first, second, third place, up to signs.

    The first index is ``9 a + 3 b + c``; the four quaternions differ by half turns about the axes.
    """
    turns = np.zeros((27, 4, 4))
    filled = np.zeros(27, int)
    units = [u for u in itertools.product((0.0, 1.0, -1.0), repeat=4) if any(u)]
    scale = {1: 1.0, 2: math.sqrt(0.5), 4: 0.5}
    for unit in units:
        number = sum(value != 0 for value in unit)
        first = next(value for value in unit if value)
        if number not in scale or first < 0:
            continue
        w, x, y, z = (scale[number] * value for value in unit)
        matrix = np.array(
            [
                [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
            ]
        )
        a, b, c = np.argmax(np.abs(matrix), axis=0)
        row = 9 * a + 3 * b + c
        turns[row, filled[row]] = w, x, y, z
        filled[row] += 1
    return turns


_TURNS = _turns()


def rotation_matrix(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrices ``(3, 3, ...)`` of unit quaternions wxyz ``(4, ...)``."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@kernel
def _sort_axes(log_scale, rot, turns, order, scales, vectors):
    for i in range(log_scale.shape[1]):
        a, b, c = 0, 1, 2
        if log_scale[b, i] > log_scale[a, i]:
            a, b = b, a
        if log_scale[c, i] > log_scale[b, i]:
            b, c = c, b
            if log_scale[b, i] > log_scale[a, i]:
                a, b = b, a
        order[0, i], order[1, i], order[2, i] = a, b, c
        for k in range(3):
            scales[k, i] = log_scale[order[k, i], i]
        w, x = np.float64(rot[0, i]), np.float64(rot[1, i])
        y, z = np.float64(rot[2, i]), np.float64(rot[3, i])
        largest = -1.0
        for k in range(4):
            p, q, r, s = turns[9 * a + 3 * b + c, k]
            real = w * p - x * q - y * r - z * s
            if abs(real) <= largest:
                continue
            largest = abs(real)
            sign = -1.0 if real < 0.0 else 1.0
            vectors[0, i] = sign * (w * q + x * p + y * s - z * r)
            vectors[1, i] = sign * (w * r - x * s + y * p + z * q)
            vectors[2, i] = sign * (w * s + x * r - y * q + z * p)
        norm = np.sqrt(w * w + x * x + y * y + z * z)
        for k in range(3):
            vectors[k, i] /= norm


def sort_axes(
    log_scale: NDArray[np.float32], rot: NDArray[np.float32]
) -> tuple[NDArray[np.uint8], NDArray[np.float64], NDArray[np.float64]]:
    """Rewrite Gaussians with their longest axis first and the smallest possible rotation.

    Parameters
    ----------
    log_scale : ndarray, shape (3, N)
    rot : ndarray, shape (4, N)
        Quaternions wxyz of any norm but 0.

    Returns
    -------
    order : ndarray, shape (3, N), uint8
        Indices of the longest, middle and shortest axis; ties go to the lower index.
    log_scale : ndarray, shape (3, N), float64
        Descending.
    vectors : ndarray, shape (3, N), float64
        Vector part of the unit quaternion whose real part is its largest component and >= 0.
    """
    count = log_scale.shape[1]
    order = np.empty((3, count), np.uint8)
    scales, vectors = np.empty((2, 3, count))
    _sort_axes(log_scale, rot, _TURNS, order, scales, vectors)
    return order, scales, vectors


def reordered(rot: NDArray[np.floating], order: NDArray[np.integer]) -> NDArray[np.float64]:
    """Unit quaternions wxyz ``(4, N)`` of Gaussians whose axes are put in an order ``(3, N)``.

    ``rot (4, N)`` may have any norm; a norm of 0 counts as no rotation.
    """
    norm = np.sqrt(np.sum(np.square(rot, dtype=np.float64), axis=0))
    w, x, y, z = rot / np.where(norm > 0, norm, 1.0)
    w = np.where(norm > 0, w, 1.0)
    a, b, c = order.astype(np.int64)
    p, q, r, s = _TURNS[9 * a + 3 * b + c, 0].T
    return np.stack(
        [
            w * p - x * q - y * r - z * s,
            w * q + x * p + y * s - z * r,
            w * r - x * s + y * p + z * q,
            w * s + x * r - y * q + z * p,
        ]
    )


def with_real_part(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit quaternions wxyz ``(4, N)`` with these vector parts ``(3, N)``, and real parts >= 0."""
    real = np.sqrt(np.maximum(1.0 - np.sum(vectors * vectors, axis=0), 0.0))
    return np.concatenate([real[None], vectors])


def nearest_quaternions(
    vectors: NDArray[np.float64], rot: NDArray[np.floating]
) -> NDArray[np.float32]:
    """Apply the half turns that bring each quaternion nearest to ``rot (4, N)``.

    ``vectors (3, N)`` are vector parts from `sort_axes`. The result ``(4, N)`` is wxyz; it
    describes the same Gaussians.
    """
    w, x, y, z = with_real_part(vectors)
    ways = np.array([(w, x, y, z), (-x, w, z, -y), (-y, -z, w, x), (-z, y, -x, w)])
    dots = np.sum(ways * rot, axis=1)
    best = np.argmax(np.abs(dots), axis=0)[None]
    signs = np.where(np.take_along_axis(dots, best, 0) < 0, -1.0, 1.0)
    return (signs * np.take_along_axis(ways, best[None], 0)[0]).astype(np.float32)

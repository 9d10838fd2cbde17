"""Sums of products in a fixed order: results of BLAS and LAPACK vary with machine and threads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.runtime.kernels import kernel

#: Rows count as orthogonal if their cosine is at most this.
_ORTHOGONAL = 1e-15
_SWEEPS = 60


def dot(a: NDArray, b: NDArray) -> float:
    """Sum of the products of ``a (n,)`` and ``b (n,)``, in float64."""
    return float(np.sum(np.multiply(a, b, dtype=np.float64)))


def combine(coefficients: NDArray[np.float64], rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum ``(n,)`` of ``rows (K, n)`` times ``coefficients (K,)``."""
    total = np.zeros(rows.shape[1])
    for coefficient, row in zip(coefficients, rows, strict=True):
        total += coefficient * row
    return total


@kernel
def _turn_apart(rows, turns):
    """Rotate pairs of rows until all are orthogonal (Jacobi); rotate `turns` too."""
    for _ in range(_SWEEPS):
        done = True
        for p in range(len(rows) - 1):
            for q in range(p + 1, len(rows)):
                a = b = c = 0.0
                for i in range(rows.shape[1]):
                    a += rows[p, i] * rows[p, i]
                    b += rows[q, i] * rows[q, i]
                    c += rows[p, i] * rows[q, i]
                if abs(c) <= _ORTHOGONAL * np.sqrt(a * b):
                    continue
                done = False
                ratio = (b - a) / (2.0 * c)
                tangent = 1.0 / (abs(ratio) + np.sqrt(1.0 + ratio * ratio))
                if ratio < 0.0:
                    tangent = -tangent
                cosine = 1.0 / np.sqrt(1.0 + tangent * tangent)
                sine = cosine * tangent
                for part in (rows, turns):
                    for i in range(part.shape[1]):
                        first, second = part[p, i], part[q, i]
                        part[p, i] = cosine * first - sine * second
                        part[q, i] = sine * first + cosine * second
        if done:
            break


def fitting(rows: NDArray[np.float64], least: float = 0.0) -> NDArray[np.float64]:
    """Pseudo-inverse ``(K, n)`` for least-squares fits of values by ``rows (K, n)``.

    The coefficients of the rows are ``[dot(row, values) for row in fitting(rows)]``. If rows are
    linearly dependent, this is the solution of minimum norm; singular values below `least` times
    the largest count as 0.
    """
    turned, turns = np.array(rows, np.float64, order="C"), np.eye(len(rows))
    _turn_apart(turned, turns)
    squares = np.sum(turned * turned, axis=1)
    cut = max(np.finfo(np.float64).eps * max(rows.shape), least)
    kept = squares > squares.max(initial=0.0) * cut * cut
    scaled = turned[kept] / squares[kept, None]
    return np.stack([combine(column, scaled) for column in turns[kept].T])


def main_axis(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Direction ``(K,)`` of the largest sum of squares of points with coordinates ``rows (K, n)``.

    It has unit length; its sign is arbitrary.
    """
    turned, turns = np.array(rows, np.float64, order="C"), np.eye(len(rows))
    _turn_apart(turned, turns)
    return turns[np.argmax(np.sum(turned * turned, axis=1))]

"""Small weighted least squares: their matrix, and its solution."""

from __future__ import annotations

import math

import numpy as np

from gs_codec.kernels import kernel


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
    size = len(right)
    for k in range(size):
        for m in range(k + 1):
            value = matrix[k, m]
            for n in range(m):
                value -= matrix[k, n] * matrix[m, n]
            if m < k:
                matrix[k, m] = value / matrix[m, m]
            elif value > 0.0:
                matrix[k, k] = math.sqrt(value)
            else:
                return False
    finite = True
    for k in range(size):
        for n in range(k):
            right[k] -= matrix[k, n] * right[n]
        right[k] /= matrix[k, k]
    for k in range(size - 1, -1, -1):
        for n in range(k + 1, size):
            right[k] -= matrix[n, k] * right[n]
        right[k] /= matrix[k, k]
        finite = finite and abs(right[k]) < np.inf
    return finite

"""Exponentials, logarithms and sums of products that are bit-identical on every machine.

Results of numpy, BLAS and C libraries depend on the processor and on threads. These functions use
additions, multiplications and divisions, which are rounded alike everywhere, in a fixed order.
Exponentials and logarithms have errors of about 1e-15.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gs_codec.runtime.kernels import inlined, kernel

#: High part of ln 2; whole multiples of it are exact.
_LN2_HIGH = 6.93147180369123816490e-01

#: Low part of ln 2.
_LN2_LOW = 1.90821492927058770002e-10

_INVERSE_LN2 = 1.4426950408889634

#: 2 to the power of 0/16, 1/16, ..., from square roots and products, which are exact to the bit
#: everywhere.
_ROOTS = np.ones(16)
_ROOTS[8] = math.sqrt(2.0)
for _power in (4, 2, 1):
    _ROOTS[_power] = math.sqrt(_ROOTS[2 * _power])
for _power in range(1, 16):
    _ROOTS[_power] = _ROOTS[_power & -_power] * _ROOTS[_power & (_power - 1)]

#: Exponentials of smaller numbers are 0.
_LOWEST = -708.0

#: Exponentials of larger numbers are infinite.
_HIGHEST = 709.0

#: Exponent field of 1.0 in a float64.
_ONE = 1023

#: Bits of the fraction field.
_WIDTH = 52

#: Mask of the fraction field.
_FRACTION = (1 << _WIDTH) - 1

_ROOT_2 = 1.4142135623730951

#: Coefficients of the even terms of the series, the highest power first.
_EVEN = tuple(1 / math.factorial(k) for k in range(6, -1, -2))
_ODD = tuple(1 / math.factorial(k) for k in range(7, 0, -2))
_ARTANH = tuple(2 / k for k in range(21, 0, -2))


@inlined
def exact_exp(x):
    """Exponential of a float64."""
    steps = np.floor(x * (16 * _INVERSE_LN2) + 0.5)
    r = (x - steps * (_LN2_HIGH / 16)) - steps * (_LN2_LOW / 16)
    # |r| is at most 0.022.
    square, even, odd = r * r, 0.0, 0.0
    for k in range(len(_EVEN)):
        even = even * square + _EVEN[k]
        odd = odd * square + _ODD[k]
    whole = np.int64(steps)
    value = (even + r * odd) * _ROOTS[whole & 15]
    if x < _LOWEST:
        return 0.0
    if x > _HIGHEST:
        return np.inf
    return value * np.int64(((whole >> 4) + _ONE) << _WIDTH).view(np.float64)


@inlined
def exact_log(x):
    """Natural logarithm of a float64 that is finite, normal and above 0."""
    bits = np.float64(x).view(np.int64)
    exponent = (bits >> _WIDTH) - _ONE
    m = np.int64((bits & _FRACTION) | (_ONE << _WIDTH)).view(np.float64)
    if m > _ROOT_2:
        m, exponent = 0.5 * m, exponent + 1
    # 2 artanh f; |f| is at most 0.18.
    f = (m - 1.0) / (m + 1.0)
    square, value = f * f, 0.0
    for factor in _ARTANH:
        value = value * square + factor
    return exponent * _LN2_HIGH + (f * value + exponent * _LN2_LOW)


#: Rows count as orthogonal if their cosine is at most this.
_ORTHOGONAL = 1e-15
_SWEEPS = 60


def dot(a: NDArray, b: NDArray) -> float:
    """Sum of the products of ``a (n,)`` and ``b (n,)``, in float64."""
    return float(np.sum(np.multiply(a, b, dtype=np.float64)))


def combine(coefficients: NDArray[np.float64], rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum ``(n,)`` of ``rows (K, n)`` times ``coefficients (K,)``."""
    total = np.zeros(rows.shape[1])
    _combine(np.ascontiguousarray(coefficients), np.ascontiguousarray(rows, np.float64), total)
    return total


@kernel
def _combine(coefficients, rows, total):
    for k in range(len(coefficients)):
        coefficient, row = coefficients[k], rows[k]
        for i in range(len(total)):
            total[i] += coefficient * row[i]


@kernel
def _orthogonalise(rows, turns):
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
    _orthogonalise(turned, turns)
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
    _orthogonalise(turned, turns)
    return turns[np.argmax(np.sum(turned * turned, axis=1))]


def eigenvectors(matrices: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Magnitudes of eigenvalues ``(R, K)`` of symmetric ``matrices (R, K, K)``; their eigenvectors.

    An eigenvector is a row; its sign is arbitrary.
    """
    turned, turns = _with_identities(matrices)
    _orthogonalise_each(turned, turns)
    return np.sqrt(np.sum(turned * turned, axis=2)), turns


def _with_identities(
    matrices: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A copy of ``matrices (R, K, K)``, and as many identity matrices."""
    copied = np.array(matrices, np.float64, order="C")
    return copied, np.tile(np.eye(copied.shape[1]), (len(copied), 1, 1))


@kernel
def _orthogonalise_each(rows, turns):
    for run in range(len(rows)):
        _orthogonalise(rows[run], turns[run])


@kernel
def _eliminate(left, right):
    """Turn ``left (K, K)`` into the identity by Gauss-Jordan, and change `right` likewise.

    Returns whether it has an inverse.
    """
    size = len(left)
    for column in range(size):
        best = column
        for k in range(column + 1, size):
            if abs(left[k, column]) > abs(left[best, column]):
                best = k
        pivot = left[best, column]
        if pivot == 0.0:
            return False
        for part in (left, right):
            for j in range(size):
                taken = part[best, j]
                part[best, j] = part[column, j]
                part[column, j] = taken / pivot
        for k in range(size):
            factor = left[k, column]
            if k != column:
                for j in range(size):
                    left[k, j] -= factor * left[column, j]
                    right[k, j] -= factor * right[column, j]
    return True


def inverses(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Inverses of ``matrices (R, K, K)``; NaN where there is none."""
    left, right = _with_identities(matrices)
    _eliminate_each(left, right)
    return right


@kernel
def _eliminate_each(left, right):
    for run in range(len(left)):
        if not _eliminate(left[run], right[run]):
            right[run] = np.nan

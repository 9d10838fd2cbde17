"""Sums in a fixed order: close to LAPACK and BLAS, and the same on every machine."""

from __future__ import annotations

import numpy as np
import pytest

from gs_codec.coding.exact_math import combine, dot, fitting, main_axis


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("count", [1, 3, 5, 1000])
def test_fits_are_least_squares(seed, count):
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(5, count)) * 10.0 ** rng.uniform(-3, 3, (5, 1)) + rng.normal(
        size=(5, 1)
    )
    values = rng.normal(size=count)
    expected = np.linalg.lstsq(rows.T, values, rcond=None)[0]
    fitted = np.array([dot(row, values) for row in fitting(rows)])
    np.testing.assert_allclose(combine(fitted, rows), combine(expected, rows), atol=1e-8)


@pytest.mark.parametrize("copies", [1, 2, 4])
def test_dependent_rows_share_their_coefficient(copies):
    rng = np.random.default_rng(copies)
    row = rng.normal(size=50)
    fitted = np.array([dot(fit, 3 * row) for fit in fitting(np.stack([row] * copies))])
    np.testing.assert_allclose(fitted, 3 / copies, rtol=1e-12)


def test_zero_rows_have_no_coefficient():
    assert not fitting(np.zeros((3, 7))).any()
    assert fitting(np.ones((2, 0))).shape == (2, 0)


def test_sums_are_those_of_products():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 1000))
    assert dot(a, b) == pytest.approx(float(np.dot(a, b)), rel=1e-12)
    assert dot(np.arange(5), np.arange(5)) == 30.0
    assert dot(np.zeros(0), np.zeros(0)) == 0.0
    rows = rng.normal(size=(4, 1000))
    np.testing.assert_allclose(combine(a[:4], rows), a[:4] @ rows, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_the_main_axis_has_most_of_the_squares(seed):
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(3, 500)) * np.array([[1.0], [3.0], [2.0]])
    expected = np.linalg.eigh(rows @ rows.T)[1][:, 2]
    for order in "CF":
        axis = main_axis(np.array(rows, order=order))
        assert abs(axis @ expected) == pytest.approx(1.0, abs=1e-9)

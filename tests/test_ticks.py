"""Round tick values of scales and axes."""

from __future__ import annotations

import numpy as np
import pytest

from viewer.pictures.ticks import LEAST, MARKS, axis_ticks, scale_marks, texts_of


@pytest.mark.parametrize(
    ("low", "high", "scale", "marks"),
    [
        (1, 222, "log", [1, 4, 16, 64, 256]),
        (1, 4817, "log", [1, 10, 100, 1000, 10_000]),
        (0.00123, 0.21, "log", [0.001, 0.004, 0.016, 0.064, 0.256]),
        (28, 112, "log", [20, 50, 125]),
        (90, 130, "log", [80, 120, 180]),
        (1, 4, "log", [1, 2, 4]),
        (1, 1, "log", [1, 1.5, 2.25]),
        (0, 1, "linear", [0, 0.25, 0.5, 0.75, 1]),
        (12.3, 187, "linear", [0, 50, 100, 150, 200]),
        (0, 0, "linear", [0, 0.1, 0.2, 0.3, 0.4]),
    ],
)
def test_marks_are_round_and_around_the_range(low, high, scale, marks):
    np.testing.assert_allclose(scale_marks(low, high, scale), marks, atol=1e-12)


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_marks_are_evenly_spaced_and_waste_little(scale):
    rng = np.random.default_rng(26)
    for low, high in np.sort(10.0 ** rng.uniform(-6, 6, (300, 2)), axis=1):
        marks = scale_marks(low, high, scale)
        assert LEAST <= len(marks) <= MARKS
        assert marks[0] <= low * (1 + 1e-6)
        assert marks[-1] * (1 + 1e-6) >= high
        steps = np.diff(marks if scale == "linear" else np.log(marks))
        np.testing.assert_allclose(steps, steps[0], rtol=1e-6)
        if scale == "linear":
            assert len(marks) == MARKS
            assert marks[-1] - marks[0] < 3 * (high - low)
        else:
            assert marks[-1] / marks[0] < 3 * max(high / low, (high / low) ** 1.5)


@pytest.mark.parametrize("most", [4, 5, 6, 9, 17, 100, 500, 3000])
def test_marks_of_counts_are_whole_and_begin_at_1(most):
    marks = scale_marks(1, most, "log")
    assert marks[0] == 1
    assert (marks == np.round(marks)).all()


@pytest.mark.parametrize(
    ("low", "high", "log", "ticks"),
    [
        (0, 1, False, [0, 0.2, 0.4, 0.6, 0.8, 1]),
        (-3.4, 7.7, False, [-2, 0, 2, 4, 6]),
        (-4, 0.3, True, [1e-4, 1e-3, 1e-2, 0.1, 1]),
        (-1.9, -0.5, True, [0.02, 0.05, 0.1, 0.2]),
        (-2, -1.8, True, [0.01, 0.011, 0.012, 0.013, 0.014, 0.015]),
    ],
)
def test_ticks_of_axes_are_round_and_in_range(low, high, log, ticks):
    found = axis_ticks(low, high, 8, log)
    np.testing.assert_allclose(10**found if log else found, ticks, atol=1e-12)


@pytest.mark.parametrize(
    ("values", "step", "texts"),
    [
        ([500000, 500002, 500004], 2, ["500000", "500002", "500004"]),
        ([-4000000, -3999999.5], 0.5, ["-4000000", "-3999999.5"]),
        ([12345, 12350], 5, ["12345", "12350"]),
        ([0, 0.002, 0.004], 0.002, ["0", "0.002", "0.004"]),
        ([1e6, 2e6], 1e6, ["1e+06", "2e+06"]),
        ([123456, np.inf], 50, ["123456", "inf"]),
        ([0.0123456, 20], np.inf, ["0.0123", "20"]),
    ],
)
def test_values_have_the_digits_that_tell_them_apart(values, step, texts):
    assert texts_of(values, step) == texts

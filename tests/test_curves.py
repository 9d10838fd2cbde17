"""Rate-quality curves: interpolation, ends, BD-rate of curves of known shape."""

from __future__ import annotations

import numpy as np
import pytest

from gs_codec.bench.suite.results import Curve, Rate, bd_rate, curve_of


def _line(psnrs, factor=1.0) -> Curve:
    """One bit per 6 dB, times a factor."""
    return Curve((psnr, factor * 2 ** (psnr / 6)) for psnr in psnrs)


@pytest.mark.parametrize("factor", [0.5, 1.0, 1.7])
@pytest.mark.parametrize("psnrs", [(40, 46, 52), (52, 40, 46), (41, 51), (35, 43.5, 44, 60)])
def test_curves_with_a_constant_ratio_have_that_rate(psnrs, factor):
    reference, tested = _line((38, 45, 47, 55)), _line(psnrs, factor)
    low, high = max(38, min(psnrs)), min(55, max(psnrs))
    for psnr in np.linspace(low, high, 7):
        assert reference.bits_at(psnr) == pytest.approx(2 ** (psnr / 6))
        assert tested.bits_at(psnr) == pytest.approx(factor * reference.bits_at(psnr))
    assert bd_rate(reference, tested) == Rate(
        pytest.approx(100 * (factor - 1), abs=1e-9), low, high
    )
    there_and_back = bd_rate(tested, reference)
    assert there_and_back.percent == pytest.approx(100 * (1 / factor - 1), abs=1e-9)


def test_a_curve_interpolates_its_points_only():
    points = [(40.0, 60.0), (44.0, 75.0), (45.0, 160.0), (52.0, 170.0)]
    curve = Curve(points)
    for psnr, bits in points:
        assert curve.bits_at(psnr) == pytest.approx(bits)
    between = [curve.bits_at(psnr) for psnr in np.linspace(40, 52, 50)]
    assert np.all(np.diff(between) >= 0)
    assert curve.bits_at(39.99) is None
    assert curve.bits_at(52.01) is None


@pytest.mark.parametrize("psnrs", [(30, 35), (30,), (), (56, 60), (30, 38)])
def test_curves_that_do_not_overlap_have_no_rate(psnrs):
    assert bd_rate(_line((38, 45, 55)), _line(psnrs)) is None


def test_of_points_of_one_quality_the_smallest_counts():
    curve = Curve([(40, 90), (40, 80), (50, 100)])
    assert curve.bits_at(40) == pytest.approx(80)
    assert Curve([(40, 80)]).bits_at(40) == pytest.approx(80)


def test_equal_views_are_no_points():
    lines = [{"bits_per_gaussian": 90.0, "mean": {"psnr": psnr}} for psnr in (None, 40.0)]
    assert curve_of(lines).range == (40.0, 40.0)

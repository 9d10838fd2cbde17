"""Quantisers: errors within half a step, exact extremes, no arithmetic traps."""

from __future__ import annotations

import numpy as np
import pytest

from gs_codec.coding.quantise import (
    LAPLACE_SCALES_PER_BIT,
    CentredQuantiser,
    ConstantQuantiser,
    RangeQuantiser,
    dequantise,
    fit_centred,
    fit_range,
    quantise,
    quantise_positions,
)

BIGGEST = float(np.finfo(np.float32).max)


def as_given(values):
    return np.arange(values.size)


@pytest.mark.parametrize("depth", [1, 2, 4, 8, 12])
@pytest.mark.parametrize("scale", [1e-38, 1e-3, 1.0, 1e30])
def test_range_quantiser_is_within_half_a_step(scale, depth):
    rng = np.random.default_rng([depth])
    values = (rng.normal(size=1000) * scale).astype(np.float32)
    quantiser = fit_range(values, depth)
    symbols, histogram, clamped = quantise(values, quantiser, as_given(values))
    assert clamped == 0
    np.testing.assert_array_equal(histogram, np.bincount(symbols, minlength=1 << depth))
    decoded = dequantise(symbols, quantiser)
    error = np.abs(decoded.astype(np.float64) - values)
    assert error.max() <= 0.5 * quantiser.step * (1 + 1e-9) + np.spacing(np.abs(values).max())
    assert decoded.min() == values.min()
    assert decoded.max() == values.max()


@pytest.mark.parametrize("depth", [1, 17, 21])
def test_positions_use_every_level_up_to_the_last(depth):
    values = np.array([-1.0, 0.25, 3.0], np.float32)
    quantiser = fit_range(values, depth)
    cells = quantise_positions(np.stack([values] * 3), [quantiser] * 3)
    assert cells[0, 0] == 0
    assert cells[0, 2] == (1 << depth) - 1
    np.testing.assert_allclose(dequantise(cells[0], quantiser), values, atol=quantiser.step / 2)


@pytest.mark.parametrize(
    ("low", "high"), [(-BIGGEST, BIGGEST), (0.0, 1e-45), (1e7, np.nextafter(np.float32(1e7), 2e7))]
)
def test_range_quantiser_handles_the_limits_of_float32(low, high):
    values = np.array([low, high, low], np.float32)
    quantiser = fit_range(values, 8)
    symbols, _, _ = quantise(values, quantiser, as_given(values))
    assert symbols.tolist() == [0, 255, 0]
    np.testing.assert_array_equal(dequantise(symbols, quantiser), values)


@pytest.mark.parametrize("values", [[], [3.5], [2.0] * 9, [0.0, -0.0]])
def test_constant_channels_have_no_symbols(values):
    values = np.array(values, np.float32)
    for quantiser in (fit_range(values, 8), fit_centred(values, 8)[0]):
        assert isinstance(quantiser, ConstantQuantiser)
        symbols, histogram, _ = quantise(values, quantiser, as_given(values))
        assert histogram.tolist() == [values.size]
        np.testing.assert_array_equal(dequantise(symbols, quantiser), values)


@pytest.mark.parametrize("depth", [1, 2, 3, 4, 5, 8])
def test_centred_quantiser_rectifies_and_stays_within_half_a_step(depth):
    # Heavier tails than a Laplace distribution, so that every depth clips some values.
    tails = np.random.default_rng([50, depth]).standard_t(1.5, 4001)
    values = (0.1 + 0.05 * tails).astype(np.float32)
    quantiser, scale = fit_centred(values, depth)
    assert isinstance(quantiser, CentredQuantiser)
    assert quantiser.centre == np.median(values)
    deviations = np.abs(values.astype(np.float64) - quantiser.centre)
    reach = LAPLACE_SCALES_PER_BIT * depth * deviations.sum() / np.count_nonzero(deviations)
    assert quantiser.half_range == pytest.approx(min(reach, deviations.max()), rel=1e-6)
    assert scale * quantiser.step == pytest.approx(deviations.mean())
    symbols, _, clamped = quantise(values, quantiser, as_given(values))
    decoded = dequantise(symbols, quantiser).astype(np.float64)
    inside = deviations <= quantiser.half_range
    assert np.abs(decoded - values)[inside].max() <= 0.5 * quantiser.step + 1e-6
    assert 0 < clamped <= np.count_nonzero(~inside)
    assert np.count_nonzero(symbols == (1 << depth) - 1) > 0


def test_the_median_decodes_exactly():
    values = np.array([-3, -1, 0, 0, 0, 0.5, 9], np.float32)
    quantiser, _ = fit_centred(values, 3)
    symbols, _, _ = quantise(values, quantiser, as_given(values))
    assert symbols[2:5].tolist() == [4, 4, 4]
    assert dequantise(symbols, quantiser)[2] == 0.0


def test_many_zeros_do_not_narrow_the_range():
    rng = np.random.default_rng(51)
    dense = rng.laplace(0, 0.1, 1000).astype(np.float32)
    sparse = np.concatenate([dense, np.zeros(50_000, np.float32)])
    narrow, wide = fit_centred(dense, 4)[0], fit_centred(sparse, 4)[0]
    assert wide.half_range == pytest.approx(narrow.half_range, rel=0.02)


@pytest.mark.parametrize("outlier", [1e30, -BIGGEST])
def test_centred_levels_stay_finite(outlier):
    values = np.array([0, 0, outlier], np.float32)
    for depth in (1, 4, 12):
        quantiser, _ = fit_centred(values, depth)
        levels = dequantise(np.arange(1 << depth), quantiser)
        assert np.isfinite(levels).all()
        assert np.all(np.diff(levels) >= 0)


def test_ties_go_up():
    quantiser = RangeQuantiser(2, 0.0, 3.0)
    values = np.array([0.5, 1.5, 2.5], np.float32)
    assert quantise(values, quantiser, as_given(values))[0].tolist() == [1, 2, 3]


def test_order_is_applied():
    values = np.array([0, 10, 20, 30], np.float32)
    symbols, _, _ = quantise(values, fit_range(values, 2), np.array([2, 0, 3, 1]))
    assert symbols.tolist() == [2, 0, 3, 1]

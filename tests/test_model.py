"""Models: exact integer tables, good fits, the cheapest selected."""

from __future__ import annotations

from math import erf, exp, sqrt
from typing import get_args

import numpy as np
import pytest

from gs_codec.codecs.entropygs.models import (
    Component,
    LaplaceModel,
    MixtureModel,
    choose_model,
    fit_mixture,
    normal_table,
)
from gs_codec.coding.frequency_table import SentModel, normalise, shannon_bits
from gs_codec.config import Models


def histogram_of(values, alphabet):
    return np.bincount(np.clip(np.rint(values), 0, alphabet - 1).astype(int), minlength=alphabet)


@pytest.mark.parametrize("precision", [8, 12, 15])
@pytest.mark.parametrize("seed", range(5))
def test_normalise_sums_and_keeps_occurring_symbols(seed, precision):
    rng = np.random.default_rng(seed)
    weights = np.floor(10 ** rng.uniform(-1, 12, 200)).astype(np.int64)
    table = normalise(weights, precision)
    assert table.frequencies.sum() == 1 << precision
    np.testing.assert_array_equal(table.frequencies > 0, weights > 0)


def test_normalise_by_hand():
    # Shares 2.56, 2.56, 250.88 of 256: two are missing, one goes to the last, one to the first.
    assert normalise(np.array([1, 1, 98], np.int64), 8).frequencies.tolist() == [3, 2, 251]
    # The three minimum frequencies of 1 exceed the sum by two, which the largest gives up.
    tight = normalise(np.array([1, 1, 1, 10**9], np.int64), 8)
    assert tight.frequencies.tolist() == [1, 1, 1, 253]


@pytest.mark.parametrize("seed", range(20))
def test_normalise_removes_a_surplus_one_by_one(seed):
    """The rule of FORMAT.md, written literally."""
    rng = np.random.default_rng(seed)
    weights = rng.integers(0, rng.choice([2, 4, 1 << 20], 256), 256)
    weights[rng.integers(0, 256, 3)] = rng.integers(1, 1 << 32, 3)
    expected = np.where(weights > 0, np.maximum((weights << 9) // weights.sum(), 1), 0)
    if expected.sum() < 512:
        pytest.fail("nothing is too much: choose another seed")
    while expected.sum() > 512:
        expected[np.argmax(expected)] -= 1
    assert normalise(weights, 9).frequencies.tolist() == expected.tolist()


def test_normalise_fills_every_slot():
    weights = np.ones(256, np.int64)
    weights[7] = 1 << 40
    assert normalise(weights, 8).frequencies.tolist() == [1] * 256


def test_normal_table_is_the_normal_distribution():
    expected = [0.5 * (1 + erf(i / 64 / sqrt(2))) for i in range(513)]
    np.testing.assert_allclose(normal_table() / 2**30, expected, atol=6e-6)


@pytest.mark.parametrize("scale", [0.05, 0.4, 1.0, 3.0, 40.0])
@pytest.mark.parametrize("alphabet", [2, 4, 16, 256])
def test_laplace_table_is_the_laplace_distribution(alphabet, scale):
    table = LaplaceModel.fit(scale, 15).frequencies(alphabet)
    edges = np.arange(1, alphabet) - alphabet // 2 - 0.5
    below = [0.5 * exp(x / scale) if x < 0 else 1 - 0.5 * exp(-x / scale) for x in edges]
    expected = np.diff([0, *below, 1])
    floor = alphabet / 32768  # each symbol has a frequency of at least 1
    np.testing.assert_allclose(table.frequencies / 32768, expected, atol=3e-4 + floor)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_mixture_recovers_its_parameters(count):
    rng = np.random.default_rng([30, count])
    means, sigmas = np.array([40.0, 120.0, 190.0, 230.0])[:count], np.array([9, 14, 6, 3.0])[:count]
    which = rng.integers(0, count, 200_000)
    histogram = histogram_of(rng.normal(means[which], sigmas[which]), 256)
    found = fit_mixture(histogram, count, 15).describe()
    order = np.argsort(found["means"])
    np.testing.assert_allclose(np.array(found["means"])[order], means, atol=0.5)
    np.testing.assert_allclose(np.array(found["sigmas"])[order], sigmas, rtol=0.05)
    np.testing.assert_allclose(found["weights"], 1 / count, atol=0.01)


def mixture_by_hand(histogram, count) -> np.ndarray:
    """Weights, means and sigmas by textbook expectation maximisation."""
    symbols, total = np.flatnonzero(histogram), histogram.sum()
    counts = histogram[symbols]
    spread = sqrt(np.average(symbols**2, weights=counts) - np.average(symbols, weights=counts) ** 2)
    shares = (2 * np.arange(count)[:, None] + 1) / (2 * count)
    means = symbols[np.argmax(np.cumsum(counts) >= shares * total, axis=1)][:, None]
    weights, sigmas = np.full((count, 1), 1 / count), np.full((count, 1), max(spread / count, 0.25))
    before = -np.inf
    for _ in range(200):
        density = weights / sigmas * np.exp(-(((symbols - means) / sigmas) ** 2) / 2)
        likelihood = np.sum(counts * np.log(density.sum(axis=0)))
        shares = counts * density / density.sum(axis=0)
        mass = shares.sum(axis=1, keepdims=True)
        weights, means = mass / total, (shares @ symbols)[:, None] / mass
        variances = np.sum(shares * (symbols - means) ** 2, axis=1, keepdims=True) / mass
        sigmas = np.sqrt(np.maximum(variances, 1 / 16))
        if likelihood - before < 1e-8 * total:
            break
        before = likelihood
    return np.hstack([weights, means, sigmas]).T


@pytest.mark.parametrize("count", [1, 2, 3, 4])
@pytest.mark.parametrize("sigma", [0.1, 3.0, 8.0, 20.0])
def test_mixture_is_that_of_expectation_maximisation(sigma, count):
    rng = np.random.default_rng([33, count])
    values = rng.normal(rng.choice([12, 18, 40], 2000), sigma)
    found = fit_mixture(histogram_of(values, 64), count, 15).describe()
    expected = mixture_by_hand(histogram_of(values, 64), count)
    np.testing.assert_allclose(list(found.values()), expected, atol=5e-5)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
@pytest.mark.parametrize(
    "histogram",
    [
        [0, 0, 5, 0],
        [1, 0, 0, 1],
        [10**9, 0, 0, 0, 0, 0, 0, 1],
        [1] * 256,
        [0] * 255 + [1],
        [0, 1] * 128,
    ],
    ids=["one symbol", "two", "outlier", "uniform", "last", "comb"],
)
def test_mixture_is_finite_on_degenerate_histograms(histogram, count):
    histogram = np.array(histogram, np.int64)
    model = fit_mixture(histogram, count, 15)
    for component in model.components:
        assert 1 <= component.weight <= 65535
        assert component.sigma >= 1
        assert 0 <= component.mean < histogram.size << 16
    assert np.isfinite(model.frequencies(histogram.size).code_length(histogram))


@pytest.mark.parametrize("sigma", [1, 1 << 16, (1 << 32) - 1])
@pytest.mark.parametrize("mean", [0, 1 << 23, (1 << 32) - 1])
def test_mixture_table_handles_extreme_parameters(mean, sigma):
    model = MixtureModel((Component(65535, mean, sigma),) * 4, 12)
    table = model.frequencies(4096)
    assert table.frequencies.tolist() == [1] * 4096


def test_sent_table_of_full_mantissa_is_the_histogram():
    rng = np.random.default_rng(31)
    histogram = rng.integers(0, 1000, 64)
    np.testing.assert_array_equal(SentModel.fit(histogram, 15, 15).weights, histogram)


@pytest.mark.parametrize("mantissa", [0, 1, 3])
def test_sent_table_rounds_to_its_mantissa(mantissa):
    histogram = np.array([0, 1, 2, 3, 5, 100, 1023, 2**31 + 1, 2**40])
    weights = SentModel.fit(histogram, mantissa, 15).weights
    assert [int(w).bit_length() <= 32 for w in weights] == [True] * 9
    significant = [len(f"{int(w):b}".rstrip("0")) for w in weights if w]
    assert max(significant) <= mantissa + 1
    np.testing.assert_array_equal(weights > 0, histogram > 0)


def test_few_symbols_are_coded_by_parameters_and_many_by_a_table():
    rng = np.random.default_rng(32)
    values = rng.normal(128, 30, 1_000_000)
    values -= np.where(np.rint(values) % 3 == 0, rng.random(1_000_000) > 0.9, 0)

    def kind(count):
        histogram = histogram_of(values[:count], 256)
        return choose_model(histogram, None, "best").model.kind

    assert kind(500) == "mixture"
    assert kind(1_000_000) == "table"


def test_choice_is_the_cheapest_and_its_bits_are_real():
    rng = np.random.default_rng(33)
    histogram = histogram_of(rng.laplace(8, 1.2, 10_000), 16)
    choice = choose_model(histogram, 1.2, "best")
    assert choice.model.kind == "laplace"
    frequencies = choice.table.frequencies / choice.table.frequencies.sum()
    occurring = histogram > 0
    bits = -(histogram[occurring] * np.log2(frequencies[occurring])).sum()
    assert choice.bits == pytest.approx(bits)
    assert choice.shannon_bits == pytest.approx(shannon_bits(histogram))
    assert choice.shannon_bits <= choice.bits <= 1.01 * choice.shannon_bits


@pytest.mark.parametrize("scale", [None, 1.2])
def test_only_allowed_models_are_chosen(scale):
    """Whatever is cheaper: here a table, for a comb that neither distribution fits."""
    histogram = np.zeros(64, np.int64)
    histogram[::7] = 100_000
    chosen = {models: choose_model(histogram, scale, models) for models in get_args(Models)}
    published = "mixture" if scale is None else "laplace"
    kinds = {models: choice.model.kind for models, choice in chosen.items()}
    assert kinds == {"parametric": published, "table": "table", "best": "table"}
    assert chosen["parametric"].bits > 1.01 * chosen["table"].bits
    assert chosen["best"].parametric_bits == chosen["parametric"].parametric_bits
    assert chosen["table"].parametric_bits == chosen["table"].bits

"""Extreme values: errors stay within the bounds of a profile's steps."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from bounds import error_over_bound
from scenes import encode_by, made_up_guide, random_scene
from stress import stress_scenes

from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.codecs.entropygs.models import MAX_COMPONENTS, LaplaceModel, choose_model, fit_mixture
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.coding.frequency_table import MAX_PRECISION, SentModel
from gs_codec.config import ADAPTIVE_PROFILES, PROFILE_CHOICES, Config, Models
from gs_codec.encoding.order import encode
from gs_codec.encoding.request import Request
from gs_codec.scene import GROUPS

#: Gaussians of a case, and copies of one: by default, and with --rounds 2 or more.
COUNT, COPIES = 300, 3000
LARGE = (2000, 1_000_000)
CASES = dict(stress_scenes(COUNT, COPIES))


@pytest.mark.one_in(4)
@pytest.mark.parametrize("profile", PROFILE_CHOICES)
def test_errors_are_within_bounds(profile, pytestconfig):
    size = LARGE if pytestconfig.getoption("rounds") > 1 else (COUNT, COPIES)
    config = Config(profile, threads=1)
    for name, scene in stress_scenes(*size):
        data, _ = encode_scene(scene, config)
        assert error_over_bound(scene, decode_scene(data), data, config)[0] <= 1.0, name


def test_the_measure_detects_errors():
    """A scene that is not the encoded one exceeds the bounds in each profile."""
    scene = random_scene(200, 1, seed=80)
    for profile in PROFILE_CHOICES:
        config = Config(profile)
        data, _ = encode_scene(scene, config)
        decoded = decode_scene(data)
        assert error_over_bound(scene, decoded, data, config)[0] <= 1.0
        for group in GROUPS:
            planes = getattr(decoded, group).copy()
            planes[-1, 7] += 1.0
            wrong = replace(decoded, **{group: planes})
            assert error_over_bound(scene, wrong, data, config)[0] > 1.0, (profile, group)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("case", CASES)
def test_reports_contain_only_numbers(case):
    """JSON has neither NaN nor infinity."""
    for profile in ("m", "paper-m"):
        data, report = encode_scene(CASES[case], Config(profile))
        json.dumps(inspect_bytes(data).as_dict(), allow_nan=False)
        assert all(math.isfinite(cost.coded_bits) for cost in report.costs)
        assert math.isfinite(report.entropy_overhead)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("profile", ADAPTIVE_PROFILES)
def test_log_scales_may_have_the_maximum_difference(profile, seed):
    """Each is at most 400, so their difference is up to 800."""
    rng = np.random.default_rng(seed)
    scene = random_scene(500, 0, seed=seed)
    scene.log_scale[:] = rng.choice([-1e30, -400, -399.5, -1, 0, 1, 399.5, 400, 1e30], (3, 500))
    config = Config(profile)
    data, _ = encode_scene(scene, config)
    decoded = decode_scene(data)
    assert error_over_bound(scene, decoded, data, config)[0] <= 1.0
    assert np.abs(decoded.log_scale).max() < 402


@pytest.mark.parametrize("log_scale", [-1e30, 710, 1e30])
@pytest.mark.parametrize("count", [1, 50])
def test_scenes_of_gaussians_of_any_size_are_encoded(count, log_scale):
    scene = random_scene(count, 1, seed=83)
    scene.log_scale[:] = log_scale
    parts, _ = encode(scene, Request(Config("paper-m")))
    assert decode_scene(b"".join(parts)).count == count


@pytest.mark.parametrize("depths", [{"sh1": 1}, {"sh-dc": 1, "sh1": 12}, {"rotation": 8}])
@pytest.mark.parametrize("case", ["an outlier in each channel", "quaternions of norm 1e-20"])
def test_depths_of_extreme_channels_give_valid_files(case, depths):
    config = Config("m", depths=depths)
    data, _ = encode_scene(CASES[case], config)
    decoded = decode_scene(data)
    assert error_over_bound(CASES[case], decoded, data, config)[0] <= 1.0


@pytest.mark.one_in(3)
@pytest.mark.parametrize("case", CASES)
def test_views_of_extreme_scenes_give_valid_files(case):
    data = encode_by(CASES[case], Config("m"), made_up_guide(seed=81))
    decoded = decode_scene(data)
    assert decoded.count == CASES[case].count
    assert all(np.isfinite(getattr(decoded, group)).all() for group in GROUPS)


def histograms() -> dict[str, np.ndarray]:
    """Distributions of symbols, in alphabets of all sizes."""
    rng = np.random.default_rng(82)
    found = {}
    for alphabet in (2, 4, 256, 4096):
        symbols = np.arange(alphabet)
        one, ends, gap = np.zeros((3, alphabet), np.int64)
        one[alphabet // 3] = 10**7
        ends[[0, -1]] = 1, 10**9
        gap[[0, alphabet // 2, -1]] = 10**6, 1, 10**6
        found |= {
            f"one of {alphabet}": one,
            f"the ends of {alphabet}": ends,
            f"a gap in {alphabet}": gap,
            f"all of {alphabet} once": np.ones(alphabet, np.int64),
            f"tails in {alphabet}": (1e9 / (1.0 + symbols) ** 3).astype(np.int64) + symbols % 2,
            f"peaks in {alphabet}": 10 ** rng.integers(0, 9, alphabet),
            f"sparse {alphabet}": rng.integers(0, 2, alphabet) * rng.integers(0, 2, alphabet),
        }
        found[f"sparse {alphabet}"][-1] = 1
    return found


@pytest.mark.parametrize("name", histograms())
def test_mixtures_have_mass_and_no_nan(name):
    histogram = histograms()[name]
    for count in range(1, MAX_COMPONENTS + 1):
        for component in fit_mixture(histogram, count, MAX_PRECISION).components:
            assert 1 <= component.weight <= 65535
            assert 0 <= component.mean <= (histogram.size - 1) << 16
            assert 1 <= component.sigma <= histogram.size << 16


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", histograms())
def test_tables_cover_all_occurring_symbols(name):
    histogram = histograms()[name]
    for precision in (p for p in (12, 14, 15) if 1 << p >= 2 * histogram.size):
        models = [fit_mixture(histogram, k + 1, precision) for k in range(MAX_COMPONENTS)]
        models += [LaplaceModel.fit(scale, precision) for scale in (1e-9, 0.3, 50.0, 1e9)]
        models += [SentModel.fit(histogram, mantissa, precision) for mantissa in (2, 6)]
        for model in models:
            table = model.frequencies(histogram.size)
            assert table.frequencies.sum() == 1 << precision
            assert np.all(table.frequencies[histogram > 0] > 0)
            assert math.isfinite(table.code_length(histogram))
    for scale in (None, 0.0, 2.0):
        for models in get_args(Models):
            assert math.isfinite(choose_model(histogram, scale, models).bits)

"""How well views predict what other views see."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import random_scene

from gs_codec.cameras.camera import Camera
from gs_codec.codecs.adaptive.step_sizes import Sensitivity, expected_sensitivity
from gs_codec.coding.axes import sort_axes
from gs_codec.guidance.cross_validation import blend, blind_share, regions

COUNT, VIEWS = 2000, 32


@pytest.fixture(scope="module")
def scene():
    return random_scene(COUNT, 0, seed=171)


def around(views: int) -> list[Camera]:
    angles = 2 * np.pi * np.arange(views) / views
    sides = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    return [Camera(f"{i}", 9, 9, 9, 9, 4, 4, np.eye(3), 5 * side) for i, side in enumerate(sides)]


def test_views_that_agree_are_trusted(scene):
    rng = np.random.default_rng(1)
    level = np.exp(rng.normal(0, 3, COUNT))
    weights = np.tile(level, (VIEWS, 1)).astype(np.float32)
    assert blind_share(scene, weights, around(VIEWS)) == 0.003


def test_views_are_trusted_less_if_regions_predict_each_other_less(scene):
    """A Gaussian is visible from one side; all other views of it are random."""
    expected = expected_of(scene).colour
    shares = []
    for width in (VIEWS, VIEWS // 4, 2):
        seen = np.zeros((VIEWS, COUNT), np.float32)
        first = np.random.default_rng(2).integers(VIEWS, size=COUNT)
        for k in range(width):
            seen[(first + k) % VIEWS, np.arange(COUNT)] = expected
        shares.append(blind_share(scene, seen, around(VIEWS)))
    assert shares == sorted(shares)
    assert shares[0] < 0.5 < shares[2]


def test_a_single_view_is_not_trusted(scene):
    weights = np.ones((1, COUNT), np.float32)
    assert blind_share(scene, weights, around(1)) == 0.95


def test_a_blend_keeps_the_measured_level(scene):
    rng = np.random.default_rng(4)
    expected = expected_of(scene)
    found = Sensitivity(*(np.exp(rng.normal(0, 1, np.shape(e))) * e for e in expected))
    for share in (0.05, 0.5):
        for mixed, s, e in zip(blend(found, expected, share), found, expected, strict=True):
            np.testing.assert_allclose((mixed / e).mean(axis=-1), (s / e).mean(axis=-1))
            assert np.std(np.log(mixed / e)) < np.std(np.log(s / e))


def expected_of(scene) -> Sensitivity:
    return expected_sensitivity(scene.opacity[0], sort_axes(scene.log_scale, scene.rot)[1])


def test_regions_are_arcs_of_an_orbit():
    found = regions(around(VIEWS), 2)
    assert sorted(np.concatenate(found)) == list(range(VIEWS))
    for region in found:
        assert len(region) == VIEWS // 4
        gaps = np.diff(np.sort(region), append=np.sort(region)[0] + VIEWS)
        assert sorted(gaps)[:-1] == [1] * (len(region) - 1)
    assert regions(around(1), 2) == []


def test_estimated_views_are_not_trusted_fully(scene):
    rng = np.random.default_rng(5)
    weights = np.tile(np.exp(rng.normal(0, 3, COUNT)), (VIEWS, 1)).astype(np.float32)
    assert blind_share(scene, weights, around(VIEWS), estimated=True) == 0.15

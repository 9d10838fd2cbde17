"""Views from directions in which a scene has SH-AC, in addition to estimated cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference_renderer import sh_basis
from scenes import random_scene, with_threads

from gs_codec.cameras.camera import Camera, facing
from gs_codec.preparation.compact_sh import compact_sh
from gs_codec.preparation.likely_views import likely_views

#: Positions of the training cameras; only the first is found by estimation.
SEEN, MISSED = np.array([8.0, 0, 0]), np.array([0, 8.0, 0])


@pytest.fixture(scope="module")
def scene():
    """Gaussians near the origin with SH-AC only towards the two positions."""
    rng = np.random.default_rng(81)
    positions = rng.normal(0, 0.3, (3, 2000))
    f_rest = np.zeros((3, 15, 2000))
    for place in (SEEN, MISSED):
        towards = positions - place[:, None]
        towards /= np.linalg.norm(towards, axis=0)
        basis = np.array([sh_basis(direction)[1:] for direction in towards.T])
        f_rest += rng.normal(0.0, 0.1, (3, 1, 2000)) * basis.T
    return replace(
        random_scene(2000, 3, seed=82),
        positions=positions.astype(np.float32),
        f_rest=f_rest.reshape(45, 2000).astype(np.float32),
    )


def colours(scene, place):
    """SH colours ``(3, N)`` seen from a position."""
    towards = scene.positions - place[:, None]
    towards /= np.linalg.norm(towards, axis=0)
    basis = np.array([sh_basis(direction)[1:] for direction in towards.T])
    rest = scene.f_rest.reshape(3, 15, -1)
    return 0.28209479177387814 * scene.f_dc + np.einsum("ckn,nk->cn", rest, basis)


def weights_of(scene):
    return np.full((1, scene.count), 2.0, np.float32)


def test_likely_views_follow_the_strength_of_sh_ac(scene):
    views = likely_views(scene, weights_of(scene))
    total = views.weights.sum(axis=1)
    aside = views.centres / np.linalg.norm(views.centres, axis=1)[:, None]
    cosines = np.abs(aside[:, :2]).max(axis=1)  # SH have about the same strength from behind
    assert total[cosines > 0.9].mean() > 4 * total[cosines < 0.6].mean()


def test_likely_views_have_a_share_of_the_total_weight(scene):
    weights = weights_of(scene)
    weights[:, :7] = 0
    views = likely_views(scene, weights)
    np.testing.assert_allclose(views.weights[:, 7:].sum(axis=0), 8.0, rtol=1e-4)
    # Gaussians not visible to estimated cameras may be visible to others.
    assert (views.weights[:, :7].sum(axis=0) > 0).all()


def test_compaction_keeps_colours_missed_by_cameras(scene):
    rotation = facing(-SEEN, np.array([0, 0, 1.0]))
    camera = Camera("seen", 60, 40, 60.0, 60.0, 30.0, 20.0, rotation, SEEN)
    weights = weights_of(scene)
    errors = []
    for likely in (None, likely_views(scene, weights)):
        compact, report = compact_sh(scene, [camera], 3e-2, weights=weights, likely=likely)
        assert report["zeros_after"] > report["zeros_before"]
        lost = colours(compact, MISSED) - colours(scene, MISSED)
        errors.append(float(np.mean(lost**2)))
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.parametrize("count", [1, 511, 513])
def test_scenes_at_the_limits(count):
    scene = random_scene(count, 1, seed=83)
    dark = replace(scene, f_rest=np.zeros_like(scene.f_rest))
    for each in (scene, dark):
        views = likely_views(each, np.zeros((2, count), np.float32))
        assert views.weights.shape == (32, count)
        assert np.isfinite(views.weights).all()
        assert np.isfinite(views.centres).all()


def test_threads_do_not_matter(scene):
    found = [with_threads(n, likely_views, scene, weights_of(scene)).weights for n in (1, 3)]
    np.testing.assert_array_equal(*found)

"""Rounding of SH-AC based on views."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import random_scene

from gs_codec.cameras.camera import Camera
from gs_codec.coding.ycocg import to_ycocg
from gs_codec.formats.attribute_steps import ShGrid
from gs_codec.guidance.round_sh import round_rgb, round_sh
from gs_codec.preparation.sh_weights import coefficients_of, sh_row, with_coefficients
from gs_codec.scene import Scene

ERROR = 1e-9


def cameras(count: int, spread: float, seed: int = 0) -> list[Camera]:
    """Distant cameras within a cone; a spread of 3 covers all directions."""
    rng = np.random.default_rng(seed)
    aside = spread * rng.normal(size=(count, 3)) + [0, 0, 1]
    places = 50 * aside / np.linalg.norm(aside, axis=1)[:, None]
    return [Camera(f"{i}", 8, 8, 9, 9, 4, 4, np.eye(3), p) for i, p in enumerate(places)]


def colours(scene: Scene, seen: list[Camera]) -> np.ndarray:
    """Y, Co, Cg ``(views, 3, N)`` in the directions of cameras."""
    sh = coefficients_of(scene).astype(np.float64)
    found, row = np.empty((len(seen), 3, scene.count)), np.empty(sh.shape[2])
    for view, camera in enumerate(seen):
        for i in range(scene.count):
            sh_row(scene.positions, i, camera.position, row)
            found[view, :, i] = sh[i] @ row
    return found


def nearest(scene: Scene, steps: np.ndarray) -> Scene:
    """Round each SH-AC separately to its nearest level."""
    sh = coefficients_of(scene)
    bands = np.repeat([0, 1, 2], [3, 5, 7])[: sh.shape[2] - 1]
    size = steps[bands].T[:, None]
    sh[..., 1:] = np.floor(sh[..., 1:] / size + 0.5) * size
    return with_coefficients(scene, sh)


@pytest.fixture(scope="module")
def made() -> tuple[Scene, np.ndarray]:
    scene = random_scene(200, 3, seed=90)
    scene.f_rest[:, :20] = 0.0
    steps = np.random.default_rng(90).uniform(0.1, 0.4, (3, 200)).astype(np.float32)
    return scene, steps


@pytest.mark.parametrize("spread", [0.1, 0.5, 3.0])
def test_views_lose_less_than_with_nearest_levels(made, spread):
    scene, steps = made
    seen = cameras(12, spread)
    rounded = round_sh(scene, seen, np.ones((12, 200), np.float32), steps, ERROR)
    told, plain = colours(rounded, seen), colours(nearest(scene, steps), seen)
    wanted = colours(scene, seen)
    assert np.mean((told - wanted) ** 2) < 0.75 * np.mean((plain - wanted) ** 2)
    # In other directions, errors grow only a little.
    around = cameras(60, 3.0, seed=1)
    told, plain = colours(rounded, around), colours(nearest(scene, steps), around)
    wanted = colours(scene, around)
    assert np.mean((told - wanted) ** 2) < 1.6 * np.mean((plain - wanted) ** 2)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_values_are_on_levels_and_zeros_are_kept_seed91(degree):
    scene = random_scene(100, degree, seed=91)
    scene.f_rest[:, ::3] = 0.0
    steps = np.random.default_rng(91).uniform(0.01, 0.3, (3, 100)).astype(np.float32)
    rounded = round_sh(scene, cameras(9, 3.0), np.ones((9, 100), np.float32), steps, ERROR)
    planes = rounded.f_rest.reshape(3, -1, 100)
    bands = np.repeat([0, 1, 2], [3, 5, 7])[: planes.shape[1]]
    levels = np.stack([to_ycocg(plane) for plane in planes.swapaxes(0, 1)], axis=1) / steps[bands]
    assert np.abs(levels - np.rint(levels)).max() < 1e-3
    assert np.abs(levels).max() > 5
    assert not rounded.f_rest[:, ::3].any()
    for name in ("positions", "opacity", "log_scale", "rot"):
        np.testing.assert_array_equal(getattr(rounded, name), getattr(scene, name))


def test_bits_worth_less_than_their_error_are_saved(made):
    scene, steps = made
    seen, weights = cameras(12, 3.0), np.ones((12, 200), np.float32)
    magnitudes = [
        np.abs(coefficients_of(round_sh(scene, seen, weights, steps, error))[..., 1:]).sum()
        for error in (0.0, 0.01, 0.1, 10.0)
    ]
    assert magnitudes == sorted(magnitudes, reverse=True)
    assert magnitudes[-1] < 0.5 * magnitudes[0]


def test_invisible_gaussians_are_unchanged(made):
    scene, steps = made
    weights = np.ones((12, 200), np.float32)
    weights[:, 50:60] = 0.0
    rounded = round_sh(scene, cameras(12, 3.0), weights, steps, ERROR)
    np.testing.assert_array_equal(rounded.f_rest[:, 50:60], scene.f_rest[:, 50:60])
    np.testing.assert_array_equal(rounded.f_dc[:, 50:60], scene.f_dc[:, 50:60])
    assert (rounded.f_rest[:, 60:] != scene.f_rest[:, 60:]).any()


def test_a_scene_without_sh_ac_is_returned():
    scene = random_scene(10, 0, seed=92)
    assert round_sh(scene, cameras(2, 1.0), np.ones((2, 10), np.float32), None, ERROR) is scene
    empty = replace(random_scene(0, 1), comments=())
    assert round_sh(empty, [], np.ones((0, 0), np.float32), np.ones((3, 0)), ERROR).count == 0


@pytest.mark.parametrize("spread", [0.1, 3.0])
def test_levels_of_another_format_are_used(made, spread):
    scene, steps = made
    seen, grid = cameras(12, spread), ShGrid(steps, 0.5)
    rounded = round_rgb(scene, seen, np.ones((12, 200), np.float32), grid)
    rows = np.repeat([0, 1, 2], [3, 5, 7])
    levels = rounded.f_rest / np.tile(steps[rows], (3, 1)) - 0.5
    np.testing.assert_allclose(levels, np.rint(levels), atol=2e-5)
    plain = np.floor(scene.f_rest / np.tile(steps[rows], (3, 1))) + 0.5
    nearest_levels = replace(
        scene, f_rest=(plain * np.tile(steps[rows], (3, 1))).astype(np.float32)
    )
    before = colours(scene, seen)
    errors = [((colours(s, seen) - before) ** 2).mean() for s in (rounded, nearest_levels)]
    assert errors[0] < (0.2 if spread < 1 else 0.8) * errors[1]

"""Refitting colours: the operator and its transpose, conjugate gradients, recovery, edge cases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from orbits import images, orbit, visible_scene
from reference_renderer import render_reference
from scenes import assert_same_floats, edge_scenes, with_threads

from gs_codec.cameras.camera import Camera
from gs_codec.preparation import image_operator as module
from gs_codec.preparation.compact_sh import compact_sh
from gs_codec.preparation.image_operator import ImageOperator, Linear, Places
from gs_codec.preparation.reference_views import ReferenceViews
from gs_codec.preparation.refit_colour import refit_colour
from gs_codec.preparation.sh_weights import coefficients_of, with_coefficients
from gs_codec.rendering.project import TILE
from gs_codec.scene import GROUPS, Scene

EDGES = edge_scenes()
TEAL = (0.1, 0.7, 0.6)


def perturbed(scene: Scene, seed: int, scale: float = 0.1) -> Scene:
    rng = np.random.default_rng(seed)
    coefficients = coefficients_of(scene)
    return with_coefficients(
        scene, coefficients + rng.normal(scale=scale, size=coefficients.shape).astype(np.float32)
    )


def black(cameras: list[Camera]) -> list[np.ndarray]:
    return [np.zeros((camera.height, camera.width, 3)) for camera in cameras]


def references(cameras, targets, background=(0.0, 0.0, 0.0)) -> ReferenceViews:
    return ReferenceViews(tuple(cameras), tuple(targets), True, background)


def everywhere(coefficients: np.ndarray) -> Places:
    return Places.of(np.ones(coefficients.shape, bool))


def errors(operator: ImageOperator, coefficients: np.ndarray) -> float:
    """The squared error of all views."""
    views = range(len(operator.views.cameras))
    return float(operator.errors(coefficients.ravel(), everywhere(coefficients), views).sum())


def linearise(operator: ImageOperator, coefficients: np.ndarray) -> Linear:
    """Like the method, for all coefficients and in their shape."""
    near = operator.linearise(coefficients.ravel(), everywhere(coefficients))
    gradient, curvature = (x.reshape(coefficients.shape) for x in near[:2])
    return near._replace(gradient=gradient, curvature=curvature)


def apply(operator: ImageOperator, direction: np.ndarray, lit: np.ndarray) -> np.ndarray:
    """Like the method, for all coefficients and in their shape."""
    product, _ = operator.apply(direction.ravel(), everywhere(direction), lit)
    return product.reshape(direction.shape)


def psnr_of(scene: Scene, cameras, targets) -> float:
    error = np.mean((images(scene, cameras).astype(np.float64) - targets) ** 2)
    return float(-10 * np.log10(error))


# The operator


@pytest.mark.parametrize(("seed", "bright", "opacity"), [(0, 0, 0), (1, -1.5, 0), (2, 0, 9)])
def test_residual_is_the_references(seed, bright, opacity):
    scene, cameras = visible_scene(40, seed, bright=bright), orbit(3, seed)
    scene = replace(scene, opacity=scene.opacity + opacity, log_scale=scene.log_scale + opacity / 9)
    rng = np.random.default_rng(seed)
    targets = [rng.uniform(size=(40, 40, 3)) for _ in cameras]
    operator = ImageOperator(scene, references(cameras, targets, TEAL))
    drawn = [render_reference(scene, camera, TEAL) for camera in cameras]
    expected = sum(np.sum((t - d.colour) ** 2) for t, d in zip(targets, drawn, strict=True))
    coefficients = coefficients_of(scene).astype(np.float64)
    # Weights of 8 bits.
    assert linearise(operator, coefficients).errors.sum() == pytest.approx(expected, rel=3e-5)
    assert errors(operator, coefficients) == pytest.approx(expected, rel=3e-5)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_gradient_is_the_difference_of_the_objective(degree):
    scene, cameras = visible_scene(30, 2, degree, bright=-1.0), orbit(4)
    rng = np.random.default_rng(degree)
    targets = [rng.uniform(size=(40, 40, 3)) for _ in cameras]
    operator = ImageOperator(scene, references(cameras, targets, TEAL))
    at = coefficients_of(scene).astype(np.float64)
    gradient = -2 * linearise(operator, at).gradient
    for _ in range(5):
        direction = rng.normal(size=at.shape)
        # The images are float32.
        above, below = (errors(operator, at + h * direction) for h in (3e-4, -3e-4))
        expected = np.sum(gradient * direction)
        assert (above - below) / 6e-4 == pytest.approx(expected, rel=2e-3, abs=0.02)


@pytest.mark.parametrize("seed", [3, 4])
def test_normal_equations_are_symmetric_and_those_of_the_images(seed):
    scene, cameras = visible_scene(50, seed), orbit(4, seed)
    operator = ImageOperator(scene, references(cameras, black(cameras)))
    at = coefficients_of(scene).astype(np.float64)
    near = linearise(operator, at)
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(2, *at.shape))
    on_x, on_y = apply(operator, x, near.lit), apply(operator, y, near.lit)
    assert np.sum(y * on_x) == pytest.approx(np.sum(x * on_y), rel=1e-6)
    assert np.sum(x * on_x) > 0


@pytest.mark.parametrize("seed", [3, 4])
def test_transpose_is_the_adjoint(seed):
    """<A x, t> = <x, A^T t>: for colours above black the image is A (0.5 + Y x)."""
    scene, cameras = visible_scene(50, seed, bright=4.0), orbit(4, seed)
    at = coefficients_of(scene).astype(np.float64)
    rng = np.random.default_rng(seed)
    targets = [rng.normal(size=(40, 40, 3)) for _ in cameras]
    to_black = ImageOperator(scene, references(cameras, black(cameras)))
    to_targets = ImageOperator(scene, references(cameras, targets))
    dark = linearise(to_black, at)
    assert set(np.unique(dark.lit)) <= {0, 7}
    back = linearise(to_targets, at).gradient - dark.gradient
    change = 0.1 * rng.normal(size=at.shape)
    moved = at + change
    # |t - image|^2 differs from |image|^2 by |t|^2 - 2 <image, t>.
    forth = 0.0
    for coefficients, sign in ((moved, 1), (at, -1)):
        forth -= sign * 0.5 * (errors(to_targets, coefficients) - errors(to_black, coefficients))
    assert forth == pytest.approx(np.sum(change * back), rel=1e-4)


def test_curvature_is_the_diagonal_of_the_normal_equations():
    scene, cameras = visible_scene(12, 5), orbit(3)
    operator = ImageOperator(scene, references(cameras, black(cameras)))
    at = coefficients_of(scene).astype(np.float64)
    near = linearise(operator, at)
    rng = np.random.default_rng(5)
    for place in rng.integers(0, at.shape, (20, 3)):
        unit = np.zeros_like(at)
        unit[tuple(place)] = 1.0
        product = apply(operator, unit, near.lit)
        assert product[tuple(place)] == pytest.approx(near.curvature[tuple(place)], rel=1e-4)


def test_colours_at_black_have_no_gradient():
    scene, cameras = visible_scene(40, 6, sh_degree=0), orbit(3)
    scene = replace(scene, f_dc=np.where(np.arange(40) % 2, scene.f_dc, np.float32(-3)))
    operator = ImageOperator(scene, references(cameras, black(cameras)))
    near = linearise(operator, coefficients_of(scene))
    assert not near.gradient[::2, :, 0].any()
    assert not near.lit[:, ::2].any()
    assert near.gradient[1::2, :, 0].any()


@pytest.mark.parametrize("every", [2, 3])
def test_tiles_are_sampled_if_memory_is_too_small(monkeypatch, every):
    scene, cameras = visible_scene(40, 8), orbit(4)
    targets = [np.random.default_rng(8).uniform(size=(40, 40, 3)) for _ in cameras]
    views, at = references(cameras, targets), coefficients_of(scene)
    whole = ImageOperator(scene, views)
    errors(whole, at)
    taken = sum(traced.nbytes for traced in whole.kept.values())
    monkeypatch.setattr(module, "_KEPT_BYTES", int(taken / (every - 0.5)))
    operator = ImageOperator(scene, views)
    found = operator.errors(at.ravel(), everywhere(at), range(4))
    tiles = np.arange(40) // TILE
    for view, camera in enumerate(cameras):
        counts = (tiles[:, None] + tiles) % every == view % every
        assert operator.pixels(view) == np.count_nonzero(counts)
        image = render_reference(scene, camera, (0.0, 0.0, 0.0)).colour
        expected = np.sum((targets[view] - image)[counts] ** 2)
        assert found[view] == pytest.approx(expected, rel=3e-5)
    assert sum(traced.nbytes for traced in operator.kept.values()) < taken


def test_buffers_grow_with_many_fragments():
    """Many faint Gaussians over whole tiles: their weights outgrow the initial buffers."""
    scene = visible_scene(400, 7, sh_degree=0)
    scene = replace(
        scene,
        positions=(0.1 * scene.positions).astype(np.float32),
        opacity=np.full_like(scene.opacity, -4),
        log_scale=np.full_like(scene.log_scale, 0.5),
    )
    cameras = orbit(1)
    operator = ImageOperator(scene, references(cameras, images(scene, cameras)))
    # 87 dB.
    assert errors(operator, coefficients_of(scene).astype(np.float64)) < 1e-5


def test_rounded_weights_keep_the_image():
    """The rounding error of a weight goes to the next splats of its pixel."""
    scene, cameras = visible_scene(200, 13), orbit(4)
    scene = replace(scene, log_scale=scene.log_scale + np.float32(0.5))
    operator = ImageOperator(scene, references(cameras, images(scene, cameras)))
    error = errors(operator, coefficients_of(scene).astype(np.float64))
    assert -10 * np.log10(error / (3 * 4 * 40 * 40)) > 70


# Refitting


@pytest.mark.parametrize("seed", [8, 9])
def test_objective_decreases_monotonically(seed):
    scene, cameras = visible_scene(60, seed), orbit(6, seed)
    targets = images(perturbed(scene, seed), cameras)
    _, report = refit_colour(scene, references(cameras, targets), 10, keep_zeros=False)
    assert len(report.objective) == len(report.psnr) == 11
    assert (np.diff(report.objective) < 0).all()
    assert (np.diff(report.psnr) > 0).all()


def test_objective_is_that_of_images_ridge_and_penalty():
    scene, cameras = visible_scene(20, 10, 1, bright=4.0), orbit(4)
    views = references(cameras, images(perturbed(scene, 10), cameras))
    refitted, report = refit_colour(scene, views, 8, strength=1e-4)
    before, after = (coefficients_of(x).astype(np.float64) for x in (scene, refitted))
    scales = np.sqrt(1e-4 * 4 * 40 * 40 / (3 * 20)) / (np.abs(before) + 0.009)
    for x, objective in ((before, report.objective[0]), (after, report.objective[-1])):
        damping = 0.03 * np.sum((x - before) ** 2) + np.sum((x * scales)[..., 1:] ** 2)
        error = errors(ImageOperator(scene, views), x)
        assert objective == pytest.approx(error + damping, rel=1e-6)


def test_psnr_is_that_of_the_images():
    scene, cameras = visible_scene(60, 10, bright=3.0), orbit(6)
    targets = images(perturbed(scene, 10), cameras)
    refitted, report = refit_colour(scene, references(cameras, targets), 5)
    for result, psnr in ((scene, report.psnr[0]), (refitted, report.psnr[-1])):
        assert psnr_of(result, cameras, targets) == pytest.approx(psnr, abs=0.05)


@pytest.mark.parametrize("seed", [11, 12])
def test_perturbed_colours_are_recovered(seed):
    scene, cameras = visible_scene(6, seed, 1, bright=4.0), orbit(8, seed)
    start = perturbed(scene, seed)
    targets = images(scene, cameras)
    refitted, report = refit_colour(start, references(cameras, targets), 20)
    assert not report.kept
    assert psnr_of(refitted, cameras, targets) > psnr_of(start, cameras, targets) + 15
    before, after = (
        np.abs(coefficients_of(x) - coefficients_of(scene)).mean() for x in (start, refitted)
    )
    assert after < 0.4 * before


def test_the_objective_has_the_squared_change_of_sh():
    scene, cameras = visible_scene(60, 13, bright=4.0), orbit(6)
    views = references(cameras, images(perturbed(scene, 13), cameras))
    refitted, report = refit_colour(scene, views, 10)
    change = coefficients_of(refitted).astype(np.float64) - coefficients_of(scene).astype(
        np.float64
    )
    error = errors(ImageOperator(scene, views), coefficients_of(refitted).astype(np.float64))
    expected = error + 0.03 * np.sum(change**2)
    assert report.objective[-1] == pytest.approx(expected, rel=1e-3)
    assert error < 0.9 * report.objective[-1]


def test_penalty_keeps_coefficients_small():
    scene, cameras = visible_scene(60, 13), orbit(4)
    targets = images(perturbed(scene, 13), cameras)
    sizes = []
    for strength in (0.0, 1e-5, 1e-3):
        refitted, report = refit_colour(scene, references(cameras, targets), 3, strength=strength)
        sizes.append(np.abs(refitted.f_rest).mean())
        assert (np.diff(report.objective) < 0).all()
    assert sizes[0] > sizes[1] > sizes[2]


@pytest.mark.parametrize("seed", [22, 23])
def test_refit_recovers_the_loss_of_compaction(seed):
    scene, cameras = visible_scene(80, seed), orbit(12, seed)
    targets = images(scene, cameras)
    compacted, before = compact_sh(scene, cameras, 1e-4)
    refitted, report = refit_colour(compacted, references(cameras, targets), 6, strength=1e-4)
    assert psnr_of(refitted, cameras, targets) > report.psnr[0] + 0.5
    assert (coefficients_of(refitted)[..., 1:] == 0).sum() == before["zeros_after"]
    assert np.abs(refitted.f_rest).mean() < 1.1 * np.abs(compacted.f_rest).mean()


@pytest.mark.parametrize("keep_zeros", [True, False])
def test_zeros_are_kept_on_request(keep_zeros):
    scene, cameras = visible_scene(40, 14), orbit(6)
    coefficients = coefficients_of(scene)
    small = np.abs(coefficients) <= 0.05
    small[..., 0] = False
    start = with_coefficients(scene, np.where(small, 0, coefficients))
    refitted, _ = refit_colour(
        start, references(cameras, images(scene, cameras)), 4, keep_zeros=keep_zeros
    )
    after = coefficients_of(refitted)
    assert (after[coefficients_of(start) == 0] == 0).all() == keep_zeros
    assert (refitted.f_dc != start.f_dc).any()


def test_no_steps_keep_the_scene():
    scene, cameras = visible_scene(20, 15), orbit(2)
    refitted, report = refit_colour(scene, references(cameras, black(cameras)), 0)
    assert report.kept
    assert refitted is scene
    assert len(report.psnr) == len(report.objective) == 1


def test_threads_do_not_change_it(monkeypatch):
    monkeypatch.setattr(module, "_CHUNK", 7)
    scene, cameras = visible_scene(50, 17), orbit(5)
    targets = images(perturbed(scene, 17), cameras)
    results = [
        with_threads(n, refit_colour, scene, references(cameras, targets), 2) for n in (1, 2, 5)
    ]
    for refitted, report in results[1:]:
        assert_same_floats(refitted, results[0][0])
        assert report == results[0][1]


@pytest.mark.parametrize("name", EDGES)
def test_edges(name):
    scene, cameras = EDGES[name], orbit(3)
    copy = scene.take(np.arange(scene.count))
    targets = [np.full((40, 40, 3), 0.5, np.float32) for _ in cameras]
    refitted, report = refit_colour(scene, references(cameras, targets, TEAL), 3)
    assert_same_floats(scene, copy)
    assert np.isfinite(refitted.f_dc).all()
    assert np.isfinite(refitted.f_rest).all()
    assert np.isfinite(report.objective).all()
    assert (np.diff(report.objective) <= 0).all()
    for group in set(GROUPS) - {"f_dc", "f_rest"}:
        np.testing.assert_array_equal(getattr(refitted, group), getattr(scene, group))


def test_nonfinite_values_are_unchanged():
    scene, cameras = visible_scene(30, 18), orbit(3)
    f_rest = scene.f_rest.copy()
    f_rest[3, 2], f_rest[20, 4] = np.nan, np.inf
    scene = replace(scene, f_rest=f_rest)
    targets = [np.full((40, 40, 3), 0.5, np.float32) for _ in cameras]
    refitted, report = refit_colour(scene, references(cameras, targets), 3)
    assert not report.kept
    finite = np.isfinite(f_rest)
    np.testing.assert_array_equal(np.isfinite(refitted.f_rest), finite)


def test_progress_counts_views():
    calls = []
    scene, cameras = visible_scene(5, 19), orbit(3)
    views = references(cameras, black(cameras))
    refit_colour(scene, views, 2, progress=lambda *step: calls.append(step))
    assert calls == [("refit", i, 12) for i in range(1, 13)]

"""Contributions of Gaussians to a pixel and to a view, against the slow reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference_renderer as reference
from scenes import antialiased, random_scene

from gs_codec.cameras.camera import Camera
from gs_codec.rendering.pixel import gaussian_weight, pixel_weights, splat_outline
from gs_codec.rendering.renderer import render
from gs_codec.scene import Scene


def camera(width: int = 40, height: int = 27) -> Camera:
    position = np.array([0.0, 0.2, -4.0])
    return Camera("front", width, height, 30.0, 33.0, width / 2 + 3, 12.0, np.eye(3), position)


def scene(count: int, **changes) -> Scene:
    """Larger Gaussians than in `random_scene`, so that each pixel has many."""
    made = random_scene(count, 1, seed=50)
    larger = (made.log_scale + 3).clip(max=0).astype(np.float32)
    return replace(made, log_scale=larger, **changes)


def traced(seen: Scene, view: Camera, column: int, row: int) -> dict[int, float]:
    """The weights of a pixel from the reference: every Gaussian, nearest first."""
    offsets = seen.positions.T.astype(np.float64) - view.position
    points, weights, left = offsets @ view.rotation.T, {}, 1.0
    here = np.array(column), np.array(row)
    for n in np.argsort(points[:, 2], kind="stable"):
        planes = (plane[:, n].astype(np.float64) for plane in (seen.log_scale, seen.rot))
        splat = reference.project(points[n], *planes, view, seen.antialiased)
        if splat is None or not reference.covers(splat, *here, view):
            continue
        away = splat.mean - (column, row)
        power = -0.5 * away @ np.linalg.solve(splat.covariance, away)
        opacity = splat.shrink / (1 + np.exp(-float(seen.opacity[0, n])))
        alpha = min(reference.MAX_ALPHA, opacity * np.exp(power))
        if alpha < reference.MIN_ALPHA:
            continue
        if left * (1 - alpha) < reference.MIN_TRANSMITTANCE:
            break
        weights[int(n)] = alpha * left
        left *= 1 - alpha
    return weights


@pytest.mark.parametrize("compensated", [False, True])
@pytest.mark.parametrize(("column", "row"), [(0, 0), (39, 26), (21, 13), (16, 15), (15, 16)])
def test_contributions_to_a_pixel_match_the_reference(column, row, compensated):
    seen = antialiased(scene(300), compensated)
    expected = traced(seen, camera(), column, row)
    rows, weights = pixel_weights(seen, camera(), column, row)
    assert len(rows) > 2
    assert rows.tolist() == list(expected)  # nearest first
    np.testing.assert_allclose(weights, list(expected.values()), atol=1e-9)


def test_weights_of_all_pixels_match_the_renderers_sums():
    seen, view = scene(150), camera(24, 18)
    drawn = render(seen, view, accumulate=True, device="cpu")
    sums, pixels = np.zeros(150), np.zeros(150, int)
    for row in range(18):
        for column in range(24):
            rows, weights = pixel_weights(seen, view, column, row)
            assert weights.sum() == pytest.approx(drawn.alpha[row, column], abs=1e-6)
            sums[rows] += weights
            pixels[rows] += 1
    np.testing.assert_allclose(sums, drawn.accumulations.weight, atol=1e-9)
    np.testing.assert_array_equal(pixels, drawn.accumulations.pixels)
    assert (pixels == 0).any()
    for gaussian in range(150):
        weight, count = gaussian_weight(seen, view, gaussian)
        assert weight == pytest.approx(sums[gaussian], abs=1e-9)
        assert count == pixels[gaussian]


def test_equal_depths_keep_the_order_of_the_scene():
    seen = scene(40).take(np.arange(40).repeat(2))
    for column, row in ((10, 9), (30, 20)):
        rows, _ = pixel_weights(seen, camera(), column, row)
        assert rows.tolist() == list(traced(seen, camera(), column, row))


def test_an_empty_scene_has_no_contributions():
    empty = scene(3).take(np.arange(0))
    rows, weights = pixel_weights(empty, camera(), 3, 3)
    assert rows.shape == weights.shape == (0,)
    behind = scene(5, positions=np.full((3, 5), -9, np.float32))
    assert not len(pixel_weights(behind, camera(), 3, 3)[0])
    assert gaussian_weight(behind, camera(), 2) == (0.0, 0)
    assert splat_outline(behind, camera(), 2) is None


@pytest.mark.parametrize("sigmas", [1.0, 3.0])
def test_an_outline_is_where_the_splat_has_that_deviation(sigmas):
    seen, view, found = scene(60), camera(), 0
    points = seen.positions.T.astype(np.float64) - view.position
    for n in range(60):
        outline = splat_outline(seen, view, n, sigmas)
        planes = (plane[:, n].astype(np.float64) for plane in (seen.log_scale, seen.rot))
        splat = reference.project(points[n], *planes, view, antialiased=False)
        if outline is None:
            assert not render(seen.take(np.array([n])), view, device="cpu").alpha.any()
            continue
        found += 1
        away = outline - 0.5 - splat.mean
        square = np.sum(away * np.linalg.solve(splat.covariance, away.T).T, axis=1)
        np.testing.assert_allclose(square, sigmas**2, rtol=1e-6)
        np.testing.assert_allclose(away.mean(axis=0), 0, atol=1e-6 * np.abs(away).max())
    assert found > 20

"""SH energy compaction: its equations against brute force, invariants, and edge cases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from orbits import facing, images, orbit, visible_scene
from reference_renderer import render_reference, sh_basis
from scenes import assert_same_floats, edge_scenes, random_scene, with_threads

from gs_codec.preparation import compact_sh as module
from gs_codec.preparation.compact_sh import compact_sh
from gs_codec.preparation.sh_weights import (
    coefficients_of,
    fill_matrix,
    solve,
    squared_weights,
    with_coefficients,
)
from gs_codec.scene import GROUPS

EDGES = edge_scenes()


# Weights


def test_weights_are_those_of_the_reference():
    scene, cameras = visible_scene(30, 1), orbit(3)
    weights = squared_weights(scene, cameras)
    expected = [render_reference(scene, camera).squared_weight for camera in cameras]
    np.testing.assert_allclose(weights, expected, rtol=1e-6, atol=1e-12)


def test_coefficients_round_trip():
    for degree in range(4):
        scene = random_scene(7, degree)
        assert_same_floats(with_coefficients(scene, coefficients_of(scene)), scene)


# The equations


def test_matrix_is_the_sum_of_outer_products():
    scene, cameras = visible_scene(20, 2), orbit(9)
    weights = squared_weights(scene, cameras).astype(np.float64)
    for i in range(scene.count):
        centre = scene.positions[:, i].astype(np.float64)
        offsets = [centre - camera.position for camera in cameras]
        rows = np.array([sh_basis(offset / np.linalg.norm(offset)) for offset in offsets])
        matrix = np.empty((16, 16))
        fill_matrix(rows, weights[:, i], 16, matrix)
        expected = (rows * weights[:, i, None]).T @ rows
        np.testing.assert_allclose(matrix, expected, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("seed", [0, 1])
def test_solve_is_numpys(seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(16, 20))
    right = rng.normal(size=16)
    expected = np.linalg.solve(root @ root.T, right)
    assert solve(root @ root.T, right, 16)
    np.testing.assert_allclose(right, expected, rtol=1e-9)


def test_singular_matrix_is_not_solved():
    assert not solve(np.zeros((16, 16)), np.ones(4), 4)
    assert not solve(np.full((16, 16), np.nan), np.ones(2), 2)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_luma_and_chroma_are_solved_as_by_brute_force(degree):
    scene, cameras = visible_scene(12, 3, degree, bright=3.0), orbit(20)
    strength, smallest = 1e-5, 0.02
    compacted, _ = compact_sh(scene, cameras, strength, smallest=smallest)
    weights = squared_weights(scene, cameras).astype(np.float64)
    before, after = (coefficients_of(x).astype(np.float64) for x in (scene, compacted))
    ac, found = before.shape[2] - 1, set()
    penalty = strength * sum(c.width * c.height for c in cameras) / (ac * scene.count)
    for i in range(scene.count):
        offsets = [scene.positions[:, i].astype(np.float64) - c.position for c in cameras]
        rows = np.array([sh_basis(o / np.linalg.norm(o))[: 1 + ac] for o in offsets])
        known = rows.T * weights[:, i]
        inertia = 1e-9 * weights[:, i].sum()
        solutions, turn = before[i].copy(), 0
        seen = solutions @ rows.T
        form = known @ rows
        for solution in solutions:
            of_ac = form[:, 1:] @ solution[1:]
            if solution[1:] @ of_ac[1:] - of_ac[0] ** 2 / form[0, 0] <= penalty:
                solution[0] += of_ac[0] / form[0, 0]
                solution[1:] = 0.0
        flat = ~solutions[:, 1:].any(axis=1)
        while turn < 12:
            start = solutions.copy()
            for channel, solution in enumerate(start):
                used = (solution != 0) | (turn == 0 and not flat[channel])
                used[0] = True
                damping = inertia + penalty / (np.abs(solution) + smallest / 2) ** 2
                damping[0] = inertia
                system = (form + np.diag(damping))[np.ix_(used, used)]
                right = known @ seen[channel] + inertia * solution
                solutions[channel] = 0.0
                solutions[channel, used] = np.linalg.solve(system, right[used])
            least = smallest * (0.0 if turn < 2 else 0.1 if turn < 10 else 1.0)
            solutions[:, 1:][np.abs(solutions[:, 1:]) < least] = 0.0
            turn += 1
            if np.abs(solutions - start).max() < 0.02 * smallest:
                turn = max(turn, 10)
        np.testing.assert_allclose(after[i], solutions, rtol=1e-3, atol=1e-5)
        found |= {
            (bool(kept), bool(solution[1:].any()))
            for kept, solution in zip(~flat, solutions, strict=True)
        }
    assert {(True, True), (False, False)} <= found


# What must hold


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_zero_strength_changes_nothing(degree):
    scene, cameras = visible_scene(60, 4, degree), orbit(8)
    compacted, _ = compact_sh(scene, cameras, 1e-14, smallest=0.0)
    np.testing.assert_allclose(images(compacted, cameras), images(scene, cameras), atol=1e-4)


@pytest.mark.parametrize("seed", [5, 6])
def test_error_and_zeros_grow_with_strength(seed):
    scene, cameras = visible_scene(80, seed), orbit(12)
    errors, zeros = [], []
    for strength in (1e-6, 1e-5, 1e-3):
        compacted, report = compact_sh(scene, cameras, strength)
        errors.append(np.mean((images(compacted, cameras) - images(scene, cameras)) ** 2))
        zeros.append(report["zeros_after"])
        assert report["zeros_after"] == (coefficients_of(compacted)[..., 1:] == 0).sum()
        assert errors[-1] < strength
    assert sorted(errors) == errors
    assert sorted(zeros) == zeros
    assert zeros[-1] > zeros[0] > 0


def test_gaussians_visible_from_one_side_need_only_dc():
    scene, camera = visible_scene(1, 7, bright=1.0), facing((1, 2, 3))
    scene = replace(scene, positions=np.zeros_like(scene.positions))
    compacted, _ = compact_sh(scene, [camera], 1e-6)
    assert not compacted.f_rest.any()
    np.testing.assert_allclose(images(compacted, [camera]), images(scene, [camera]), atol=2e-3)


def test_unseen_gaussians_keep_only_dc():
    scene, cameras = visible_scene(20, 8), orbit(4)
    far = scene.positions.copy()
    far[:, :5] += 1000
    scene = replace(scene, positions=far)
    compacted, report = compact_sh(scene, cameras, 2e-5)
    assert report["unseen"] == 5
    assert not compacted.f_rest[:, :5].any()
    np.testing.assert_array_equal(compacted.f_dc[:, :5], scene.f_dc[:, :5])


def test_colours_clamped_at_black_cost_nothing():
    scene, cameras = visible_scene(50, 9), orbit(12)
    black = replace(scene, f_dc=np.full_like(scene.f_dc, -3.0))
    compacted, _ = compact_sh(black, cameras, 1e-6)
    assert not compacted.f_rest.any()
    assert not images(compacted, cameras).any()


def test_channels_at_black_follow_the_others():
    """Then only Y varies, without visible difference."""
    scene, cameras = visible_scene(50, 9, bright=3.0), orbit(12)
    f_rest = scene.f_rest.reshape(3, 15, -1).copy()
    f_rest[0], f_rest[2] = f_rest[1], 0.0
    f_dc = scene.f_dc.copy()
    f_dc[2] = -2.0
    scene = replace(scene, f_dc=f_dc, f_rest=f_rest.reshape(45, -1))
    compacted, _ = compact_sh(scene, cameras, 1e-9, smallest=0.001)
    assert coefficients_of(compacted)[:, 0, 1:].any()
    assert not coefficients_of(compacted)[:, 1:, 1:].any()
    np.testing.assert_allclose(images(compacted, cameras), images(scene, cameras), atol=2e-3)


def test_partly_black_colours_stay_black():
    scene, cameras = visible_scene(50, 9), orbit(12)
    dark = replace(scene, f_dc=np.full_like(scene.f_dc, -2.2))
    compacted, _ = compact_sh(dark, cameras, 1e-5)
    before, after = images(dark, cameras), images(compacted, cameras)
    assert before.any()
    assert np.mean((after - before) ** 2) < 1e-6


def test_gaussians_without_ac_are_unchanged():
    scene, cameras = visible_scene(50, 10), orbit(6)
    f_rest = scene.f_rest.copy()
    f_rest[:, :20] = 0
    scene = replace(scene, f_rest=f_rest)
    compacted, report = compact_sh(scene, cameras, 2e-5)
    assert report["without_ac"] == 20
    assert not compacted.f_rest[:, :20].any()
    np.testing.assert_array_equal(compacted.f_dc[:, :20], scene.f_dc[:, :20])


def test_nonfinite_values_are_unchanged():
    scene, cameras = visible_scene(10, 11), orbit(4)
    f_rest = scene.f_rest.copy()
    f_rest[3, 2], f_rest[20, 4] = np.nan, np.inf
    scene = replace(scene, f_rest=f_rest)
    compacted, report = compact_sh(scene, cameras, 2e-5)
    assert report["unsolved"] == 2
    np.testing.assert_array_equal(compacted.f_rest[:, [2, 4]], f_rest[:, [2, 4]])
    assert np.isnan(compacted.f_rest).sum() == 1


def test_degree_0_is_unchanged():
    scene = visible_scene(10, 12, sh_degree=0)
    compacted, _ = compact_sh(scene, orbit(2), 2e-5)
    assert_same_floats(compacted, scene)


@pytest.mark.parametrize("name", EDGES)
def test_edges(name):
    scene, cameras = EDGES[name], orbit(4)
    copy = scene.take(np.arange(scene.count))
    compacted, report = compact_sh(scene, cameras, 1e-4)
    assert_same_floats(scene, copy)
    assert np.isfinite(compacted.f_dc).all()
    assert np.isfinite(compacted.f_rest).all()
    assert report["count"] == scene.count
    for group in set(GROUPS) - {"f_dc", "f_rest"}:
        np.testing.assert_array_equal(getattr(compacted, group), getattr(scene, group))


def test_threads_do_not_change_it(monkeypatch):
    monkeypatch.setattr(module, "_CHUNK", 7)
    scene, cameras = visible_scene(60, 13), orbit(6)
    results = [with_threads(number, compact_sh, scene, cameras, 2e-5) for number in (1, 3)]
    assert_same_floats(results[0][0], results[1][0])
    assert results[0][1] == results[1][1]


def test_known_weights_are_used():
    scene, cameras = visible_scene(30, 14), orbit(6)
    weights = squared_weights(scene, cameras)
    assert_same_floats(
        compact_sh(scene, cameras, 2e-5, weights=weights)[0], compact_sh(scene, cameras, 2e-5)[0]
    )


def test_progress_counts_views_and_gaussians():
    calls = []
    scene = visible_scene(5, 15)
    compact_sh(scene, orbit(3), 2e-5, progress=lambda *step: calls.append(step))
    assert calls == [*(("weights", i, 3) for i in (1, 2, 3)), ("compact", 1, 1)]

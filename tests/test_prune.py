"""Pruning: exact numbers, deterministic ties, scores against brute force, loss limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import edge_scenes, random_scene

from gs_codec.cameras.camera import Camera
from gs_codec.errors import InvalidInput
from gs_codec.plan import Steps
from gs_codec.preparation import reference_views as targets_module
from gs_codec.preparation.likely_views import cameras_between
from gs_codec.preparation.pipeline import Plan, prepare_scene
from gs_codec.preparation.prune import (
    importance,
    keep_highest,
    keep_near,
    leave_one_out,
    portion,
    prune_leave_one_out,
)
from gs_codec.preparation.reference_views import ReferenceViews, ViewSplit, draw_reference_views
from gs_codec.rendering.renderer import render
from gs_codec.scene import SH_C0, Scene

BLACK = (0.0, 0.0, 0.0)


def camera(x=0.0, width=48, height=32) -> Camera:
    return Camera(
        f"{x}", width, height, 45.0, 45.0, width / 2, height / 2, np.eye(3), np.array([x, 0.0, -4])
    )


CAMERAS = [camera(x) for x in (-0.8, 0.0, 0.8)]


def visible_scene(count: int, seed: int, sh_degree: int = 1) -> Scene:
    """Gaussians large enough to cover pixels."""
    scene = random_scene(count, sh_degree, seed)
    sizes = np.random.default_rng(seed).normal(-2.3, 0.4, (3, count)).astype(np.float32)
    return replace(scene, log_scale=sizes)


# Numbers


@pytest.mark.parametrize(
    ("count", "percent", "expected"),
    [(100, 7, 7), (100, 7.99, 7), (10, 99, 9), (3, 33.4, 1), (3, 33, 0), (0, 50, 0), (1, 99, 0)],
)
def test_never_more_than_requested(count, percent, expected):
    assert portion(count, percent) == expected


@pytest.mark.parametrize("percent", range(1, 100))
def test_whole_percentages_of_a_hundred_are_exact(percent):
    assert portion(100, percent) == percent
    assert portion(100_000, percent / 10) == percent * 100


def test_a_scene_that_would_be_empty_is_refused():
    with pytest.raises(InvalidInput, match="would leave none"):
        portion(7, 100)


def test_ties_are_removed_in_scene_order():
    scores = np.array([1.0, 0.0, 1.0, 0.0, 0.0, 2.0])
    assert keep_highest(scores, 2).tolist() == [0, 2, 4, 5]
    assert keep_highest(scores, 4).tolist() == [2, 5]
    assert keep_highest(scores, 0).tolist() == list(range(6))


# Geometry


@pytest.mark.parametrize("percent", [0, 1, 5, 20])
def test_geometry_leaves_the_papers_number(percent):
    scene = random_scene(1000, 0, seed=110)
    expected = 1000
    for _ in range(3):
        expected -= int(expected * percent / 100)
    assert len(keep_near(scene, percent, "median")) == expected


@pytest.mark.parametrize("rule", ["median", "largest"])
def test_geometry_removes_the_farthest_of_each_axis_in_turn(rule):
    scene = random_scene(200, 0, seed=111)
    scene.positions[:] += np.float32([[3], [0], [-1]])
    centre = np.median(scene.positions, axis=1) if rule == "median" else np.zeros(3)
    left = list(range(200))
    for axis in range(3):
        offsets = np.abs(scene.positions[axis].astype(np.float64) - centre[axis])
        left.sort(key=lambda i, offsets=offsets: offsets[i])
        left = left[: len(left) - len(left) // 10]
    assert keep_near(scene, 10, rule).tolist() == sorted(left)


def test_geometry_of_coincident_centres_removes_the_first():
    scene = edge_scenes()["one place"]
    kept = keep_near(scene, 10, "median")
    assert kept.tolist() == list(range(scene.count - len(kept), scene.count))


# Importance


def test_importance_is_lightgaussians_formula():
    scene = visible_scene(60, 112)
    expected = np.zeros(60)
    for view in CAMERAS:
        expected += render(scene, view, accumulate=True).accumulations.transmittance
    volume = np.exp(scene.log_scale.astype(np.float64).sum(axis=0))
    expected *= np.minimum(volume / np.quantile(np.log(volume), 0.9), 1) ** 0 / (
        1 + np.exp(-scene.opacity[0].astype(np.float64))
    )
    largest = np.exp(np.quantile(np.log(volume), 0.9))
    expected *= np.minimum(volume / largest, 1) ** 0.1
    np.testing.assert_allclose(importance(scene, CAMERAS), expected, rtol=1e-9)
    assert (expected == 0).any()


# Leave-one-out


def squared_error(scene: Scene, targets, background=BLACK) -> float:
    return sum(
        float(((render(scene, view, background).colour.astype(np.float64) - target) ** 2).sum())
        for view, target in zip(CAMERAS, targets, strict=True)
    )


@pytest.mark.parametrize("background", [BLACK, (0.9, 0.4, 0.1)], ids=["black", "orange"])
def test_leave_one_out_equals_the_error_of_removal(background):
    scene = visible_scene(80, 113)
    targets = [render(scene, view, background).colour for view in CAMERAS]
    scores = leave_one_out(scene, references(scene, background), "")
    largest = np.abs(scores).max()
    compared = 0
    for i in range(80):
        removed = squared_error(scene.take(np.arange(80) != i), targets, background)
        if removed > 1e-3 * largest:
            assert scores[i] == pytest.approx(removed, rel=0.01)
            compared += 1
    assert compared > 30
    unseen = sum(render(scene, v, accumulate=True).accumulations.pixels for v in CAMERAS) == 0
    assert (scores[unseen] == 0).all()
    assert unseen.any()


def test_leave_one_out_is_deterministic():
    scene = visible_scene(50, 114)
    first = leave_one_out(scene, references(scene), "")
    np.testing.assert_array_equal(first, leave_one_out(scene, references(scene), ""))


def test_hidden_gaussians_have_score_0():
    scene = visible_scene(3, 115, 0)
    flat = np.full((3, 3), 1.5, np.float32)
    layers = np.array([[0, 0, 0], [0, 0, 0], [0, 0.5, 1]], np.float32)
    scene = replace(scene, positions=layers, log_scale=flat, opacity=np.full((1, 3), 9, np.float32))
    scores = leave_one_out(scene, references(scene), "")
    assert scores[2] < 1e-3 * scores[0]


def test_gaussians_of_the_backgrounds_colour_have_score_0():
    scene = visible_scene(9, 116, 0)
    flat, opaque = np.ones((3, 9), np.float32), np.full((1, 9), 9, np.float32)
    scene = replace(scene, f_dc=flat, log_scale=flat, opacity=opaque)
    scores = leave_one_out(scene, references(scene, (0.5 + SH_C0,) * 3), "")
    assert scores.max() < 1e-9
    assert leave_one_out(scene, references(scene), "").min() > 0


def test_spread_views_are_blended_with_the_expected_error():
    scene = visible_scene(80, 117)
    views = references(scene)
    seen = leave_one_out(scene, views, "")
    scores = leave_one_out(scene, replace(views, origin="anywhere"), "")
    expected = scores - seen
    assert expected.min() > 0
    assert expected.mean() == pytest.approx(0.05 / 0.95 * seen.mean())
    unseen = np.flatnonzero(seen == 0)
    assert len(unseen) > 3
    larger = replace(scene, log_scale=scene.log_scale.copy())
    larger.log_scale[:, unseen[0]] += 0.1
    more = leave_one_out(larger, replace(views, origin="anywhere"), "")
    assert more[unseen[0]] > 1.1 * scores[unseen[0]]
    np.testing.assert_array_equal(
        leave_one_out(scene, replace(views, origin="estimated"), ""), seen
    )
    broken = replace(scene, log_scale=scene.log_scale.copy())
    broken.log_scale[:, unseen[0]] = np.nan
    assert np.isfinite(leave_one_out(broken, replace(views, origin="anywhere"), "")).all()


def references(scene: Scene, background=BLACK) -> ReferenceViews:
    return draw_reference_views(scene, CAMERAS, background)


def views_of(scene: Scene) -> ViewSplit:
    targets = references(scene)
    return ViewSplit(targets, None, targets)


@pytest.mark.parametrize("percent", [1, 10, 37, 66, 90])
def test_rounds_remove_exactly_the_requested_number(percent):
    scene = visible_scene(150, 116)
    kept, details = prune_leave_one_out(scene, views_of(scene), Steps(prune=percent))
    assert len(kept) == 150 - 150 * percent // 100
    assert (np.diff(kept) > 0).all()
    counts = [entry["gaussians"] for entry in details["rounds"]]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] == 150


@pytest.mark.parametrize("rule", ["median", "largest"])
def test_nan_is_the_farthest(rule):
    scene = random_scene(300, 0, seed=17)
    scene.positions[:, 50:250] = 0  # so that the median does not depend on one
    scene.positions[:, 7] = 1e9
    expected = keep_near(scene, 10, rule)
    scene.positions[:, 7] = np.nan
    np.testing.assert_array_equal(keep_near(scene, 10, rule), expected)
    assert 7 not in expected


@pytest.mark.parametrize("group", ["positions", "opacity", "log_scale"])
def test_nan_does_not_change_the_importance_of_others(group):
    scene = visible_scene(200, seed=18)
    getattr(scene, group)[0, 7] = np.nan
    others = np.delete(np.arange(200), 7)
    found = importance(scene, CAMERAS)
    expected = importance(scene.take(others), CAMERAS)
    np.testing.assert_allclose(found[others], expected, rtol=1e-3)  # its volume may count
    assert found[7] == 0


def test_rounds_beat_importance():
    scene = visible_scene(300, 117)
    targets = references(scene)
    kept, _ = prune_leave_one_out(scene, views_of(scene), Steps(prune=50))
    rival = keep_highest(importance(scene, CAMERAS), 150)
    assert targets.error(scene.take(kept)) < 0.5 * targets.error(scene.take(rival))


@pytest.mark.parametrize("limit", [0.05, 0.5, 3.0])
def test_the_loss_stays_within_the_limit_and_comes_near_it(limit):
    scene = visible_scene(300, 118)
    targets = references(scene)
    kept, _ = prune_leave_one_out(scene, views_of(scene), Steps(prune_max_psnr_drop=limit))
    before = targets.errors(scene)
    drop = targets.drop(targets.errors(scene.take(kept)), before)
    assert 0.3 * limit < drop <= limit


def test_a_limit_and_a_percentage_together():
    scene = visible_scene(300, 119)
    few, _ = prune_leave_one_out(scene, views_of(scene), Steps(prune=5, prune_max_psnr_drop=50.0))
    assert len(few) == 285
    both = Steps(prune=90, prune_max_psnr_drop=0.05)
    limited, _ = prune_leave_one_out(scene, views_of(scene), both)
    alone, _ = prune_leave_one_out(scene, views_of(scene), Steps(prune_max_psnr_drop=0.05))
    assert limited.tolist() == alone.tolist()


def test_progress_counts_every_rendered_view(monkeypatch):
    drawn: list[Camera] = []
    told: list[tuple[str, int, int]] = []

    def counted(scene, camera, *arguments, **options):
        drawn.append(camera)
        return render(scene, camera, *arguments, **options)

    monkeypatch.setattr(targets_module, "render", counted)
    scene, plan = visible_scene(300, 118), Plan(Steps(prune_max_psnr_drop=0.5), CAMERAS)
    prepare_scene(scene, plan, lambda *step: told.append(step))
    stages = [stage for stage, _, _ in told]
    assert len(drawn) == stages.count("draw") + stages.count("measure")
    assert {"draw", "measure", "leave-one-out, round 1"} <= set(stages)
    between = len(cameras_between(CAMERAS))
    assert between >= 2
    assert {total for _, _, total in told} == {len(CAMERAS), len(CAMERAS) + between}


def test_a_loss_limit_of_0_removes_only_invisible_gaussians():
    scene = visible_scene(200, 120)
    targets = references(scene)
    kept, _ = prune_leave_one_out(scene, views_of(scene), Steps(prune_max_psnr_drop=0.0))
    assert targets.error(scene.take(kept)) == 0
    assert len(kept) < 200


@pytest.mark.parametrize("name", edge_scenes())
def test_edge_scenes(name):
    scene = edge_scenes()[name]
    kept, _ = prune_leave_one_out(scene, views_of(scene), Steps(prune=40))
    assert len(kept) == scene.count - int(0.4 * scene.count + 1e-6)
    assert np.isfinite(importance(scene, CAMERAS)).all()

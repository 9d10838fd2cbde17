"""Refinement by gradients."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from gardens import CAMERAS, SCENE, changed, garden, psnr, refit, renders, views
from scenes import antialiased as compensated
from scenes import assert_same_floats, random_scene, shared_scene_path, with_threads
from splats import TEAL, real_cameras, render, splats, straight

from gs_codec.errors import InvalidInput
from gs_codec.formats.ply.file import read_ply
from gs_codec.preparation import adam
from gs_codec.preparation import optimise as module
from gs_codec.preparation.adam import adam_step, new_state, rig_radius
from gs_codec.rendering.frame import make_frame
from gs_codec.runtime.threads import using_threads
from gs_codec.scene import GROUPS, Scene

# Adam


@pytest.mark.parametrize("seed", [23])
def test_adam_is_that_of_the_paper(seed):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(5, 9)).astype(np.float32)
    rates = np.array([0.1, 0.01, 0.0, 1.0, 0.5])
    state, expected = new_state(values), values.astype(np.float64)
    first, second = np.zeros((2, 5, 9))
    for step in range(1, 20):
        slopes = rng.normal(size=(5, 9)) * (rng.random(9) < 0.6)
        by_gaussian = slopes.T.astype(np.float32)
        for start, stop in ((0, 4), (4, 9)):
            chosen = start + np.flatnonzero(slopes[0, start:stop])
            adam_step(*state, step, rates, by_gaussian[chosen], chosen, start, stop)
        first = 0.9 * first + 0.1 * slopes
        second = 0.999 * second + 0.001 * slopes**2
        mean, square = first / (1 - 0.9**step), second / (1 - 0.999**step)
        expected -= rates[:, None] * mean / (np.sqrt(square) + 1e-15)
    np.testing.assert_allclose(state.values.T, expected, rtol=1e-4, atol=1e-4)
    np.testing.assert_array_equal(state.values[:, 2], values[2])


def test_adam_leaves_values_finite():
    slopes = np.array([[np.nan, np.inf, -np.inf, 1e30, 1e14, -1e14, 1e-30, 0.0]], np.float32).T
    state = new_state(np.full((1, 8), 3e38, np.float32))
    for step in range(1, 4):
        adam_step(*state, step, np.array([3e38]), slopes, np.arange(8), 0, 8)
    for plane in state:
        assert np.isfinite(plane).all()


# Refitting


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [30, 31])
def test_refinement_recovers_most_of_the_loss(seed):
    original = garden(seed)
    targets = views(original, CAMERAS)
    scene = changed(original, seed)
    fitted, report = refit(200, scene, targets)
    before, after = psnr(scene, CAMERAS, targets), psnr(fitted, CAMERAS, targets)
    assert after > before + 5
    assert report["curve"][-1]["psnr"] > report["curve"][0]["psnr"] + 3
    assert (fitted.comments, fitted.count) == (scene.comments, scene.count)
    np.testing.assert_array_equal(fitted.extra["label"], scene.extra["label"])


@pytest.mark.one_in(3)
@pytest.mark.parametrize("scale", [0.02, 1e-3, 1e-4])
def test_steps_are_small_if_little_can_be_gained(scale):
    """Full steps would turn 45 dB into 42, and 65 dB as well."""
    original = garden(32)
    targets = views(original, CAMERAS)
    scene = changed(original, 32, scale)
    before = psnr(scene, CAMERAS, targets)
    assert psnr(refit(100, scene, targets)[0], CAMERAS, targets) > before + 0.5


def test_fitting_scenes_are_unchanged():
    fitted, _ = refit(10, SCENE, [make_frame(SCENE, c).draw_float32((0, 0, 0))[0] for c in CAMERAS])
    assert_same_floats(fitted, SCENE)


@pytest.mark.thorough
def test_a_pruned_real_scene_recovers_most_of_its_loss():
    scene = read_ply(shared_scene_path("bonsai/point_cloud.ply"))
    cameras = [camera.resized(100, 66) for camera in real_cameras()[::4]]
    weights = sum(render(scene, c, accumulate=True).accumulations.weight for c in cameras)
    targets = views(scene, cameras)
    pruned = scene.take(np.sort(np.argsort(-weights, kind="stable")[: scene.count // 6]))
    fitted, _ = refit(40, pruned, targets, cameras)
    assert psnr(fitted, cameras, targets) > psnr(pruned, cameras, targets) + 1.5


def test_threads_do_not_change_a_refit():
    expected, _ = with_threads(1, refit)
    for threads in (2, 3, None):
        assert_same_floats(with_threads(threads, refit)[0], expected)


class Watched(list):
    """Targets that record which were accessed."""

    def __init__(self, targets, seen: list[int]) -> None:
        super().__init__(targets)
        self.seen = seen

    def __getitem__(self, view):
        self.seen.append(view)
        return super().__getitem__(view)


def test_each_view_is_used_once_before_any_repeats():
    seen: list[int] = []
    fitted, _ = with_threads(1, lambda: refit(15, targets=Watched(renders(), seen)))
    for epoch in range(3):
        assert sorted(seen[5 * epoch : 5 * epoch + 5]) == list(range(5))
    assert seen[:5] != seen[5:10]
    assert_same_floats(fitted, refit(15)[0])


def test_inputs_are_not_modified():
    copies = {group: getattr(SCENE, group).copy() for group in GROUPS}
    targets = [target.copy() for target in renders()]
    fitted, _ = refit(targets=targets)
    np.testing.assert_array_equal(targets, renders())
    for group in GROUPS:
        np.testing.assert_array_equal(getattr(SCENE, group), copies[group])
        assert not np.shares_memory(getattr(fitted, group), getattr(SCENE, group))


def test_invisible_gaussians_are_unchanged():
    behind = splats([(0, 0, -50), (0, 90, 0)], f_rest=np.ones((9, 1)))
    planes = {group: np.hstack([getattr(SCENE, group), getattr(behind, group)]) for group in GROUPS}
    fitted, report = refit(scene=Scene(**planes))
    assert_same_floats(fitted.take(np.array([60, 61])), behind)
    assert 50 <= report["updated"] <= 60
    assert (fitted.positions[:, :60] != SCENE.positions).any()


@pytest.mark.parametrize("background", [(0, 0, 0), TEAL], ids=["black", "teal"])
def test_extreme_gaussians_stay_finite(background):
    scene = changed(garden(6), 6)
    scene.log_scale[:, 3] = [20, 80, -1e30]
    scene.log_scale[:, 4] = 12
    scene.opacity[:, 5] = 1e30
    scene.f_dc[:, 6] = 3e38
    scene.f_dc[:, 7] = -3e38
    scene.rot[:, 8] = 0
    scene.rot[:, 9] = 1e-38
    scene.positions[:, 10] = 3e38
    fitted, _ = refit(20, scene, background=background)
    for group in GROUPS:
        assert np.isfinite(getattr(fitted, group)).all(), group


def test_nan_gaussians_are_unchanged():
    scene = changed(garden(7), 7)
    scene.positions[0, 3] = np.nan
    scene.f_rest[2, 4] = np.inf
    fitted, _ = refit(scene=scene)
    assert_same_floats(fitted.take(np.array([3, 4])), scene.take(np.array([3, 4])))
    assert np.isfinite(fitted.opacity).all()


@pytest.mark.thorough
@pytest.mark.parametrize("sh_degree", range(4))
@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_gaussians_of_any_degree_are_refitted(count, sh_degree):
    fitted, report = refit(3, random_scene(count, sh_degree))
    assert (fitted.count, fitted.sh_degree, report["iterations"]) == (count, sh_degree, 3)


def test_no_iterations_change_nothing():
    fitted, report = refit(0)
    assert_same_floats(fitted, SCENE)
    assert report == {"iterations": 0, "updated": 0, "seconds": 0.0, "curve": []}


def test_rates_decay_and_are_set_by_group(monkeypatch):
    fitted, _ = refit(1)
    for group in GROUPS:
        change = np.abs(getattr(fitted, group) - getattr(SCENE, group)).max()
        unit = rig_radius(CAMERAS) if group == "positions" else 1.0
        assert change == pytest.approx(adam.RATES[group] * unit, rel=5e-3)
    expected, _ = refit(8)
    monkeypatch.setattr(module, "LAST", 1.0)
    assert not np.array_equal(refit(8)[0].f_dc, expected.f_dc)


def test_the_radius_of_a_rig_is_that_of_the_trainer():
    cameras = [straight(position=p) for p in [(0, 0, 0), (4, 0, 0), (2, 3, 0)]]
    assert rig_radius(cameras) == pytest.approx(1.1 * np.hypot(2, 1))
    assert rig_radius(cameras[:1]) == 0


def test_progress_and_report_count_iterations():
    steps: list[tuple] = []
    _, report = refit(7, progress=lambda *step: steps.append(step))
    assert steps == [("optimise", i, 7) for i in range(1, 8)]
    assert [point["iteration"] for point in report["curve"]] == list(range(1, 8))
    assert report["seconds"] == report["curve"][-1]["seconds"] > 0


def test_the_expected_time_is_announced(monkeypatch, caplog):
    caplog.set_level("INFO", logger=module.__name__)  # commands of other tests set it, too
    expected, _ = refit(4)
    assert not caplog.text
    monkeypatch.setattr(module, "_ANNOUNCED", 4)
    assert_same_floats(refit(4)[0], expected)
    assert "refine: 4 iterations, about 1 second" in caplog.text
    assert module._announcement(2000, 0.061) == "refine: 2,000 iterations, about 2 minutes"
    assert module._announcement(1, 40.0) == "refine: 1 iteration, about 40 seconds"


# Checkpoints


class Stop(Exception):
    pass


def stopped_at(iteration: int):
    def progress(_stage: str, done: int, _total: int) -> None:
        if done == iteration:
            raise Stop

    return progress


def test_an_interrupted_refinement_is_resumed(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_CHECKPOINT_EVERY", 4)
    path = tmp_path / "refit.npz"
    options = {"checkpoint": path}
    expected, whole = refit(18)
    for iteration in (3, 6, 15):
        with pytest.raises(Stop):
            refit(18, **options, progress=stopped_at(iteration))
    looked: list[int] = []
    with using_threads(1):
        fitted, report = refit(18, **options)
    assert_same_floats(fitted, expected)
    assert [p["psnr"] for p in report["curve"]] == [p["psnr"] for p in whole["curve"]]
    assert report["updated"] == whole["updated"]

    again, _ = refit(18, **options, targets=Watched(renders(), looked))
    assert_same_floats(again, expected)
    assert looked == []
    assert [p.name for p in tmp_path.iterdir()] == ["refit.npz"]


def test_a_checkpoint_of_other_inputs_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "refit.npz"
    refit(2, checkpoint=path)
    moved = [replace(CAMERAS[0], fx=41.0), *CAMERAS[1:]]
    for change in (
        {"iterations": 3},
        {"scene": garden(1)},
        {"scene": SCENE.take(np.arange(59))},
        {"targets": renders()[::-1]},
        {"cameras": moved},
        {"background": TEAL},
        {"scene": compensated(SCENE)},
    ):
        with pytest.raises(InvalidInput, match=r"refit\.npz: checkpoint of another scene"):
            refit(**({"iterations": 2, "checkpoint": path} | change))
    with_threads(1, partial(refit, 2, checkpoint=path))
    monkeypatch.setitem(module.RATES, "rot", 2e-3)
    with pytest.raises(InvalidInput, match="checkpoint of another"):
        refit(2, checkpoint=path)


def test_a_damaged_checkpoint_is_refused(tmp_path):
    path = tmp_path / "refit.npz"
    expected, _ = refit(2, checkpoint=path)
    whole = path.read_bytes()
    rng = np.random.default_rng(8)
    cut = [0, 1, 100, len(whole) // 2, len(whole) - 1]
    damaged = [whole[:size] for size in cut] + [b"no archive", whole[1:]]
    for place in rng.integers(0, len(whole), 60):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << int(rng.integers(0, 8))
        damaged.append(bytes(flipped))
    refused = []
    for data in damaged:
        path.write_bytes(data)
        try:
            # A bit flip in unused parts of the archive, such as a date, is harmless.
            assert_same_floats(refit(2, checkpoint=path)[0], expected)
        except InvalidInput as error:
            refused.append(str(error))
    assert len(refused) > 55
    assert all(line.startswith(f"{path}: ") and "\n" not in line for line in refused)


@pytest.mark.parametrize("name", ["", "missing/refit.npz"], ids=["folder", "no folder"])
def test_a_checkpoint_that_cannot_be_written_is_refused_at_once(tmp_path: Path, name):
    with pytest.raises(InvalidInput):
        refit(10**6, checkpoint=tmp_path / name)


# Refused inputs


def test_images_with_nan_are_refused():
    first, second, *others = renders()
    with pytest.raises(InvalidInput, match=r"image of 'view 1': not finite"):
        refit(targets=[first, second * np.nan, *others])

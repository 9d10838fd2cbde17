"""Preparation as a whole: order of steps, labels, reports, files and the command line."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scenes import random_scene
from typer.testing import CliRunner

import gs_codec
from gs_codec.cameras.camera import Camera
from gs_codec.cameras.image_files import read_image, write_png
from gs_codec.cli.main import app
from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.config import Config
from gs_codec.encoding.order import encode
from gs_codec.encoding.request import Request
from gs_codec.errors import InvalidInput
from gs_codec.files.encode_file import encode_file
from gs_codec.files.preparing import prepare_file
from gs_codec.files.scenes import read_scene
from gs_codec.formats.coordinates import turn_axes
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import write_ply
from gs_codec.metrics.image_quality import compare_images
from gs_codec.metrics.views import compare_views
from gs_codec.plan import Steps
from gs_codec.preparation import optimise, pipeline, reference_views, view_selection
from gs_codec.preparation.likely_views import cameras_between
from gs_codec.preparation.pipeline import Plan, prepare_scene
from gs_codec.preparation.prepare_report import LABELS, centres_checksum
from gs_codec.preparation.reference_views import draw_reference_views, evenly
from gs_codec.preparation.view_selection import choose_views
from gs_codec.rendering.renderer import render
from gs_codec.scene import GROUPS, Scene


def camera(name: str, x: float, split=None) -> Camera:
    position = np.array([x, 0.0, -4.0])
    return Camera(name, 48, 32, 45.0, 45.0, 24.0, 16.0, np.eye(3), position, split)


CAMERAS = [
    camera("a", -0.8, "train"),
    camera("b", -0.4, "test"),
    camera("c", 0.0, "train"),
    camera("d", 0.5, "train"),
]


@pytest.fixture(scope="module")
def scene() -> Scene:
    base = random_scene(400, 1, seed=130)
    sizes = np.random.default_rng(130).normal(-2.3, 0.4, (3, 400)).astype(np.float32)
    return replace(base, log_scale=sizes)


PAPER = Config("paper-m")

#: Fewer cameras than the guiding views, so views between them are added.
BETWEEN = ["a to c", "a to d", "c to d"]


def plan(**steps) -> Plan:
    return Plan(Steps(**steps), CAMERAS)


# Steps


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ({"prune_geometry": -1}, "prune_geometry -1: expected 0 to below 100"),
        ({"prune_importance": 100}, "prune_importance 100: expected 0 to below 100"),
        ({"prune": float("nan")}, "prune nan"),
        ({"prune": 0.5}, "expected percent, such as 50 for half"),
        ({"prune_max_psnr_drop": -0.1}, "prune_max_psnr_drop -0.1"),
        ({"refine": -2}, "refine -2"),
        ({"refit_colour": -1}, "refit_colour -1"),
        ({"compact_sh": -0.1}, "compact_sh -0.1"),
    ],
)
def test_steps_out_of_range(steps, message):
    with pytest.raises(InvalidInput, match=message):
        Steps(**steps)


def test_plans_that_contradict_themselves():
    with pytest.raises(InvalidInput, match="width: cannot be combined with ground-truth images"):
        Plan(Steps(), gt_images="images", width=100)
    with pytest.raises(InvalidInput, match="views 0: expected at least 1"):
        Plan(Steps(), views=0)


def test_labels_give_the_reason_for_each_gaussian(scene):
    steps = {"prune_importance": 20, "prune_geometry": 2, "prune": 25}
    result, report = prepare_scene(scene, plan(**steps))
    assert report.labels.shape == (400,)
    assert report.labels.dtype == np.uint8
    kept = np.flatnonzero(report.labels == 0)
    for group in GROUPS:
        np.testing.assert_array_equal(getattr(result, group), getattr(scene, group)[:, kept])
    assert report.removed["importance"] == 80
    left = 320
    for _ in range(3):
        left -= int(left * 0.02)
    assert report.removed["geometry"] == 320 - left
    assert report.removed["leave-one-out"] == left // 4
    # The same, step by step.
    stage, origin = scene, np.arange(400)
    for name, value in steps.items():
        stage, single = prepare_scene(stage, plan(**{name: value}))
        gone = origin[single.labels > 0]
        label = {"prune_geometry": "geometry", "prune_importance": "importance"}.get(name)
        if label:
            assert (report.labels[gone] == LABELS.index(label)).all()
            origin = origin[single.labels == 0]


def test_quality_is_measured_in_held_out_views(scene):
    result, report = prepare_scene(scene, plan(prune_importance=50))
    assert [c.name for c in report.views.held_out.cameras] == ["b"]
    assert [c.name for c in report.views.renders.cameras] == ["a", "c", "d", *BETWEEN]
    first, last = report.steps
    assert (first.name, first.count, first.quality.psnr) == ("original", 400, np.inf)
    images = [render(s, CAMERAS[1]).colour for s in (result, scene)]
    assert (last.name, last.count) == ("importance pruning", 200)
    assert last.quality == compare_images(*images)
    assert last.size_bytes == result.float_bytes


def test_unmarked_cameras_guide_and_measure(scene):
    unmarked = [replace(c, split=None) for c in CAMERAS]
    _, report = prepare_scene(scene, Plan(Steps(rectify=7.5), unmarked, views=2))
    assert report.views.held_out is report.views.renders
    assert [c.name for c in report.views.renders.cameras] == ["a", "d"]


def test_photographs_are_targets_if_available(scene, tmp_path):
    for name in ("b", "c"):
        write_png(tmp_path / f"{name}.png", np.full((16, 24, 3), 0.4))
    chosen = Plan(Steps(prune=10), CAMERAS, gt_images=tmp_path)
    _, report = prepare_scene(scene, chosen)
    assert [c.name for c in report.views.renders.cameras] == ["a", "c", "d", *BETWEEN]
    assert [c.name for c in report.views.references.cameras] == ["c"]
    assert report.views.references.cameras[0].width == 24
    assert report.views.held_out.photographs
    image = render(scene, CAMERAS[1].resized(24, 16)).colour
    expected = compare_images(image, read_image(tmp_path / "b.png"))
    assert report.steps[0].quality == expected
    (tmp_path / "b.png").unlink()
    with pytest.raises(InvalidInput, match="no image of 1 camera"):
        prepare_scene(scene, chosen)


def test_views_that_only_guide_the_encoder_are_not_rendered_beforehand(scene):
    views = choose_views(scene, Plan(Steps(), CAMERAS[1:2]))
    assert not views.renders.images
    assert not views.held_out.images
    other = scene.take(np.arange(1, scene.count))
    found = views.held_out.errors(other)
    assert found.all()
    np.testing.assert_array_equal(found, views.held_out.drawn().errors(other))
    assert choose_views(scene, Plan(Steps(prune=10), CAMERAS)).renders.images


def test_refinement_fits_photographs_and_renders_of_the_other_cameras(scene, tmp_path):
    for name in ("b", "c"):
        write_png(tmp_path / f"{name}.png", np.full((16, 24, 3), 0.4))
    chosen = Plan(Steps(refine=1), CAMERAS, gt_images=tmp_path, views=1)
    views = choose_views(scene, chosen)
    targets = views.targets
    assert [c.name for c in targets.cameras] == ["c", "a", "d"]
    np.testing.assert_array_equal(targets.images[0], read_image(tmp_path / "c.png"))
    expected = render(scene, CAMERAS[3].resized(24, 16)).colour
    # Rendered in float32: a pixel may be on the other side of the alpha threshold.
    assert np.abs(targets.images[2] - expected).mean() < 1e-5
    views = choose_views(scene, replace(chosen, gt_images=None))
    assert [c.name for c in views.targets.cameras] == ["a", "c", "d", *BETWEEN]
    assert len(views.renders.cameras) == 1


def test_views_of_large_cameras_are_drawn_smaller(scene, monkeypatch):
    monkeypatch.setattr(view_selection, "MOST_PIXELS", 1000)
    small = [camera(f"{i}", 0.1 * i).resized(36, 24) for i in range(3)]
    large = [*small, camera("large", 0.3).resized(480, 320)]
    views = choose_views(scene, Plan(Steps(prune=10), large))
    assert [(c.width, c.height) for c in views.renders.cameras[:4]] == 3 * [(36, 24)] + [(38, 25)]
    assert views.renders.cameras[3].fx == pytest.approx(45 * 38 / 48)
    guiding = view_selection.guiding_views(scene, Plan(Steps(), large))
    assert max(c.width for c in guiding.cameras) == 38
    guiding = view_selection.guiding_views(scene, Plan(Steps(), large, width=96))
    assert {c.width for c in guiding.cameras} == {96}


def test_large_photographs_are_reduced(scene, tmp_path, monkeypatch):
    large = [camera("large", 0.1).resized(145, 97)]
    image = render(scene, large[0], device="cpu").colour
    write_png(tmp_path / "large.png", image)
    plan = Plan(Steps(prune=10), large, gt_images=tmp_path)
    whole = choose_views(scene, plan).photographs
    monkeypatch.setattr(reference_views, "MOST_PIXELS", 1600)
    views = choose_views(scene, plan)
    for photographs in (views.photographs, views.held_out):
        (small,) = photographs.cameras
        assert (small.width, small.height) == (48, 32)
        assert photographs.images[0].shape == (32, 48, 3)
    seen, away = (
        np.abs(photographs.images[0] - render(scene, view, device="cpu").colour).mean()
        for view in (small, replace(small, cx=small.cx + 0.5))
    )
    assert seen < 0.75 * away
    assert np.allclose(photographs.images[0][5, 7], whole.images[0][15:18, 21:24].mean(axis=(0, 1)))


def test_renders_beside_photographs_are_drawn_smaller(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(view_selection, "MOST_PIXELS", 1000)
    cameras = [camera("small", 0.0).resized(36, 24), camera("large", 0.2).resized(480, 320)]
    cameras.append(camera("test", 0.1, "test").resized(36, 24))
    for name in ("small", "test"):
        write_png(tmp_path / f"{name}.png", np.full((24, 36, 3), 0.4))
    targets = choose_views(scene, Plan(Steps(refine=1), cameras, gt_images=tmp_path)).targets
    assert [(c.name, c.width) for c in targets.cameras] == [("small", 36), ("large", 38)]


def test_a_photograph_may_be_of_no_camera_that_refinement_draws(scene, tmp_path, caplog):
    cameras = [camera(f"{i}", 0.1 * i, "train") for i in range(9)]
    for name in ("1", "b"):
        write_png(tmp_path / f"{name}.png", np.full((16, 24, 3), 0.4))
    chosen = Plan(Steps(refine=1), [*cameras, CAMERAS[1]], gt_images=tmp_path, views=1)
    targets = choose_views(scene, chosen).targets
    assert [c.name for c in targets.cameras] == [*"10", "3", "5", "8"]
    assert {c.width for c in targets.cameras} == {24}
    assert caplog.messages == [f"{tmp_path}: photographs of 1 of 9 cameras"]


def test_masks_beside_photographs_are_named(scene, tmp_path, caplog):
    for folder in ("images", "masks"):
        (tmp_path / folder).mkdir()
        write_png(tmp_path / folder / "b.png", np.full((16, 24, 3), 0.6))
    images, masks = tmp_path / "images", tmp_path / "masks"
    choose_views(scene, Plan(Steps(), [CAMERAS[1]], gt_images=images))
    compare_views(scene, scene, [CAMERAS[1]], truth=images)
    text = f"{masks}: left out: masks; all pixels of the photographs count"
    assert caplog.messages == [text, text]
    compare_views(scene, scene, [CAMERAS[1]], truth=images, masks=masks)
    assert caplog.messages == [text, text]
    (images / "masks").mkdir()
    (tmp_path / "unmasked").mkdir()
    other = masks.rename(tmp_path / "sky_Mask_2")
    compare_views(scene, scene, [CAMERAS[1]], truth=images)
    assert caplog.messages[2:] == [text.replace(str(masks), str(other))]


@pytest.mark.parametrize(("photographs", "between"), [(9, 3), (5, 1), (2, 0)])
def test_a_third_as_many_views_between_cameras_as_photographs(
    scene, tmp_path, photographs, between
):
    cameras = [camera(f"{i}", 0.1 * i, "train") for i in range(9)]
    held_out = camera("out", 0.05, "test")
    for each in [held_out, *cameras[:photographs]]:
        write_png(tmp_path / f"{each.name}.png", np.full((32, 48, 3), 0.4))
    chosen = Plan(Steps(refine=1), [*cameras, held_out], gt_images=tmp_path)
    names = [c.name for c in choose_views(scene, chosen).targets.cameras]
    assert names[:9] == [f"{i}" for i in range(9)]
    assert len(names) == 9 + between
    assert all(" to " in name for name in names[9:])


@pytest.mark.parametrize("steps", [Steps(prune=10), Steps(refine=1)])
def test_pruning_sees_all_views_between_few_cameras(scene, steps):
    cameras = [camera(f"{i}", 0.1 * i) for i in range(9)]
    chosen = Plan(Steps(), [*cameras, camera("out", 0.05, "test")], views=10)
    assert len(choose_views(scene, chosen).renders.cameras) == 9 + 4
    renders = choose_views(scene, replace(chosen, steps=steps)).renders
    assert len(renders.cameras) == 9 + len(cameras_between(cameras))


@pytest.mark.parametrize(("megabytes", "number"), [(1000, 11), (6, 5), (0, 2)])
def test_refinement_fits_as_many_views_as_memory_holds(scene, monkeypatch, megabytes, number):
    monkeypatch.setattr(view_selection, "_TARGET_BYTES", megabytes << 20)
    wide = [camera(f"{i}", 0.1 * i).resized(350, 250) for i in range(9)]
    views = choose_views(scene, Plan(Steps(refine=1), wide, views=2))
    assert len(views.targets.cameras) == number


@pytest.mark.thorough
def test_refinement_keeps_every_eighth_of_unmarked_cameras_out(scene, caplog, tmp_path):
    unmarked = [camera(f"{i}", 0.1 * i) for i in range(10)]
    views = choose_views(scene, Plan(Steps(refine=1), unmarked))
    assert "every 8th is held out" in caplog.text
    assert [c.name for c in views.held_out.cameras] == ["0", "8"]
    assert [c.name for c in views.targets.cameras[:8]] == [*"1234567", "9"]
    caplog.clear()
    choose_views(scene, Plan(Steps(refine=1), "auto", views=4))
    assert "every 8th" not in caplog.text
    views = choose_views(scene, Plan(Steps(refine=1), unmarked[:1]))
    assert views.targets.cameras == views.held_out.cameras
    for name in ("3", "5"):
        write_png(tmp_path / f"{name}.png", np.full((32, 48, 3), 0.4))
    views = choose_views(scene, Plan(Steps(refine=1), unmarked, gt_images=tmp_path))
    assert [c.name for c in views.held_out.cameras] == ["3"]
    assert views.targets.cameras[0].name == "5"


def test_the_only_photograph_is_not_held_out(scene, tmp_path):
    unmarked = [replace(each, split=None) for each in CAMERAS]
    write_png(tmp_path / f"{unmarked[1].name}.png", np.full((32, 48, 3), 0.4))
    views = choose_views(scene, Plan(Steps(), unmarked, gt_images=tmp_path, holds_out=True))
    assert views.photographs is views.held_out
    assert [c.name for c in views.held_out.cameras] == [unmarked[1].name]


def test_views_are_evenly_spaced():
    assert evenly(CAMERAS, 2) == [CAMERAS[0], CAMERAS[3]]
    assert evenly(CAMERAS, 9) == CAMERAS
    assert evenly(CAMERAS, 1) == CAMERAS[:1]


def test_drop_of_photographs_and_of_own_renders(scene):
    own = draw_reference_views(scene, CAMERAS, (0.0, 0.0, 0.0))
    assert own.error(scene) == 0
    assert own.drop(1e-3, 0.0) == pytest.approx(10 * np.log10(2))
    real = replace(own, photographs=True)
    assert real.drop(2e-3, 1e-3) == pytest.approx(10 * np.log10(2))
    views = np.array([2e-3, 8e-3]), np.array([1e-3, 1e-3])
    assert real.drop(*views) == pytest.approx(10 * np.log10(4))  # the mean is over decibels


def test_nan_is_refused_before_the_steps(scene, monkeypatch):
    damaged = replace(scene, opacity=scene.opacity.copy())
    damaged.opacity[0, 7] = np.nan
    monkeypatch.setattr("gs_codec.preparation.pipeline.prepare_scene", None)
    with pytest.raises(InvalidInput, match="not finite: 1 in opacity"):
        encode(damaged, Request(Config(), plan(prune=10)))


def test_rectification_clips_values_out_of_range(scene):
    outlier = scene.f_rest.copy()
    outlier[2, 5], outlier[4] = 40.0, 0.5
    wild = replace(scene, f_rest=outlier)
    result, report = prepare_scene(wild, plan(rectify=5.0))
    others = np.delete(np.arange(wild.count), 7)
    damaged = replace(wild, f_rest=wild.f_rest.copy())
    damaged.f_rest[:, 7] = np.nan
    np.testing.assert_array_equal(
        prepare_scene(damaged, plan(rectify=5.0))[0].f_rest[:, others],
        prepare_scene(wild.take(others), plan(rectify=5.0))[0].f_rest,
    )
    medians = np.quantile(outlier, 0.5, axis=1, method="lower", keepdims=True)
    offsets = np.abs(outlier.astype(np.float64) - medians)
    off_centre = np.maximum(np.count_nonzero(offsets, axis=1, keepdims=True), 1)
    reach = 5 * offsets.sum(axis=1, keepdims=True) / off_centre
    np.testing.assert_allclose(
        result.f_rest, np.clip(outlier, medians - reach, medians + reach), atol=1e-6
    )
    assert report.steps[-1].details == {"moved": np.count_nonzero(result.f_rest != outlier)}
    assert 0 < result.f_rest[2, 5] < 40
    assert not report.labels.any()


@pytest.mark.parametrize("scales", [2.0, 7.5])
def test_rectification_equals_that_of_coding(scene, scales):
    """Rectifying a scene first gives the same result as rectifying in the encoder."""
    config = replace(PAPER, laplace_scales=scales)
    coded = decode_scene(encode_scene(scene, config)[0])
    limits = np.abs(coded.f_rest).max(axis=1)
    rectified, _ = prepare_scene(scene, plan(rectify=scales))
    np.testing.assert_allclose(np.abs(rectified.f_rest).max(axis=1), limits, rtol=0.15)
    wide = decode_scene(encode_scene(rectified, replace(PAPER, laplace_scales=1000.0))[0])
    np.testing.assert_allclose(np.abs(wide.f_rest).max(axis=1), limits, rtol=0.15)


def test_all_steps_run_in_order(scene):
    steps = {
        "prune_geometry": 1, "prune_importance": 10, "prune": 20, "refine": 6,
        "compact_sh": 3e-5, "refit_colour": 3, "rectify": 7.5,
    }  # fmt: skip
    result, report = prepare_scene(scene, plan(**steps))
    assert [step.name for step in report.steps] == [
        "original", "importance pruning", "geometry pruning", "leave-one-out pruning",
        "rectification", "optimisation", "SH compaction", "colour refit",
    ]  # fmt: skip
    assert report.steps[-1].count == result.count == (report.labels == 0).sum()
    assert result.sh_degree == 1
    assert json.loads(json.dumps(report.as_dict(), allow_nan=False))


def test_refinement_recovers_the_pruning_loss(scene):
    pruned, before = prepare_scene(scene, plan(prune_importance=70))
    assert before.views.renders.error(pruned) > 0
    for steps in ({"refit_colour": 6}, {"refine": 60}):
        _, after = prepare_scene(scene, plan(prune_importance=70, **steps))
        assert after.steps[-1].quality.psnr > before.steps[-1].quality.psnr + 0.5, steps


def test_compaction_saves_bits_within_its_allowed_cost(scene):
    compact, report = prepare_scene(scene, plan(compact_sh=1e-4))
    assert (compact.f_rest == 0).mean() > (scene.f_rest == 0).mean() + 0.2
    assert report.steps[-1].quality.psnr > 30


def test_optimisation_resumes_from_its_checkpoint(scene, tmp_path):
    chosen = replace(plan(prune=90, refine=30), checkpoint=tmp_path / "state")
    first, report = prepare_scene(scene, chosen)
    assert report.steps[-1].quality.psnr > report.steps[-2].quality.psnr
    again, _ = prepare_scene(scene, chosen)
    for group in GROUPS:
        np.testing.assert_array_equal(getattr(first, group), getattr(again, group))
    with pytest.raises(InvalidInput, match="state"):
        prepare_scene(scene, replace(chosen, steps=Steps(prune=90, refine=31)))


@pytest.mark.parametrize(("least", "iterations"), [(20, 90), (100, 100)])
def test_refinement_looks_at_each_image_as_often_as_pays(scene, monkeypatch, least, iterations):
    monkeypatch.setattr(pipeline, "_LEAST", least)
    _, report = prepare_scene(scene, plan(prune=90, refine=-1))
    # Three cameras, and three views between them.
    assert report.steps[-1].details["iterations"] == iterations


def test_refinement_is_skipped_if_nothing_can_be_gained(scene, caplog):
    same, report = prepare_scene(scene, plan(prune=0, refine=5))
    assert same is scene
    assert report.steps[-1].details["left_out"]
    assert report.steps[-1].details["iterations"] == 0
    assert "refine: skipped, because there is nothing to gain" in caplog.text


def test_refinement_that_worsens_held_out_views_is_rejected(scene, caplog, monkeypatch):
    monkeypatch.setattr(optimise, "_SHARE", 1e9)
    _, report = prepare_scene(scene, plan(prune=30, refine=5))
    pruned, refined = report.steps[-2:]
    assert refined.details["left_out"]
    assert refined.quality == pruned.quality
    assert "refine: skipped, because held-out views would lose " in caplog.text


def test_refinement_that_worsens_held_out_views_is_kept_on_request(scene, caplog, monkeypatch):
    monkeypatch.setattr(optimise, "_SHARE", 1e9)
    _, report = prepare_scene(scene, plan(prune=30, refine=5, keep_refined=True))
    pruned, refined = report.steps[-2:]
    assert "left_out" not in refined.details
    assert refined.quality.psnr < pruned.quality.psnr
    assert "would lose" not in caplog.text


def test_steps_that_need_views_refuse_an_empty_scene():
    with pytest.raises(InvalidInput, match="no view shows anything"):
        prepare_scene(random_scene(0), Plan(Steps(prune=10)))


def test_the_input_is_not_changed(scene):
    before = {group: getattr(scene, group).copy() for group in GROUPS}
    prepare_scene(scene, plan(prune=20, rectify=7.5))
    for group, plane in before.items():
        np.testing.assert_array_equal(getattr(scene, group), plane)


# Files


@pytest.fixture
def folder(scene, tmp_path):
    write_ply(tmp_path / "scene.ply", scene)
    entries = [
        {
            "img_name": c.name, "width": 48, "height": 32, "fx": 45.0, "fy": 45.0,
            "position": c.position.tolist(), "rotation": np.eye(3).tolist(), "split": c.split,
        }
        for c in CAMERAS
    ]  # fmt: skip
    (tmp_path / "cameras.json").write_text(json.dumps(entries))
    return tmp_path


def test_report_files(folder, scene):
    chosen = Plan(Steps(prune=30), folder / "cameras.json")
    target, where = folder / "out.ply", folder / "new" / "r"
    report = prepare_file(folder / "scene.ply", target, chosen, PAPER, report_folder=where)
    labels = np.load(folder / "new" / "r" / "labels.npy")
    np.testing.assert_array_equal(labels, report.labels)
    saved = json.loads((folder / "new" / "r" / "report.json").read_text())
    assert (saved["input_gaussians"], saved["gaussians"]) == (400, 280)
    assert saved["centres_crc32c"] == centres_checksum(scene.positions) != 0
    turned = turn_axes(scene, "LUF").positions, turn_axes(scene, "RFU").positions
    assert {centres_checksum(each) for each in turned} == {saved["centres_crc32c"]}
    assert centres_checksum(scene.positions[:, ::-1]) != saved["centres_crc32c"]
    assert saved["removed"] == {"geometry": 0, "importance": 0, "leave-one-out": 120}
    assert saved["steps"][0]["quality"]["psnr"] is None
    table = (folder / "new" / "r" / "ablation.md").read_text().splitlines()
    names = [line.split("|")[1].strip() for line in table]
    coding = ["quantisation", "entropy coding", "geometry coding"]
    assert names == ["step", "---", "original", "leave-one-out pruning", *coding]
    assert read_ply(folder / "out.ply").count == 280


def test_stages_of_coding_add_up(folder):
    chosen = Plan(Steps(prune=30), folder / "cameras.json")
    report = prepare_file(folder / "scene.ply", folder / "out.egs", chosen, config=PAPER)
    quantised, coded, whole = report.steps[-3:]
    bits = 3 * 16 + 3 * 8 + 8 + 3 * 8 + 4 * 8 + 9 * 4
    assert quantised.size_bytes == 280 * bits / 8
    assert whole.size_bytes == (folder / "out.egs").stat().st_size
    sizes = {s.name: s.bytes for s in inspect_bytes((folder / "out.egs").read_bytes()).streams}
    packed = 280 * (3 * 16 + 3 * 8) / 8
    assert coded.size_bytes == whole.size_bytes - sizes["geometry"] - sizes["sh-dc"] + packed
    decoded = read_scene(folder / "out.egs")
    image = render(decoded, CAMERAS[1]).colour
    expected = compare_images(image, render(read_ply(folder / "scene.ply"), CAMERAS[1]).colour)
    assert quantised.quality == coded.quality == whole.quality == expected


def test_encode_prepares_first(folder):
    chosen = Plan(Steps(prune=30), folder / "cameras.json")
    report = encode_file(folder / "scene.ply", folder / "a.egs", Config("paper-s"), chosen)
    assert report.count == 280
    prepare_file(folder / "scene.ply", folder / "b.ply", chosen)
    encode_file(folder / "b.ply", folder / "b.egs", Config("paper-s"))
    assert (folder / "a.egs").read_bytes() == (folder / "b.egs").read_bytes()


def test_python_api(folder, scene):
    cloud = gs_codec.read(folder / "scene.ply")
    plan = Plan(Steps(prune_importance=50), CAMERAS)
    result, report = gs_codec.prepare(cloud, plan)
    assert len(result.point.positions) == 200
    assert report.removed["importance"] == 200
    prepare_file(folder / "scene.ply", folder / "out.ply", plan)
    again = gs_codec.read(folder / "out.ply")
    np.testing.assert_array_equal(again.point.f_dc.numpy(), result.point.f_dc.numpy())
    data = gs_codec.encode(cloud, PAPER, plan)
    encode_file(folder / "scene.ply", folder / "a.egs", PAPER, plan)
    assert inspect_bytes(data).streams == inspect_bytes((folder / "a.egs").read_bytes()).streams


# The command line


def run(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def test_prepare_prints_removed_gaussians_and_the_table(folder):
    options = ["--prune", 20, "--prune-geometry", 1, "--cameras", folder / "cameras.json"]
    result = run("prepare", folder / "scene.ply", folder / "out.ply", *options)
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert lines[0].startswith("pruned by geometry: ")
    assert lines[1].startswith("pruned by leave-one-out: ")
    assert lines[1].endswith(" of 400")
    assert lines[2].split() == ["step", "Gaussians", "MB", "PSNR", "dB", "SSIM", "s"]
    assert lines[-2].startswith("coding (m)")
    assert lines[-1].startswith("rendered views: ")
    result = run("prepare", folder / "scene.ply", folder / "p.ply", *options, "-p", "paper-s")
    assert result.stdout.splitlines()[-2].startswith("geometry coding")


@pytest.mark.parametrize("profile", [None, "s", "paper-s", "lossless"])
def test_prepared_scene_is_coded_like_by_encode(folder, profile):
    options = ["--prune", 20, "--cameras", folder, *(["-p", profile] if profile else [])]
    for command in ("prepare", "encode"):
        result = run(command, folder / "scene.ply", folder / f"{command}.egs", *options)
        assert result.exit_code == 0, result.output
    data = (folder / "prepare.egs").read_bytes()
    assert data == (folder / "encode.egs").read_bytes()
    assert inspect_bytes(data).profile == (profile or "m")


@pytest.mark.parametrize(
    "command", ["encode scene.ply o.egs", "prepare scene.ply o.ply --rectify 7"]
)
def test_errors_name_their_file(folder, monkeypatch, command):
    monkeypatch.chdir(folder)
    (folder / "broken").mkdir()
    for entry in json.loads((folder / "cameras.json").read_text()):
        (folder / "broken" / f"{entry['img_name']}.png").write_bytes(b"no image")
    for options, begin in (
        ("--cameras none.json", "none.json: no such file"),
        ("--cameras scene.ply", "scene.ply: "),
        ("--cameras cameras.json --prune 10 --gt-images none", "none: no such folder"),
        ("--cameras cameras.json --prune 10 --gt-images broken", "broken/"),
    ):
        error = str(run(*command.split(), *options.split()).exception)
        assert error.startswith(begin)
        assert "scene.ply: " not in error.removeprefix(begin)


def test_prepare_as_json(folder):
    options = ["--prune-importance", 25, "--cameras", folder, "--json"]
    result = run("prepare", folder / "scene.ply", folder / "out.egs", *options)
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout, parse_constant=pytest.fail)
    assert (report["input_gaussians"], report["gaussians"]) == (400, 300)
    assert inspect_bytes((folder / "out.egs").read_bytes()).count == 300


def test_encode_with_steps(folder):
    views = ["--cameras", folder, "--json"]
    prune = ["--prune-max-psnr-drop", 0.1, "--report", folder / "r"]
    result = run("prepare", folder / "scene.ply", folder / "a.egs", *prune, *views)
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["gaussians"] < 400
    assert (folder / "r" / "labels.npy").exists()
    result = run("encode", folder / "scene.ply", folder / "b.egs", "--prune", 10, *views)
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["gaussians"] == 360


REFUSALS = {
    "no step": ("prepare scene.ply out.ply", "no step of preparation given"),
    "suffix": (
        "prepare scene.ply out.txt --rectify 7",
        "suffix '.txt', expected .egs, .spz, ",
    ),
    "itself": ("prepare scene.ply scene.ply --rectify 7", "input and output are the same file"),
    "fraction": ("prepare scene.ply o.ply --prune 0.3", "expected percent, such as 50 for half"),
    "cameras": ("prepare scene.ply o.ply --rectify 7 --cameras none", "none: no such file"),
    "photographs": (
        "prepare scene.ply o.ply --rectify 7 --cameras cameras.json --gt-images none --report r",
        "none: no such folder",
    ),
    "report": ("prepare scene.ply o.ply --rectify 7 --report scene.ply", "scene.ply: "),
    "checkpoint alone": ("prepare s.ply o.ply --rectify 7 --checkpoint c", "needs --refine"),
    "background": ("prepare scene.ply o.ply --rectify 7 --background red", "black or white"),
    "width": ("prepare scene.ply o.ply --rectify 7 --width -4", "width -4"),
}


@pytest.mark.parametrize("name", REFUSALS)
def test_refusals_are_one_line_and_write_nothing(folder, monkeypatch, name):
    monkeypatch.chdir(folder)
    before = sorted(path.name for path in folder.iterdir())
    command, message = REFUSALS[name]
    result = run(*command.split())
    assert isinstance(result.exception, InvalidInput), result.output
    assert message in str(result.exception)
    assert "\n" not in str(result.exception)
    assert sorted(path.name for path in folder.iterdir()) == before


@pytest.mark.parametrize(("name", "value"), [
    ("prune_geometry", 1.0), ("prune_importance", 1.0), ("prune", 30.0),
    ("prune_max_psnr_drop", 0.0),
    ("refine", 1), ("compact_sh", 1e-5), ("refit_colour", 1), ("rectify", 7.5),
])  # fmt: skip
def test_any_step_counts_as_preparation(name, value):
    assert not Steps().wanted
    assert Steps(**{name: value}).wanted


def test_encode_reports_preparation(folder, monkeypatch):
    monkeypatch.chdir(folder)
    asked = ["encode", "scene.ply", "a.egs", "--prune", "30", "--cameras", "cameras.json"]
    result = CliRunner().invoke(app, asked)
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert lines[1] == "pruned by leave-one-out: 120 of 400"
    rows = ["step", "original", "leave-one-out pruning", "coding (m)"]
    assert [line.split("  ")[0] for line in lines[2:6]] == rows
    assert lines[6].startswith("rendered views: ")
    told = json.loads(CliRunner().invoke(app, [*asked, "--overwrite", "--json"]).stdout)
    prepared = told["prepared"]
    assert [step["name"] for step in prepared["steps"]] == rows[1:]
    assert prepared["steps"][-1]["gaussians"] == 280
    assert prepared["steps"][-1]["size_bytes"] == told["output_bytes"]
    assert told["stages"]["prepare"] >= sum(s["seconds"] for s in prepared["steps"][:-1])
    chosen = Plan(Steps(prune=30), "cameras.json")
    report = prepare_file("scene.ply", "b.egs", chosen).as_dict()
    assert [s["quality"] for s in report["steps"]] == [s["quality"] for s in prepared["steps"]]


def test_number_of_gaussians(folder):
    def encoded(steps: Steps) -> int:
        plan = Plan(steps, folder / "cameras.json")
        scene = folder / "scene.ply"
        return encode_file(scene, folder / "a.egs", plan=plan, overwrite=True).count

    for number, left in ((150, 150), (400, 400), (1000, 400)):
        assert encoded(Steps(gaussians=number)) == left
    # Refinement then does not choose another number.
    assert encoded(Steps(gaussians=390, refine=5)) == 390
    with pytest.raises(InvalidInput, match="gaussians and prune cannot be combined"):
        Steps(prune=0, gaussians=5)


@pytest.mark.parametrize(
    ("typed", "iterations"),
    [(["--refine", "a.ply", "b.egs"], -1), (["a.ply", "b.egs", "--refine"], -1),
     (["--refine", "--json", "a.ply", "b.egs"], -1), (["--refine", "7", "a.ply", "b.egs"], 7)],
)  # fmt: skip
def test_refinement_without_a_number(monkeypatch, typed, iterations):
    asked = []
    monkeypatch.setattr(
        "gs_codec.files.encode_file.encode_requested", lambda *given, **_: asked.append(given)
    )
    CliRunner().invoke(app, ["encode", *typed])
    source, target, request, *_ = asked[0]
    assert (str(source), str(target), request.plan.steps.refine) == ("a.ply", "b.egs", iterations)

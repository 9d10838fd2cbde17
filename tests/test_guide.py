"""Camera-guided encoding: bits are spent where visible, and colours compensate for shapes."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from orbits import cameras, quality
from requested import as_requested
from typer.testing import CliRunner

import gs_codec
from gs_codec.cli.main import app
from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.config import ADAPTIVE_PROFILES, AdaptiveProfile, Config
from gs_codec.errors import InvalidInput
from gs_codec.files.encode_file import encode_file
from gs_codec.files.preparing import prepare_file
from gs_codec.files.scenes import read_scene
from gs_codec.formats.ply.writer import write_ply
from gs_codec.guidance.guide import Guidance, guide
from gs_codec.plan import Plan, Steps
from gs_codec.preparation.reference_views import ReferenceViews, draw_reference_views
from gs_codec.scene import GROUPS, Scene
from samples.generate import generate, orbit_cameras

pytestmark = pytest.mark.slow


def compacting(strength: float) -> AdaptiveProfile:
    return replace(ADAPTIVE_PROFILES["m"], compaction=strength)


def shaped(decoded: Scene, order: np.ndarray, steps: np.ndarray) -> SimpleNamespace:
    """A scene with quantised shapes."""
    return SimpleNamespace(
        decoded=lambda: decoded, order=order, sh_steps=lambda: np.stack([steps] * 3)
    )


def recolour(found: Guidance, decoded: Scene, steps: np.ndarray, profile) -> Scene:
    return found.recolour(shaped(decoded, np.arange(decoded.count), steps), profile)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return generate(2500, 2, 5)


@pytest.fixture(scope="module")
def plan() -> Plan:
    return Plan(Steps(), cameras(12))


def test_guided_files_have_better_views_at_equal_size(scene, plan):
    held_out = [camera for camera in plan.cameras if camera.split == "test"]
    blind = {p: encode_scene(scene, Config(p))[0] for p in ADAPTIVE_PROFILES}
    guided = as_requested(scene, Config("m"), plan)[0]
    shown = quality(scene, decode_scene(guided), held_out)
    for profile, data in blind.items():
        if quality(scene, decode_scene(data), held_out) >= shown:
            assert len(data) > 1.1 * len(guided), profile
    assert quality(scene, decode_scene(blind["l"]), held_out) >= shown, "nothing is compared"


def test_a_single_camera_that_guides_is_a_warning(scene, caplog):
    text = "cameras: only one guides step sizes; views from elsewhere may lose far more"
    two = [replace(camera, split=None) for camera in cameras(2)]
    for number, warned in ((1, [text]), (2, [])):
        caplog.clear()
        as_requested(scene, Config("m", effort="fast"), Plan(Steps(), two[:number]))
        assert [said for said in caplog.messages if "only one" in said] == warned


def test_profiles_are_in_order(scene, plan):
    held_out = [camera for camera in plan.cameras if camera.split == "test"]
    sizes, shown = [], []
    for profile in ("l", "m", "s"):
        config = Config(profile)
        data, _ = as_requested(scene, config, plan)
        sizes.append(len(data))
        shown.append(quality(scene, decode_scene(data), held_out))
    assert sizes == sorted(sizes, reverse=True)
    assert shown == sorted(shown, reverse=True)


@pytest.mark.thorough
def test_threads_do_not_change_the_bytes(scene, plan):
    streams = set()
    for threads in (1, 2, 5):
        config = Config("m", threads=threads)
        streams.add(as_requested(scene, config, plan)[0])
    assert len(streams) == 1


def test_colours_compensate_for_shapes(scene, plan):
    views = draw_reference_views(scene, plan.cameras, (0.0, 0.0, 0.0))
    found = guide(scene, views)
    rng = np.random.default_rng(7)
    noise = rng.normal(scale=0.2, size=scene.opacity.shape).astype(np.float32)
    worse = replace(scene, opacity=scene.opacity + noise)
    mended = recolour(found, worse, np.full(scene.count, 1e-4, np.float32), compacting(1e-5))
    assert views.error(mended) < 0.8 * views.error(worse)
    for group in set(GROUPS) - {"f_dc", "f_rest"}:
        np.testing.assert_array_equal(getattr(mended, group), getattr(worse, group))


def test_coarse_steps_leave_few_coefficients(scene, plan):
    views = draw_reference_views(scene, plan.cameras, (0.0, 0.0, 0.0))
    found = guide(scene, views)
    steps = np.where(np.arange(scene.count) % 2, 1e3, 1e-3).astype(np.float32)
    coloured = recolour(found, scene, steps, compacting(1e-2))
    assert not coloured.f_rest[:, 1::2].any()
    assert coloured.f_rest[:, ::2].any()


@pytest.mark.thorough
@pytest.mark.parametrize(("count", "compacted"), [(30, True), (4, False)])
def test_compaction_must_work_in_held_out_views(scene, count, compacted):
    found = guide(scene, draw_reference_views(scene, cameras(count), (0.0, 0.0, 0.0)))
    steps = np.full(scene.count, 0.1, np.float32)
    compact = found.compact(shaped(scene, np.arange(scene.count), steps), compacting(1e-5))
    new_zeros = np.count_nonzero((compact.f_rest == 0) & (scene.f_rest != 0))
    assert (new_zeros > 0.5 * scene.f_rest.size) == compacted
    assert (new_zeros == 0) == (not compacted)


@pytest.mark.thorough
def test_a_pruning_loss_allows_more_compaction(scene, plan):
    whole = draw_reference_views(scene, plan.cameras, (0.0, 0.0, 0.0))
    pruned = scene.take(np.arange(scene.count) % 3 > 0)
    steps = np.full(pruned.count, 0.1, np.float32)
    coloured = recolour(guide(pruned, whole), pruned, steps, compacting(1e-9))
    assert np.any((coloured.f_rest == 0) & (pruned.f_rest != 0))


def test_one_view_is_not_enough_to_compact_by(scene, plan):
    found = guide(scene, draw_reference_views(scene, plan.cameras[:1], (0.0, 0.0, 0.0)))
    steps = np.full(scene.count, 0.1, np.float32)
    compact = found.compact(shaped(scene, np.arange(scene.count), steps), compacting(1e3))
    np.testing.assert_array_equal(compact.f_rest, scene.f_rest)


@pytest.mark.thorough
def test_a_pruning_loss_coarsens_the_steps(scene, plan):
    whole = draw_reference_views(scene, plan.cameras, (0.0, 0.0, 0.0))
    pruned = scene.take(np.arange(scene.count) % 3 > 0)
    assert guide(scene, whole).loss == 0.0
    assert guide(pruned, whole).loss == pytest.approx(whole.error(pruned))

    def opacity_bytes(targets: ReferenceViews) -> int:
        steps = guide(pruned, targets).steps(ADAPTIVE_PROFILES["m"])
        return encode_scene(pruned, Config("m"), steps=steps)[1].section_bytes["opacity"]

    own = draw_reference_views(pruned, plan.cameras, (0.0, 0.0, 0.0))
    assert opacity_bytes(whole) < opacity_bytes(own)


@pytest.mark.thorough
def test_extra_properties_stay_with_their_gaussians(scene, plan):
    extra = {"x0": scene.positions[0].copy(), "label": np.arange(scene.count, dtype="<i4")}
    carrying = replace(scene, extra=extra, comments=("made by a test",))
    config = Config("m", extra="keep")
    data, _ = as_requested(carrying, config, plan)
    decoded = decode_scene(data)
    assert decoded.comments == carrying.comments
    assert sorted(decoded.extra["label"]) == list(range(scene.count))
    near = np.abs(decoded.positions[0] - decoded.extra["x0"])
    assert np.quantile(near, 0.9) < 0.05


def test_only_profiles_that_ask_are_guided(scene, plan):
    none = scene.take(np.arange(0))
    for chosen, profile in ((scene, "paper-m"), (scene, "lossless"), (none, "m")):
        config = Config(profile)
        data, report = as_requested(chosen, config, plan)
        assert data == encode_scene(chosen, config)[0]
        assert "views" not in report.seconds


@pytest.mark.thorough
def test_changes_by_the_encoder_are_reported_with_views_too(scene, plan):
    broken = replace(scene, opacity=scene.opacity.copy(), rot=scene.rot.copy())
    broken.opacity[0, :3] = np.nan
    broken.rot[:, 10:12] = 0
    _, report = as_requested(broken, Config("m", nonfinite="drop"), plan)
    assert (report.count, report.dropped, report.zero_quaternions) == (scene.count - 3, 3, 2)
    assert list(report.seconds) == [
        "check", "views", "measure", "order", "quantise", "recolour", "round", "model", "code",
        "container",
    ]  # fmt: skip


@pytest.mark.thorough
def test_files_api_and_command_line_agree(scene, plan, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_ply("scene.ply", scene)
    with open("cameras.json", "w") as file:
        json.dump(orbit_cameras(9, 90, 60), file)
    options = ["encode", "scene.ply", "cli.egs", "-p", "m", "--cameras", "cameras.json"]
    result = CliRunner().invoke(app, options)
    assert result.exit_code == 0, result.output
    encode_file("scene.ply", "file.egs", Config("m"), plan=Plan(Steps(), "cameras.json"))
    stream = gs_codec.encode(gs_codec.read("scene.ply"), Config("m"), Plan(Steps(), "cameras.json"))
    assert (tmp_path / "cli.egs").read_bytes() == (tmp_path / "file.egs").read_bytes() == stream
    classes = {p.name: p.tables for p in inspect_bytes(stream).passes}
    assert classes["colour class"] > 0
    assert stream != encode_scene(scene, Config("m"))[0]


@pytest.mark.thorough
def test_pruning_and_encoding_use_the_same_views(scene, plan, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_ply("scene.ply", scene)
    pruning = replace(plan, steps=Steps(prune=40.0))
    report = encode_file("scene.ply", "out.egs", Config("m"), pruning)
    assert report.count == scene.count - 1000
    prepare_file("scene.ply", "same.egs", pruning, report_folder="report")
    assert (tmp_path / "same.egs").read_bytes() == (tmp_path / "out.egs").read_bytes()
    assert read_scene("out.egs").count == report.count
    told = json.loads((tmp_path / "report" / "report.json").read_text())
    assert told["steps"][-1]["name"] == "coding (m)"
    assert told["steps"][-1]["size_bytes"] == (tmp_path / "out.egs").stat().st_size


def test_photographs_without_a_step_are_refused(tmp_path):
    options = ["encode", "a.ply", "b.egs", "--cameras", "auto", "--gt-images", str(tmp_path)]
    result = CliRunner().invoke(app, options)
    assert isinstance(result.exception, InvalidInput)
    assert "--gt-images needs --prune" in str(result.exception)


def test_colours_do_not_depend_on_the_order(scene, plan):
    found = guide(scene, draw_reference_views(scene, plan.cameras, (0.0, 0.0, 0.0)))
    steps = np.linspace(0.05, 0.3, scene.count, dtype=np.float32)
    order = np.random.default_rng(93).permutation(scene.count)
    given = shaped(scene, np.arange(scene.count), steps)
    as_given = found.compact(given, compacting(1e-3))
    moved = shaped(scene.take(order), order, steps[order])
    shuffled = found.compact(moved, compacting(1e-3))
    assert np.count_nonzero(as_given.f_rest == 0) > np.count_nonzero(scene.f_rest == 0)
    np.testing.assert_array_equal(shuffled.f_rest, as_given.f_rest[:, order])

"""Rate control: targets are met, rejected if out of reach, and reproducible."""

from __future__ import annotations

import json
import math
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from orbits import cameras
from PIL import Image
from requested import as_requested, to_rate
from scenes import made_up_sensitivity, random_scene, thorough, told
from typer.testing import CliRunner

import gs_codec
from gs_codec.cli.encode import _print_report
from gs_codec.cli.main import app
from gs_codec.cli.options import parse_value
from gs_codec.cli.typed import Typed
from gs_codec.cli.typed_request import plan_of
from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.config import ADAPTIVE_PROFILES, Config, RateTarget
from gs_codec.errors import InvalidInput
from gs_codec.files.encode_file import encode_file
from gs_codec.files.scenes import read_scene
from gs_codec.files.writing import write_scene
from gs_codec.formats.cloud import to_cloud
from gs_codec.formats.ply.writer import vertex_rows, write_ply
from gs_codec.metrics.views import compare_views
from gs_codec.plan import Plan, Steps
from gs_codec.preparation.reference_views import draw_reference_views
from gs_codec.preparation.view_selection import choose_views
from gs_codec.rate import allocate, fixed_rate
from gs_codec.rate import search as searching
from gs_codec.rate.search import COARSEST, FINEST, search
from gs_codec.report import RateReport, RenderedLoss
from gs_codec.scene import Scene
from samples.generate import generate


@pytest.fixture(scope="module")
def scene() -> Scene:
    return random_scene(3000, 2, seed=200)


def to_target(scene, config, target, ply_bytes=1, plan=None):
    return as_requested(scene, config, plan, target, ply_bytes)


def unchanged(shaped, *_, **__):
    return shaped.decoded()


# Targets


@pytest.mark.parametrize(
    "wishes",
    [{}, {"size": 1000, "ratio": 3.0}, {"bits": 0.0}, {"ratio": -1}, {"psnr_drop": math.nan}],
)
def test_a_target_is_one_number_above_zero(wishes):
    with pytest.raises(InvalidInput, match="target"):
        RateTarget(**wishes)


def test_a_loss_that_no_float_holds_is_refused():
    with pytest.raises(InvalidInput, match="expected at most 100 dB"):
        RateTarget(psnr_drop=1e9)


def test_limits_of_targets():
    assert RateTarget(size=1234).limit(100, 24_800) == 1234
    assert RateTarget(ratio=31).limit(100, 24_800) == 800
    assert RateTarget(bits=12.5).limit(100, 24_800) == 156
    assert RateTarget(psnr_drop=0.1).limit(100, 24_800) is None
    for most in ({"bits": 1e308}, {"ratio": 1e-308}):  # beyond the largest float
        assert RateTarget(**most).limit(100, 24_800) == sys.maxsize


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("5MB", 5_000_000),
        ("800kB", 800_000),
        ("1.5 MiB", 1_572_864),
        ("700", 700),
        ("2g", 2 * 10**9),
    ],
)
def test_sizes_have_units(text, size):
    assert parse_value("target_size", text) == size


@pytest.mark.parametrize("text", ["", "MB", "five", "-3MB", "3 MBB", "1e6", "5Mb/s"])
def test_other_sizes_are_refused(text):
    command = ["encode", "a.ply", "b.egs", f"--target-size={text}"]
    error = CliRunner().invoke(app, command).exception
    assert isinstance(error, InvalidInput)
    assert str(error) == f"--target-size {text}: expected a size, for example 5MB or 800kB"


# The search


@pytest.mark.parametrize("start", [-9.0, -2.0, 0.0, 5.5])
@pytest.mark.parametrize("goal", [0.02, 1.0, 90.0])
def test_search_meets_its_interval_in_few_steps(goal, start):
    tried = []

    def measure(place: float) -> float:
        tried.append(place)
        return 2.0 ** (-1.1 * place + 0.1 * math.sin(place))

    found = search(measure, 0.98 * goal, goal, start, -0.7)
    assert found == tried[-1]
    assert 0.98 * goal <= measure(found) <= goal
    assert len(tried) <= 12
    assert FINEST <= min(tried) <= max(tried) <= COARSEST


@pytest.mark.parametrize("goal", [1e-9, 1e9])
def test_search_reports_failure(goal):
    assert search(lambda place: 2.0**-place, 0.98 * goal, goal, 0.0, -1.0) is None


@pytest.mark.parametrize("start", [-3.0, 0.29, 4.0])
def test_search_ends_below_a_jump(start):
    places = []

    def measure(place: float) -> float:
        places.append(place)
        return 1.0 if place < 0.3 else 9.0

    found = search(measure, 4.0, 5.0, start, 1.0)
    assert found == places[-1] < 0.3


def test_search_tries_neighbours_if_the_measurement_is_noisy(monkeypatch):
    """Such as the loss of few Gaussians: a slightly different step may change all of them."""

    def met(seed: int) -> bool:
        factors = np.random.default_rng(seed).uniform(0.9, 1.1, 40_000)

        def measure(place: float) -> float:
            return 2.0**place * float(factors[int((place + 10) * 2000)])

        found = search(measure, 0.97, 1.0, -0.4, 1.0)
        return found is not None and 0.97 <= measure(found) <= 1.0

    beside = sum(met(seed) for seed in range(60))
    monkeypatch.setattr("gs_codec.rate.search._SHIFTS", ())
    assert sum(met(seed) for seed in range(60)) < beside
    assert beside >= 50


# Sizes


@pytest.mark.one_in(3)
@pytest.mark.parametrize("profile", ADAPTIVE_PROFILES)
@pytest.mark.parametrize(
    "target", [RateTarget(bits=120), RateTarget(bits=200), RateTarget(ratio=12)]
)
@pytest.mark.parametrize("guided", [False, True], ids=["blind", "guided"])
def test_sizes_are_met_from_below(scene, target, profile, guided, monkeypatch):
    ply_bytes = vertex_rows(scene).nbytes
    guidance = told(scene, made_up_sensitivity(scene, seed=3))
    guidance.compact = guidance.recolour = unchanged
    monkeypatch.setattr(searching, "guide", lambda *_: guidance)
    plan = Plan(Steps(), cameras(1)) if guided else None
    data, report = to_target(scene, Config(profile), target, ply_bytes, plan)
    limit = target.limit(scene.count, ply_bytes)
    assert 0.98 * limit <= len(data) <= limit
    assert report.file_bytes == report.rate.file_bytes == len(data)
    assert report.rate.encodings <= (16 if guided else 12)
    assert decode_scene(data).count == scene.count
    passes = {item.name: item for item in inspect_bytes(data).passes}
    for name, (finest, coarsest) in report.rate.steps.items():
        assert (finest, coarsest) == (passes[name].finest_step, passes[name].coarsest_step)


def test_the_same_target_gives_the_same_bytes(scene):
    streams = {
        to_target(scene, Config("m", threads=threads), RateTarget(bits=60))[0]
        for threads in (1, 2, 5)
    }
    assert len(streams) == 1


def test_unreachable_sizes_are_refused_with_the_reachable_range(scene):
    with pytest.raises(
        InvalidInput, match=r"target .* bytes: unreachable, expected [\d,]+ to [\d,]+ bytes"
    ):
        to_target(scene, Config("m"), RateTarget(size=10))


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    "target", [RateTarget(size=10**9), RateTarget(ratio=1e-9), RateTarget(bits=1e5)], ids=str
)
def test_unreachably_large_size_gives_the_finest_steps(scene, target):
    data, report = to_target(scene, Config("m"), target)
    assert data == encode_scene(scene, Config("m", coarseness=2.0**FINEST))[0]
    assert report.rate.at_end
    assert not to_target(scene, Config("m"), RateTarget(bits=60))[1].rate.at_end


@pytest.mark.parametrize("profile", ["paper-m", "lossless"])
def test_profiles_without_steps_have_no_targets(scene, profile):
    with pytest.raises(InvalidInput, match="fixed steps"):
        to_target(scene, Config(profile), RateTarget(bits=60))


def test_an_empty_scene_has_no_target():
    with pytest.raises(InvalidInput, match="no Gaussians"):
        to_target(random_scene(0, 1), Config("m"), RateTarget(bits=60))


def test_dropped_gaussians_are_reported(scene):
    broken = replace(scene, opacity=scene.opacity.copy(), rot=scene.rot.copy())
    broken.opacity[0, 5] = np.nan
    broken.rot[:, 7] = 0
    config = Config("m", nonfinite="drop")
    data, report = to_target(broken, config, RateTarget(bits=60))
    assert (report.dropped, report.zero_quaternions) == (1, 1)
    assert decode_scene(data).count == scene.count - 1
    assert 0.98 * 60 * scene.count <= 8 * len(data) <= 60 * scene.count


# Qualities


@pytest.fixture(scope="module")
def seen() -> tuple[Scene, Plan]:
    return generate(1200, 2, 5), Plan(Steps(), cameras(18))


# At small losses, compaction pays off at some step sizes and not at the next.
@pytest.mark.parametrize(
    ("wanted", "larger"), [thorough(0.03, 1.2), (0.1, 1.01), thorough(0.5, 1.01)]
)
def test_losses_are_met_from_below(seen, wanted, larger):
    scene, plan = seen
    measured = choose_views(scene, plan).held_out
    sizes, losses = {}, {}
    for effort in ("fast", "normal"):
        config = Config("m", effort=effort)
        data, report = to_rate(scene, config, RateTarget(psnr_drop=wanted), plan)
        sizes[effort] = len(data)
        losses[effort] = measured.drop(measured.errors(decode_scene(data)), 0.0)
        assert report.rate.psnr_drop == pytest.approx(losses[effort], abs=1e-9)
    assert wanted - 0.02 <= losses["fast"] <= wanted
    assert losses["normal"] <= wanted
    assert sizes["normal"] < larger * sizes["fast"]


@pytest.mark.thorough
def test_a_size_is_met_with_cameras(seen):
    scene, plan = seen
    data, report = to_rate(scene, Config("m"), RateTarget(bits=60), plan)
    assert 0.98 * 60 * scene.count <= 8 * len(data) <= 60 * scene.count
    assert report.rate.predicted_bytes == pytest.approx(len(data), rel=0.3)


@pytest.mark.thorough
def test_unreachably_large_loss_gives_the_coarsest_steps(seen):
    scene, plan = seen
    _, report = to_rate(scene, Config("m"), RateTarget(psnr_drop=60), plan)
    assert report.rate.coarseness == 2.0**COARSEST
    assert report.rate.psnr_drop < 60
    assert report.rate.at_end


def test_an_unreachable_loss_is_refused(seen):
    scene, plan = seen
    with pytest.raises(InvalidInput, match=r"target 1e-09 dB: unreachable, expected .* dB"):
        to_rate(scene, Config("m"), RateTarget(psnr_drop=1e-9), plan)


@pytest.mark.thorough
def test_losses_are_measured_against_photographs(seen, tmp_path):
    scene, plan = seen
    rng = np.random.default_rng(201)
    drawn = draw_reference_views(scene, plan.cameras, (0.0, 0.0, 0.0))
    for camera, image in zip(drawn.cameras, drawn.images, strict=True):
        noisy = 255 * np.clip(image + rng.normal(0, 0.1, image.shape), 0, 1)
        Image.fromarray(np.uint8(noisy)).save(tmp_path / f"{camera.name}.png")
    by_photographs = replace(plan, gt_images=tmp_path)
    target = RateTarget(psnr_drop=0.1)
    without = to_rate(scene, Config("m"), target, plan)[1].rate
    data, report = to_rate(scene, Config("m"), target, by_photographs)
    # Noise of 20 dB hides more than the 30 dB assumed without photographs.
    assert report.rate.coarseness > 1.5 * without.coarseness
    held_out = [camera for camera in plan.cameras if camera.split == "test"]
    compared = compare_views(scene, decode_scene(data), held_out, truth=tmp_path, device="cpu")
    assert -0.1 <= compared.mean.delta.psnr <= -0.08
    assert report.rate.psnr_drop == pytest.approx(-compared.mean.delta.psnr, abs=1e-4)


# Pruning


@pytest.fixture(scope="module")
def crowded() -> tuple[Scene, Plan]:
    """A scene of which a third is hardly visible."""
    made = generate(1200, 1, 6)
    opacity = made.opacity.copy()
    opacity[:, ::3] = -5.0
    return replace(made, opacity=opacity), Plan(Steps(), cameras(9))


@pytest.mark.thorough
def test_pruning_leaves_more_bits_for_the_rest(crowded):
    scene, plan = crowded
    measured = choose_views(scene, plan).held_out
    errors = []
    for allowed in (False, True):
        target = RateTarget(bits=36, allow_prune=allowed)
        data, report = to_rate(scene, Config("m"), target, plan)
        assert 0.98 * 36 * scene.count <= 8 * len(data) <= 36 * scene.count
        assert decode_scene(data).count == report.count == scene.count - report.rate.pruned
        errors.append(measured.error(decode_scene(data)))
    assert report.rate.pruned >= 0.2 * scene.count
    assert errors[1] < errors[0]


@pytest.mark.thorough
def test_pruning_makes_files_of_a_quality_smaller(crowded):
    scene, plan = crowded
    measured = choose_views(scene, plan).held_out
    sizes = []
    for allowed in (False, True):
        target = RateTarget(psnr_drop=1.0, allow_prune=allowed)
        data, _ = to_rate(scene, Config("m"), target, plan)
        loss = measured.drop(measured.errors(decode_scene(data)), 0.0)
        assert 0.8 <= loss <= 1.0  # few views make the loss jump
        sizes.append(len(data))
    assert sizes[1] < 0.97 * sizes[0]


@pytest.mark.thorough
def test_pruning_reaches_targets_beyond_steps(crowded):
    scene, plan = crowded
    with pytest.raises(InvalidInput, match="unreachable"):
        to_rate(scene, Config("m"), RateTarget(bits=14), plan)
    target = RateTarget(bits=14, allow_prune=True)
    counted = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            searching, "encode_scene", lambda *a, **k: counted.append(1) or encode_scene(*a, **k)
        )
        data, report = to_rate(scene, Config("m"), target, plan)
    assert 8 * len(data) <= 14 * scene.count
    assert report.rate.pruned > 0
    # Includes files that were too large; the other encodings only choose colours.
    assert report.rate.encodings >= len(counted) > 20


@pytest.mark.thorough
@pytest.mark.parametrize("target", [RateTarget(psnr_drop=1e-9), RateTarget(size=99)])
def test_targets_beyond_pruning_are_refused(crowded, target):
    scene, plan = crowded
    with pytest.raises(InvalidInput, match="unreachable"):
        to_rate(scene, Config("m"), replace(target, allow_prune=True), plan)


def test_nothing_is_pruned_if_the_size_would_not_be_used(seen):
    scene, plan = seen
    plan = replace(plan, views=12)
    target = RateTarget(bits=265, allow_prune=True)
    data, report = to_rate(scene, Config("m"), target, plan)
    plain, _ = to_rate(scene, Config("m"), RateTarget(bits=265), plan)
    assert report.rate.pruned == 0
    assert data == plain


def test_pruning_without_a_target_is_refused(tmp_path):
    result = CliRunner().invoke(app, ["encode", "a.ply", str(tmp_path / "x.egs"), "--allow-prune"])
    assert isinstance(result.exception, InvalidInput)
    assert "--allow-prune needs a size or a quality" in str(result.exception)


@pytest.mark.parametrize(
    "asked", [{"allow_prune": True}, {"max_psnr_drop": 0.5}], ids=["pruning", "quality"]
)
def test_views_of_a_target_have_the_requested_number_and_width(asked):
    def found(**values: Any) -> Plan | None:
        typed = SimpleNamespace(name="COMMANDLINE")
        ctx = SimpleNamespace(
            meta={}, info_name="encode", get_parameter_source=dict.fromkeys(values, typed).get
        )
        return plan_of(Typed(ctx, {"profile": "m"} | values), Config())

    views = {"views": 8, "width": 100, "background": (1.0, 1.0, 1.0)}
    plan = found(**asked, **views)
    assert (plan.cameras, plan.views, plan.width) == ("auto", 8, 100)
    assert plan.background == (1, 1, 1)
    with pytest.raises(InvalidInput, match="--views has no effect without views"):
        found(**views)
    assert found() is None


def test_bits_per_gaussian_count_pruned_gaussians(crowded):
    scene, plan = crowded
    half = scene.take(np.arange(0, scene.count, 2))
    data, _ = to_rate(half, Config("m"), RateTarget(bits=30), plan, scene)
    assert 0.98 * 30 * scene.count <= 8 * len(data) <= 30 * scene.count


# Command line and Python


def test_command_line_meets_a_size(scene, tmp_path):
    source, out = tmp_path / "scene.ply", tmp_path / "out.egs"
    write_ply(source, scene)
    options = ["--target-size", "40kB", "--json"]
    result = CliRunner().invoke(app, ["encode", str(source), str(out), *options])
    assert result.exit_code == 0, result.output
    assert 39_200 <= out.stat().st_size <= 40_000
    report = json.loads(result.stdout)
    assert report["rate"]["output_bytes"] == out.stat().st_size
    first = out.read_bytes()
    options = ["--target-size", "40000", "--overwrite"]
    assert CliRunner().invoke(app, ["encode", str(source), str(out), *options]).exit_code == 0
    assert out.read_bytes() == first


def test_command_line_reports_the_finest_steps(scene, tmp_path):
    source, out = tmp_path / "scene.ply", tmp_path / "out.egs"
    write_ply(source, scene)
    result = CliRunner().invoke(app, ["encode", str(source), str(out), "--target-size", "5MB"])
    assert result.exit_code == 0, result.output
    assert "step sizes 0.016x those of the profile" in result.stdout
    assert "there are no finer step sizes" in result.stdout


@pytest.mark.one_in(3)
@pytest.mark.parametrize("suffix", [".egs", ".splat", ".ply"])
def test_ratio_is_relative_to_the_floats_of_a_compressed_source(scene, tmp_path, suffix):
    source, out = tmp_path / f"scene{suffix}", tmp_path / "out.egs"
    write_scene(source, scene, Config("s"))
    limit = source.stat().st_size if suffix == ".ply" else read_scene(source).float_bytes
    for ratio in (12.0, 14.0):
        encode_file(source, out, rate=RateTarget(ratio=ratio), overwrite=True)
        assert 0.98 * limit <= ratio * out.stat().st_size <= limit


@pytest.mark.parametrize(
    ("options", "wanted", "unit"),
    [
        (["--target-ratio", "999"], "999", "x"),
        (["--target-size", "1kB"], "1,000", " bytes"),
        (["--target-bpg", "0.5"], "0.5", " bits per Gaussian"),
    ],
)
def test_command_line_refuses_unreachable_targets(scene, tmp_path, options, wanted, unit):
    source, out = tmp_path / "scene.ply", tmp_path / "out.egs"
    write_ply(source, scene)
    result = CliRunner().invoke(app, ["encode", str(source), str(out), *options])
    assert isinstance(result.exception, InvalidInput)
    message = str(result.exception)
    assert message.startswith(f"{source}: target {wanted}{unit}: ")
    assert message.endswith(unit)
    ends = re.search(r"expected ([\d.,]+) to ([\d.,]+)", message)
    low, high = (float(end.replace(",", "")) for end in ends.groups())
    assert not low <= float(wanted.replace(",", "")) <= high
    assert low < high
    assert not out.exists()


@pytest.mark.parametrize("target", [{"bits": 1e-4}, {"ratio": 1e9}], ids=str)
def test_targets_below_a_byte_are_refused(scene, target):
    with pytest.raises(InvalidInput, match="target: less than 1 byte, expected more"):
        gs_codec.encode(to_cloud(scene), rate=target)


def test_two_targets_are_refused(scene, tmp_path):
    options = ["--target-ratio", "20", "--target-bpg", "30"]
    result = CliRunner().invoke(app, ["encode", "scene.ply", str(tmp_path / "x.egs"), *options])
    assert isinstance(result.exception, InvalidInput)


def test_python_gets_a_report_with_a_target(scene):
    data, report = gs_codec.encode(to_cloud(scene), rate={"ratio": 12})
    assert 0.98 <= 12 * len(data) / vertex_rows(scene).nbytes <= 1
    assert report.coarseness > 0
    assert report.psnr_drop is None


@pytest.mark.parametrize("target", [{}, {"rate": 3}, {"ratio": 3, "bits": 5}, {"size": 0}])
def test_python_refuses_invalid_targets(scene, target):
    with pytest.raises(InvalidInput, match="target"):
        gs_codec.encode(to_cloud(scene), rate=target)


@pytest.mark.parametrize(
    ("config", "most"), [(Config("s"), 0.4), (Config(format="splat"), 3.0)], ids=["egs", "splat"]
)
def test_a_loss_without_given_cameras_is_the_reported_one(config, most):
    plan = Plan(Steps(), views=4, width=80)
    _, report = as_requested(generate(3000, 1, 7), config, plan, RateTarget(psnr_drop=most))
    assert report.rate.psnr_drop == pytest.approx(report.rendered.loss, rel=1e-3)
    assert most / 2 < report.rendered.loss <= most


def test_a_warning_about_views_is_logged_once_for_several_encodings(caplog):
    plan = Plan(Steps(), views=4, width=80)
    scene, target = generate(3000, 1, 7), RateTarget(psnr_drop=3.0)
    _, report = as_requested(scene, Config(format="splat"), plan, target)
    assert report.rate.encodings > 1
    assert [text for text in caplog.messages if text.startswith("cameras")] == [
        "cameras 'auto': no cameras can be estimated from this scene; encoded camera-free"
    ]


def test_a_scene_that_cannot_be_pruned_has_no_coarsest_steps(monkeypatch):
    monkeypatch.setattr(fixed_rate, "_ATTEMPTS", 0)
    plan = Plan(Steps(), cameras(4))
    target = RateTarget(psnr_drop=3.0)
    _, report = as_requested(generate(1000, 0, 7), Config(format="splat"), plan, target)
    assert report.rate.pruned == 0
    assert not report.rate.at_end


@pytest.mark.parametrize(("loss", "tried"), [(0.095, ["round"]), (0.085, ["refit", "round"])])
def test_a_loss_in_crops_near_the_target_is_rounded_at_its_steps(loss, tried):
    """Colours are refitted for these steps already."""
    done = []
    trials = SimpleNamespace(
        rounds_jointly=True, last=(b"12", None), loss=loss, octaves=0.5,
        config_at=lambda octaves: Config("m"), refit=lambda octaves: done.append("refit"),
        finish=lambda octaves: done.append("round"), decoded=lambda: None,
    )  # fmt: skip
    seen = SimpleNamespace(check=print, loss=lambda coded: 0.095)
    allocate._round_within(trials, 0.1, seen)
    assert done == tried


def test_a_loss_is_measured_in_given_views_that_do_not_guide(seen):
    scene, plan = seen
    given = [replace(camera, split=None) for camera in plan.cameras]
    held_out = draw_reference_views(scene, given[::8], plan.background)
    config, unmarked = Config("m", effort="fast"), replace(plan, cameras=given)
    data, report = as_requested(scene, config, unmarked, RateTarget(psnr_drop=0.3))
    lost = replace(held_out, source=None).errors(decode_scene(data))
    assert report.rate.psnr_drop == pytest.approx(held_out.drop(lost, 0.0), abs=1e-6)
    guiding = choose_views(scene, replace(unmarked, holds_out=True)).renders.cameras
    assert not {camera.name for camera in guiding} & {camera.name for camera in given[::8]}


def test_a_target_in_whole_views_and_a_loss_of_crops_are_reported_separately(capsys):
    """The loss in crops of the smallest Gaussians may exceed that in whole views."""
    _, report = encode_scene(generate(100, 0, 1), Config())
    rendered = RenderedLoss(44.1, 0.17, 0.38, 64, "given")
    _print_report(Path("a.egs"), replace(report, rendered=rendered), Config())
    assert "\nrendered views: 44.1 dB against the original" in capsys.readouterr().out
    rate = RateReport(RateTarget(psnr_drop=0.1), 1.8, {}, 900, None, 0.0998, None, 6)
    _print_report(Path("a.egs"), replace(report, rendered=rendered, rate=rate), Config())
    _, met, crops = capsys.readouterr().out.splitlines()
    assert met.endswith("after 6 encodings; views lose 0.100 dB (asked: at most 0.1)")
    assert crops.startswith(
        "crops of other views (half show the smallest Gaussians): 44.1 dB against the original, a "
        "loss of about 0.17 dB at 30 dB"
    )

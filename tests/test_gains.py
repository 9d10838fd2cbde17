"""Gains at equal quality: curves of known shape, and the bench's lines."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scenes import random_scene
from typer.testing import CliRunner

from gs_codec.bench import held_out
from gs_codec.bench.curves import Curve, bd_rate, common_range
from gs_codec.bench.held_out import held_out_views
from gs_codec.cli.main import app
from gs_codec.config import Config
from gs_codec.errors import InvalidInput
from gs_codec.io.ply import write_ply
from gs_codec.preparation.pipeline import choose_views


def _line(psnrs, factor=1.0) -> Curve:
    """One bit for each 6 dB, times a factor."""
    return Curve.through((psnr, factor * 2 ** (psnr / 6)) for psnr in psnrs)


@pytest.mark.parametrize("factor", [0.5, 1.0, 1.7])
@pytest.mark.parametrize("psnrs", [(40, 46, 52), (52, 40, 46), (41, 51), (35, 43.5, 44, 60)])
def test_curves_a_factor_apart_are_so_at_every_quality(psnrs, factor):
    reference, tested = _line((38, 45, 47, 55)), _line(psnrs, factor)
    low, high = common_range(reference, tested)
    assert (low, high) == (max(38, min(psnrs)), min(55, max(psnrs)))
    for psnr in np.linspace(low, high, 7):
        assert reference.bits_at(psnr) == pytest.approx(2 ** (psnr / 6))
        assert tested.bits_at(psnr) == pytest.approx(factor * reference.bits_at(psnr))
    assert bd_rate(reference, tested) == pytest.approx(100 * (factor - 1), abs=1e-9)
    assert bd_rate(tested, reference) == pytest.approx(100 * (1 / factor - 1), abs=1e-9)


def test_a_curve_goes_through_its_points_and_not_beyond():
    points = [(40.0, 60.0), (44.0, 75.0), (45.0, 160.0), (52.0, 170.0)]
    curve = Curve.through(points)
    for psnr, bits in points:
        assert curve.bits_at(psnr) == pytest.approx(bits)
    between = [curve.bits_at(psnr) for psnr in np.linspace(40, 52, 50)]
    assert np.all(np.diff(between) >= 0)
    assert curve.bits_at(39.99) is None
    assert curve.bits_at(52.01) is None


@pytest.mark.parametrize("psnrs", [(30, 35), (30,), (), (56, 60), (30, 38)])
def test_curves_that_do_not_overlap_have_no_rate(psnrs):
    reference, tested = _line((38, 45, 55)), _line(psnrs)
    assert common_range(reference, tested) is None
    assert bd_rate(reference, tested) is None


def test_of_points_of_one_quality_the_smallest_counts():
    curve = Curve.through([(40, 90), (40, 80), (50, 100)])
    assert curve.bits_at(40) == pytest.approx(80)
    assert Curve.through([(40, 80)]).bits_at(40) == pytest.approx(80)


def test_coarseness_scales_all_that_steps_come_from():
    plain, twice = Config("m").resolved_lattice(), Config("m", coarseness=2).resolved_lattice()
    assert twice.fineness == pytest.approx(2 * plain.fineness)
    assert twice.error == pytest.approx(4 * plain.error)
    assert twice.compaction == pytest.approx(4 * plain.compaction)


@pytest.mark.parametrize("value", [0.0, 1 / 65, 65.0, -1.0, float("nan")])
def test_coarseness_beyond_its_range_is_refused(value):
    with pytest.raises(InvalidInput, match="expected 1/64 to 64"):
        Config("m", coarseness=value)


@pytest.mark.parametrize("profile", ["paper-m", "lossless"])
def test_coarseness_is_for_profiles_of_steps(profile):
    with pytest.raises(InvalidInput, match="has none, l, m, s do"):
        Config(profile, coarseness=2.0)
    with pytest.raises(InvalidInput, match="expected l, m or s"):
        Config(profile).resolved_lattice()


def test_auto_views_to_measure_in_are_not_those_to_encode_by():
    scene = random_scene(500, 0, seed=90)
    cameras, plan = held_out_views("auto", scene, 36)
    views = choose_views(scene, plan)
    assert (len(cameras), len(views.renders.cameras)) == (24, 64)
    assert cameras[0].width == views.renders.cameras[0].width == 36
    places = [{camera.position.tobytes() for camera in c} for c in (cameras, views.renders.cameras)]
    assert not places[0] & places[1]


@pytest.fixture(scope="module")
def gain_lines(tmp_path_factory) -> tuple[list[dict], str]:
    path = tmp_path_factory.mktemp("gains") / "scene.ply"
    write_ply(path, random_scene(400, 1, seed=91))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(held_out, "_MEASURED", 3)
        patch.setattr(held_out, "_ENCODED_BY", 6)
        options = ["--gains", "--cameras", "auto", "--width", "36"]
        result = CliRunner().invoke(app, ["bench", str(path), *options])
    assert result.exit_code == 0, result.output
    return [json.loads(line) for line in result.stdout.splitlines()], result.stderr


def test_every_profile_is_a_point_of_its_curve(gain_lines):
    lines, _ = gain_lines
    points = {(line["curve"], line["point"]) for line in lines if line["kind"] == "point"}
    for curve in ("by attributes", "by views"):
        assert points >= {(curve, profile) for profile in ("l", "m", "s")}
    assert points >= {("paper", profile) for profile in ("paper-l", "paper-m", "paper-s")}


def test_curves_are_continued_until_they_meet(gain_lines):
    """Or until there is no more of them."""
    lines, _ = gain_lines
    psnr: dict[str, dict[str, float]] = {}
    for line in lines:
        if line["kind"] == "point":
            psnr.setdefault(line["curve"], {})[line["point"]] = line["mean"]["psnr"]
    finest = psnr["paper"]["paper-l"]
    for curve in ("by attributes", "by views"):
        points = psnr[curve]
        assert max(points.values()) >= finest or "l, steps / 4" in points
        assert ("l, steps / 2" in points) == (max(points[p] for p in "lms") < finest)


def test_gains_follow_from_the_points(gain_lines):
    lines, table = gain_lines
    for name in ("by attributes", "by views"):
        gains = [line for line in lines if line["kind"] == "gain" and line["curve"] == name]
        assert [line["at"] for line in gains] == [
            "paper-l", "paper-m", "paper-s", "l", "m", "s",
        ]  # fmt: skip
        points = {
            line["point"]: line["bits_per_gaussian"]
            for line in lines
            if line["kind"] == "point" and line["curve"] in ("paper", name)
        }
        for line in gains:
            own = "paper_" if line["at"].startswith("paper") else ""
            assert line[f"{own}bits_per_gaussian"] == pytest.approx(points[line["at"]])
            if line["saving_percent"] is None:
                assert None in (line["bits_per_gaussian"], line["paper_bits_per_gaussian"])
            else:
                ratio = line["bits_per_gaussian"] / line["paper_bits_per_gaussian"]
                assert line["saving_percent"] == pytest.approx(100 * (1 - ratio))
        [total] = [x for x in lines if x["kind"] == "bd-rate" and x["curve"] == name]
        assert (total["range"] is None) == (total["percent"] is None)
        assert f"scene, {name}" in table


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "--gains needs --cameras"),
        (["--cameras", "auto", "-p", "m"], "--profile has no effect beside --gains"),
    ],
)
def test_gains_need_cameras_and_choose_profiles(options, message):
    result = CliRunner().invoke(app, ["bench", "scene.ply", "--gains", *options])
    assert isinstance(result.exception, InvalidInput)
    assert message in str(result.exception)

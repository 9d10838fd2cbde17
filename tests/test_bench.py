"""The benchmark's lines: complete, and right where that can be checked."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scenes import random_scene
from typer.testing import CliRunner

from gs_codec.bench import prepared, scaling
from gs_codec.bench.apart import run_apart
from gs_codec.bench.tile import tile_scene
from gs_codec.cli.main import app
from gs_codec.codec import encode_scene
from gs_codec.config import Config
from gs_codec.entropy import constriction_coder, torchac_coder
from gs_codec.errors import GsCodecError, InvalidInput
from gs_codec.io.ply import read_ply, write_ply
from gs_codec.rendering.camera_files import read_cameras
from gs_codec.rendering.images import read_image, write_png
from gs_codec.rendering.renderer import render


@pytest.fixture(scope="module")
def lines(tmp_path_factory) -> list[dict]:
    path = tmp_path_factory.mktemp("bench") / "scene.ply"
    write_ply(path, random_scene(4000, 1, seed=70))
    options = ["-p", "paper-m", "--repeats", "1", "--coders", "--tile", "5000"]
    options += ["--cameras", "auto", "--width", "48"]
    result = CliRunner().invoke(app, ["bench", str(path), *options])
    assert result.exit_code == 0, result.output
    return [json.loads(line) for line in result.stdout.splitlines()]


def test_every_kind_of_line_is_there(lines):
    kinds = [line["kind"] for line in lines]
    measured = ["codec", "error", "memory", "coder", "coder", "coder", "rendered", "render"]
    assert kinds == ["machine", *measured, "paper", "paper"]


def test_sizes_add_up(lines):
    codec = lines[1]
    assert codec["gaussians"] == 5000
    assert sum(codec["section_bytes"].values()) == codec["file_bytes"]
    assert codec["ratio"] == pytest.approx(codec["ply_bytes"] / codec["file_bytes"])
    assert codec["bits_per_gaussian"] == pytest.approx(8 * codec["file_bytes"] / 5000)


def test_stages_are_parts_of_the_whole(lines):
    codec = lines[1]
    assert set(codec["stages"]) >= {"read", "order", "quantise and model", "code", "decode"}
    assert all(seconds >= 0 for seconds in codec["stages"].values())


def test_entropy_of_each_group_stands_beside_the_paper(lines):
    entropy = lines[1]["entropy"]
    assert set(entropy) == {"opacity", "scaling", "rotation", "sh-ac", "total"}
    for group, values in entropy.items():
        assert values["coded_overhead_percent"] > -1, group
        if group != "total":
            assert values["parametric_overhead_percent"] > 0
            assert values["paper_overhead_percent"] > 0


def test_error_and_memory_are_plausible(lines):
    error, memory = lines[2], lines[3]
    assert error["matched_by"] == "stored order"
    assert {group["name"] for group in error["groups"]} >= {"positions", "rotation", "f_rest"}
    assert memory["encode_peak_bytes"] > memory["float_bytes"]


def test_coders_are_compared_on_the_same_symbols(lines):
    ours, *others = lines[4:7]
    assert ours["coder"] == "rans"
    assert ours["overhead_percent"] > -0.5
    installed = {
        "torchac": torchac_coder.is_available(),
        "constriction": constriction_coder.is_available(),
    }
    assert [line["coder"] for line in others] == list(installed)
    for theirs in others:
        if installed[theirs["coder"]]:
            assert theirs["bytes"] == pytest.approx(ours["bytes"], rel=0.02)
            assert theirs["symbols"] == ours["symbols"]
        else:
            assert "not installed" in theirs["absent"]


def test_rendered_quality_and_speed(lines):
    quality, speed = lines[7], lines[8]
    assert (quality["scene"], quality["profile"], quality["gaussians"]) == (
        "scene", "paper-m", 5000,
    )  # fmt: skip
    assert quality["views"] == speed["views"] == 24
    assert 20 < quality["worst_psnr"] <= quality["mean"]["psnr"] < 90
    assert quality["bits_per_gaussian"] == lines[1]["bits_per_gaussian"]
    assert "delta" not in quality
    assert (speed["width"], speed["height"]) == (48, 32)
    assert 0 < speed["seconds"]["min"] <= speed["seconds"]["median"] <= speed["seconds"]["max"]
    assert speed["pairs"]["min"] > 0


def test_deltas_against_ground_truth(tmp_path):
    scene = random_scene(1000, 0, seed=73)
    write_ply(tmp_path / "scene.ply", scene)
    camera = {"img_name": "v", "width": 40, "height": 30, "fx": 40.0, "fy": 40.0}
    camera |= {"position": [0.0, 0.0, -5.0], "rotation": np.eye(3).tolist()}
    (tmp_path / "cameras.json").write_text(json.dumps([camera]))
    [view] = read_cameras(tmp_path / "cameras.json")
    write_png(tmp_path / "v.png", render(scene, view).colour)
    options = ["--cameras", str(tmp_path), "--against-gt", str(tmp_path), "--repeats", "1"]
    options += ["-p", "m", "-p", "paper-m"]
    result = CliRunner().invoke(app, ["bench", str(tmp_path / "scene.ply"), *options])
    assert result.exit_code == 0, result.output
    found = [json.loads(line) for line in result.stdout.splitlines()]
    rendered = [line for line in found if line["kind"] == "rendered"]
    expected = [("m", False), ("m", True), ("paper-m", False)]
    assert [(line["profile"], line["by_views"]) for line in rendered] == expected
    for line in rendered:
        assert line["truth"]["psnr"] > 50
        assert line["delta"]["psnr"] < 0
    assert f"{rendered[0]['delta']['psnr']:+.3f}" in result.stderr


@pytest.mark.parametrize("options", [["--width", "40"], ["--against-gt", "."]])
def test_views_need_cameras(tmp_path, options):
    result = CliRunner().invoke(app, ["bench", "scene.ply", *options])
    assert isinstance(result.exception, InvalidInput)
    assert " needs --cameras" in str(result.exception)


@pytest.mark.parametrize("count", [1, 999, 1000, 4500])
def test_tiled_scene_is_like_its_source_but_equal_in_no_value(count):
    scene = random_scene(1000, 1, seed=71)
    scene.f_rest[:, ::7] = 0
    tiled = tile_scene(scene, count)
    assert tiled.count == count
    np.testing.assert_array_equal(tiled.f_rest[:, 0], 0)
    if count > 1000:
        again = slice(1000, min(count, 2000))
        source = scene.opacity[0, : again.stop - 1000]
        assert np.all(np.abs(tiled.opacity[0, again] - source) < 0.1)
        assert np.mean(tiled.opacity[0, again] == source) < 0.01
    np.testing.assert_array_equal(tiled.opacity, tile_scene(scene, count).opacity)


def test_source_scene_is_not_changed():
    scene = random_scene(100, 1, seed=72)
    before = scene.positions.copy()
    tile_scene(scene, 250)
    np.testing.assert_array_equal(scene.positions, before)


def test_published_numbers_are_marked_as_the_papers():
    text = (Path(__file__).parents[1] / "gs_codec" / "paper.py").read_text()
    assert "2508.10227" in text


def test_preparation_is_measured_and_plotted(tmp_path, monkeypatch):
    monkeypatch.setattr(prepared, "PRUNED", (50.0,))
    monkeypatch.setattr(prepared, "FRONTIER", (0.0, 50.0))
    monkeypatch.setattr(prepared, "STRENGTHS", (0.0, 3e-5))
    write_ply(tmp_path / "scene.ply", random_scene(300, 1, seed=74))
    plot = tmp_path / "plot.png"
    options = ["-p", "paper-m", "--prepare", "--cameras", "auto", "--width", "36", "--plot", plot]
    result = CliRunner().invoke(app, ["bench", str(tmp_path / "scene.ply"), *map(str, options)])
    assert result.exit_code == 0, result.output
    found = [json.loads(line) for line in result.stdout.splitlines()]
    pruning = [line for line in found if line["kind"] == "pruning"]
    assert [(line["rule"], line["gaussians"]) for line in pruning] == [
        ("leave-one-out", 150),
        ("leave-one-out, auto views", 150),
        ("importance", 150),
    ]
    frontier = [line for line in found if line["kind"] == "frontier"]
    assert [(line["percent"], line["strength"]) for line in frontier] == [
        (0.0, 0.0), (0.0, 3e-5), (50.0, 0.0), (50.0, 3e-5),
    ]  # fmt: skip
    assert frontier[0]["ratio"] < frontier[2]["ratio"]
    assert read_image(plot).shape[2] == 3


def test_preparation_needs_cameras():
    plot = ["--plot", "a.png"]
    for options, message in (
        (["--prepare"], "--prepare needs --cameras"),
        (plot, "--plot needs --prepare or --targets or --scaling"),
        ([*plot, "--cameras", "auto"], "--plot needs --prepare or --targets or"),
    ):
        result = CliRunner().invoke(app, ["bench", "scene.ply", *options])
        assert isinstance(result.exception, InvalidInput)
        assert message in str(result.exception)


def test_parts_save_bits_and_are_put_back(tmp_path):
    path = tmp_path / "scene.ply"
    scene = random_scene(3000, 1, seed=71)
    write_ply(path, scene)
    before = encode_scene(scene, Config("m"))[0]
    options = ["--parts", "--cameras", "auto", "--width", "48"]
    result = CliRunner().invoke(app, ["bench", str(path), *options])
    assert result.exit_code == 0, result.output
    lines = [json.loads(line) for line in result.stdout.splitlines()][1:]
    assert {line["kind"] for line in lines} == {"part"}
    for by_views in (False, True):
        found = {line["without"]: line for line in lines if line["by_views"] == by_views}
        whole = found["nothing"]
        assert whole["saved_bits"] == 0
        assert found["steps as fine"]["bits_per_gaussian"] < whole["bits_per_gaussian"]
        assert found["steps as fine"]["psnr"] < whole["psnr"]
        merged = found["contexts of SH-AC by energy"]
        assert merged["psnr"] == whole["psnr"]
        assert merged["saved_bits"] > 0
        assert found["coarse positions where less is seen"]["psnr"] > whole["psnr"]
        same = {name for name, line in found.items() if line == whole | {"without": name}}
        # Random SH have nothing that compaction could save.
        assert same <= {"nothing", "SH compaction"}, "every other part makes a difference"
    assert encode_scene(scene, Config("m"))[0] == before


@pytest.mark.parametrize("options", [[], ["--cameras", "auto", "-p", "paper-m"]])
def test_parts_need_cameras_and_a_profile_that_has_them(options, tmp_path):
    result = CliRunner().invoke(app, ["bench", str(tmp_path / "x.ply"), "--parts", *options])
    assert isinstance(result.exception, InvalidInput)
    assert "--parts needs" in str(result.exception)


def test_scaling_is_measured_in_processes_of_their_own(tmp_path):
    path = tmp_path / "scene.ply"
    write_ply(path, random_scene(2000, 1, seed=72))
    options = ["--scaling", "--threads", "1", "--max-memory", "1GB"]
    plot = ["--plot", str(tmp_path / "plot.png")]
    result = CliRunner().invoke(app, ["bench", str(path), *options, *plot])
    assert result.exit_code == 0, result.output
    machine, line, growth = [json.loads(line) for line in result.stdout.splitlines()]
    assert machine["kind"] == "machine"
    assert (line["kind"], line["profile"], line["gaussians"]) == ("scaling", "m", 2000)
    assert line["options"] == ["--threads", "1", "--max-memory", "1GB"]
    assert line["file_bytes"] == len(encode_scene(read_ply(path), Config("m"))[0])
    for way in ("encode", "decode"):
        assert line[way]["cpu_seconds"] > 0
        assert line[way]["peak_bytes"] > 10_000_000
    assert growth == {"kind": "growth", "profile": "m"}
    assert read_image(tmp_path / "plot.png").shape[2] == 3


def test_start_is_measured_of_each_command(tmp_path):
    path = tmp_path / "scene.ply"
    write_ply(path, random_scene(1200, 1, seed=74))
    result = CliRunner().invoke(app, ["bench", str(path), "--start", "--repeats", "1"])
    assert result.exit_code == 0, result.output
    machine, *lines = [json.loads(line) for line in result.stdout.splitlines()]
    assert machine["kind"] == "machine"
    assert {line["gaussians"] for line in lines} == {1000}
    assert {"--help", "encode", "decode"} < {line["command"] for line in lines}
    for line in lines:
        assert 0 < line["cpu_seconds"]["min"] <= line["cpu_seconds"]["max"]
        assert f"scene, {line['command']} " in result.stderr


def test_growth_of_what_is_linear():
    lines = [
        {"gaussians": n, **{way: {"cpu_seconds": 1 + 2e-6 * n} for way in ("encode", "decode")}}
        for n in (200_000, 1_000_000, 20_000_000)
    ]
    for growth in scaling._growth(lines).values():
        assert growth["start_seconds"] == pytest.approx(1)
        assert growth["seconds_per_million"] == pytest.approx(2)
        assert growth["most_off_percent"] == pytest.approx(0, abs=1e-6)
    assert scaling._growth(lines[:1]) == {}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--max-memory", "1GB"], "--max-memory needs --scaling"),
        (["--scaling", "--tile", "9"], "--tile has no effect beside --scaling"),
        (["--scaling", "--cameras", "auto"], "--cameras has no effect beside"),
        (["--scaling", "--peers"], "--peers and --scaling: one at a time"),
    ],
)
def test_scaling_is_refused_with_what_it_has_no_use_for(options, message):
    result = CliRunner().invoke(app, ["bench", "scene.ply", *options])
    assert isinstance(result.exception, InvalidInput)
    assert message in str(result.exception)


def test_a_command_that_fails_apart_says_so(tmp_path):
    with pytest.raises(GsCodecError, match="no directory"):
        run_apart(["encode", "scene.ply", str(tmp_path / "none" / "scene.egs")])

"""``bench run``: result lines are complete, and correct where that can be checked."""

from __future__ import annotations

import io
import json
import os
import re
import select
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest
from scenes import random_scene
from typer.testing import CliRunner

from gs_codec.bench import host
from gs_codec.bench.measured_scenes import held_out_views, tile_scene
from gs_codec.bench.processes import run_in_process
from gs_codec.cameras.camera_files import read_cameras
from gs_codec.cameras.image_files import write_png
from gs_codec.cli.bench import _printed
from gs_codec.cli.main import app
from gs_codec.cli.output import set_loudness
from gs_codec.codecs import encode_scene
from gs_codec.config import Config
from gs_codec.errors import GsCodecError, InvalidInput
from gs_codec.formats.ply.writer import write_ply
from gs_codec.rendering.renderer import render

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def measured(tmp_path_factory) -> tuple[list[dict], str]:
    """Lines and table of two profiles, with a camera and its photograph."""
    folder = tmp_path_factory.mktemp("bench")
    scene = tile_scene(random_scene(800, 1, seed=70), 1000)
    write_ply(folder / "scene.ply", random_scene(800, 1, seed=70))
    camera = {"img_name": "v", "width": 40, "height": 30, "fx": 40.0, "fy": 40.0}
    camera |= {"position": [0.0, 0.0, -5.0], "rotation": np.eye(3).tolist()}
    (folder / "cameras.json").write_text(json.dumps([camera]))
    [view] = read_cameras(folder / "cameras.json")
    write_png(folder / "v.png", render(scene, view).colour)
    options = ["--cameras", str(folder), "--gt-images", str(folder), "--repeats", "1"]
    options += ["-p", "m", "-p", "paper-m", "--depth", "sh-dc=7", "--tile", "1000"]
    result = CliRunner().invoke(app, ["bench", "run", str(folder / "scene.ply"), *options])
    assert result.exit_code == 0, result.output
    return [json.loads(line) for line in result.stdout.splitlines()], result.stderr


def test_all_kinds_of_lines_exist(measured):
    found = [(line["kind"], line.get("codec", line.get("profile"))) for line in measured[0]]
    codecs = ["m", "paper-m", "m, camera-guided"]
    each = [(kind, name) for name in codecs[:2] for kind in ("codec", "error", "memory")]
    assert found == [("machine", None), *(("beside", name) for name in codecs), *each]


def test_sizes_add_up(measured):
    lines = measured[0]
    for line in lines[1:4]:
        assert line["gaussians"] == 1000
        assert line["ratio"] == pytest.approx(line["input_bytes"] / line["output_bytes"])
        assert line["bits_per_gaussian"] == pytest.approx(8 * line["output_bytes"] / 1000)
    for beside, codec in ((lines[1], lines[4]), (lines[2], lines[7])):
        assert sum(codec["section_bytes"].values()) == beside["output_bytes"]


def test_times_are_those_of_the_whole_and_of_its_stages(measured):
    codec = measured[0][7]
    assert set(codec["stages"]) >= {"order", "quantise and model", "code"}
    assert all(seconds >= 0 for seconds in codec["stages"].values())
    for way in ("encode", "decode"):
        times = measured[0][2][f"{way}_seconds"]
        assert 0 < times["min"] <= times["median"] <= times["max"]


def test_entropy_of_each_group_is_next_to_the_papers(measured):
    entropy = measured[0][7]["entropy"]
    assert set(entropy) == {"opacity", "scaling", "rotation", "sh-ac", "total"}
    for group, values in entropy.items():
        assert values["coded_overhead_percent"] > 0, group
        if group != "total":
            assert values["parametric_overhead_percent"] > 0
            assert values["paper_overhead_percent"] > 0


def test_error_and_memory_are_plausible(measured):
    error, memory = measured[0][8:10]
    assert error["matched_by"] == "stored order"
    assert {group["name"] for group in error["groups"]} >= {"positions", "rotation", "f_rest"}
    for way in ("encode", "decode"):
        # Python, numpy and numba alone take more than the lower bound.
        assert 5e7 < memory[f"{way}_peak_bytes"] < 2e9


def test_rendered_quality_without_cameras_and_with(measured):
    lines, table = measured
    for line in lines[1:4]:
        assert line["views"] == 1
        assert 20 < line["worst_psnr"] <= line["mean"]["psnr"] < 90
        assert line["truth"]["psnr"] > 50
        assert line["delta"]["psnr"] < 0
        assert f"{line['delta']['psnr']:+.3f}" in table


def test_the_machine_is_described(measured):
    machine = measured[0][0]
    assert machine["processor"]
    assert machine["cores"] >= 1
    assert machine["packages"].keys() >= {"numpy", "numba", "pcodec"}
    assert machine["commit"] is None or re.match(r"[0-9a-f]{40}", machine["commit"])


def test_a_checkout_reports_its_commit(tmp_path, monkeypatch):
    monkeypatch.setattr(host, "__file__", str(tmp_path / "gs_codec" / "bench" / "host.py"))
    assert host.commit() is None
    (tmp_path / ".git").mkdir()
    for status, expected in ((0, "f" * 40), (1, None)):
        done = subprocess.CompletedProcess([], status, "f" * 40 + "\n")
        monkeypatch.setattr(subprocess, "run", lambda *_, done=done, **__: done)
        assert host.commit() == expected


@pytest.mark.parametrize("options", [["--width", "40"], ["--gt-images", "."]])
@pytest.mark.parametrize("command", ["run", "peers"])
def test_views_need_cameras(command, options):
    result = CliRunner().invoke(app, ["bench", command, "scene.ply", *options])
    assert isinstance(result.exception, InvalidInput)
    assert " needs --cameras" in str(result.exception)


@pytest.mark.parametrize("arguments", [["scene.ply"], ["a.ply", "suite"], ["x.ply", "-p", "m"]])
def test_missing_subcommand_lists_subcommands(arguments):
    result = CliRunner().invoke(app, ["bench", *arguments])
    assert isinstance(result.exception, InvalidInput)
    expected = "expected a subcommand, one of run, peers, suite, paper, losses"
    assert str(result.exception) == f"bench {arguments[0]}: {expected}"


@pytest.mark.parametrize("count", [1, 999, 1000, 4500])
def test_tiled_scene_resembles_its_source_without_equal_values(count):
    scene = random_scene(1000, 1, seed=71)
    scene.f_rest[:, ::7] = 0
    before = scene.positions.copy()
    tiled = tile_scene(scene, count)
    assert tiled.count == count
    np.testing.assert_array_equal(tiled.f_rest[:, 0], 0)
    if count > 1000:
        again = slice(1000, min(count, 2000))
        source = scene.opacity[0, : again.stop - 1000]
        assert np.all(np.abs(tiled.opacity[0, again] - source) < 0.1)
        assert np.mean(tiled.opacity[0, again] == source) < 0.01
    np.testing.assert_array_equal(tiled.opacity, tile_scene(scene, count).opacity)
    np.testing.assert_array_equal(scene.positions, before)


def test_auto_views_for_measuring_differ_from_guiding_ones():
    scene = random_scene(100, 0, seed=90)
    both = held_out_views("auto", scene, 36)
    assert [len(cameras) for cameras in both] == [24, 64]
    assert {camera.width for cameras in both for camera in cameras} == {36}
    places = [{camera.position.tobytes() for camera in cameras} for cameras in both]
    assert not places[0] & places[1]


def test_a_separate_process_is_measured(tmp_path):
    used = run_in_process(["--version"])
    assert used.seconds > 0
    assert used.cpu_seconds > 0
    # Small compared with this process, which starts it.
    assert 5e6 < used.peak_bytes < 2e8
    with pytest.raises(GsCodecError, match=r"^.*no directory"):
        run_in_process(["encode", "scene.ply", str(tmp_path / "none" / "scene.egs")])


@pytest.mark.skipif(sys.platform == "win32", reason="no named pipes")
def test_interrupt_ends_the_measured_process(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    opened = []

    def interrupt() -> None:
        opened.append(os.open(tmp_path / "pipe", os.O_WRONLY))  # the process has opened it
        signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        run_in_process(["encode", str(tmp_path / "pipe"), str(tmp_path / "o.egs")])
    thread.join()
    poll = select.poll()
    poll.register(opened[0], 0)
    assert [event for _, event in poll.poll(60_000)] == [select.POLLERR]
    os.close(opened[0])


@pytest.mark.thorough
def test_lines_are_printed_at_once(monkeypatch):
    stdout = io.TextIOWrapper(io.BytesIO())
    monkeypatch.setattr("sys.stdout", stdout)
    set_loudness()  # another test may have been quiet

    def lines():
        yield {"a": 1}
        assert stdout.buffer.getvalue() == b'{"a": 1}\n'

    assert _printed(lines()) == [{"a": 1}]


def test_options_of_the_paper_are_those_of_encoding(tmp_path):
    scene = random_scene(300, 1, seed=71)
    write_ply(tmp_path / "scene.ply", scene)
    options = ["--models", "table", "--laplace-scales", "4", "-p", "paper-s", "--repeats", "1"]
    result = CliRunner().invoke(app, ["bench", "run", str(tmp_path / "scene.ply"), *options])
    assert result.exit_code == 0, result.output
    expected = encode_scene(scene, Config("paper-s", models="table", laplace_scales=4))[1]
    (line,) = (x for x in map(json.loads, result.stdout.splitlines()) if x["kind"] == "codec")
    assert line["section_bytes"] == expected.section_bytes
    result = CliRunner().invoke(app, ["bench", "run", str(tmp_path / "scene.ply"), *options[:2]])
    assert "models 'table': profile 'l', expected paper-l" in str(result.exception)

"""Actions on the command line, in the order typed, with `convert`, `encode` and `batch`."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import assert_same_bits, random_scene, thorough

from gs_codec.codecs import memory_limit
from gs_codec.config import Config
from gs_codec.edit.actions import Action
from gs_codec.edit.apply import edit_scenes
from gs_codec.edit.clusters import keep_largest_cluster
from gs_codec.edit.decimation import decimate
from gs_codec.edit.floaters import remove_floaters
from gs_codec.edit.join import merge_scenes
from gs_codec.errors import InvalidInput
from gs_codec.files.conversion import convert_file
from gs_codec.files.encode_file import encode_file
from gs_codec.files.scenes import read_scene
from gs_codec.formats.coordinates import turn_axes
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import write_ply
from gs_codec.plan import Plan
from gs_codec.runtime import arrays
from gs_codec.scene import Scene

CROP, TURN, SHIFT = "--crop-box=-1,-1,-1,1,1,1", "--rotate=30,40,50", "--translate=0.5,0,0"
FILTER = ("--filter", "opacity>0.5")


def expected(scene: Scene, *typed: str) -> Scene:
    """A scene after actions, typed as options."""
    actions = [Action(*action.removeprefix("--").split("=", 1)) for action in typed]
    return edit_scenes([scene], actions)[0]


def test_actions_are_applied_in_the_order_typed(folder):
    scene = read_ply("scene.ply")
    there = (CROP, TURN, SHIFT, CROP)
    status, out, err = folder.run("convert", "scene.ply", there[0], "o.ply", *there[1:])
    assert (status, out.split(":")[0]) == (0, "o.ply")
    assert_same_bits(read_ply("o.ply"), edited := expected(scene, *there))
    first = expected(scene, *there[:1])
    lines = err.splitlines()
    gone = scene.count - first.count, first.count - edited.count
    assert lines[0] == f"crop-box -1,-1,-1,1,1,1: removed {gone[0]:,} of 1,500 Gaussians"
    assert lines[1] == f"crop-box -1,-1,-1,1,1,1: removed {gone[1]:,} of {first.count:,} Gaussians"
    assert lines[2:] == ["coordinates unchanged (RDF)"]
    folder.run("convert", "scene.ply", "p.ply", *there[::-1])
    assert_same_bits(read_ply("p.ply"), expected(scene, *there[::-1]))
    assert read_ply("p.ply").count != edited.count


def test_json_reports_actions(folder):
    typed = ("--remove-nan", *FILTER, "--sh-degree", "1")
    status, out, _ = folder.run("convert", "scene.ply", "o.egs", *typed, "--json")
    assert status == 0
    told = json.loads(out)
    kept = expected(read_ply("scene.ply"), "--filter=opacity>0.5").count
    assert [(a["action"], a["before"], a["after"]) for a in told["actions"]] == [
        ("remove-nan", 1500, 1500),
        ("filter opacity>0.5", 1500, kept),
        ("sh-degree 1", kept, kept),
    ]
    assert (told["gaussians"], told["sh_degree"]) == (kept, 1)


def test_several_inputs_are_merged(folder):
    scene = read_ply("scene.ply")
    write_ply("up.ply", turn_axes(scene.between(0, 50), "RUB"))
    status, out, _ = folder.run("convert", "scene.ply", "up.ply", "scene.egs", "o.ply", "--json")
    assert (status, json.loads(out)["input"]) == (0, ["scene.ply", "up.ply", "scene.egs"])
    merged = merge_scenes([scene, scene.between(0, 50), read_scene("scene.egs")])
    assert_same_bits(replace(read_ply("o.ply"), comments=()), replace(merged, comments=()))
    assert folder.run("convert", "up.ply", "scene.ply", "k.ply", "--coordinates=keep")[0] == 0
    kept = read_ply("k.ply")
    assert kept.coordinates == "RUB"
    np.testing.assert_array_equal(kept.positions[1, 50:], -scene.positions[1])
    line = folder.refuse("convert", "scene.ply", "o.ply", "o.ply", "--overwrite")
    assert "o.ply: input and output are the same file" in line


def test_errors_name_the_scene(folder):
    far = "--crop-sphere=1e6,0,0,1"
    line = folder.refuse("convert", "scene.ply", "n.ply", far)
    assert line.startswith("gs-codec: error: scene.ply: --crop-sphere 1e6,0,0,1: no Gaussian is")
    line = folder.refuse("convert", "scene.ply", "scene.egs", "n.ply", far)
    assert "error: scene.ply + scene.egs: --crop-sphere" in line


def test_gaussians_with_nan_can_be_removed_before_encoding(folder):
    scene = read_ply("scene.ply")
    scene.opacity[0, 5] = np.nan
    write_ply("nan.ply", scene)
    assert "not finite: 1 in opacity" in folder.refuse("convert", "nan.ply", "o.ply")
    assert folder.run("convert", "nan.ply", "o.ply", "--remove-nan")[0] == 0
    assert_same_bits(read_ply("o.ply"), scene.take(np.arange(1500) != 5))


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("convert scene.ply o.ply --cameras cameras.json", "--cameras needs one of --remove-flo"),
        ("convert scene.ply o.ply --remove-floaters --cameras auto", "'auto' has no effect on --r"),
        ("convert scene.ply o.ply --scale 2 --views 3", "--views needs one of --remove-floaters"),
        ("convert scene.ply o.ply --keep 50% --width 9", "--width has no effect without --cameras"),
        ("convert scene.ply o.rad --max-memory 1GB", "--max-memory has no effect on o.rad"),
        ("convert scene.ply o.ply --keep 9% --max-memory 1GB", "--keep 9%: needs the whole scene"),
        ("convert scene.ply o.ply --format egs", "--format has no effect on o.ply"),
        ("convert scene.ply o.ply --scale two", "--scale two: expected 1 number"),
        ("convert scene.ply o.ply --scale", "requires an argument"),
        ("convert scene.ply o.ply --remove-nan=1", "does not take a value"),
        ("convert - - o.ply", "-: stdin is one scene, expected '-' once"),
        ("encode scene.ply o.egs --scale 2 --cameras cameras.json", "--scale 2: the given cameras"),
        ("encode scene.ply o.egs --keep 9% --max-memory 1GB", "--keep 9%: needs the whole scene"),
        ("batch scene.ply out --scale 2 --cameras cameras.json", "--scale 2: the given cameras"),
        ("batch scene.ply out --format ply -p s", "--profile has no effect on ply"),
        ("batch scene.ply out --format ply --prune 9", "--prune has no effect on ply"),
        ("batch scene.ply out --format csv --target-ratio 9", "--target-ratio has no effect on"),
        ("batch scene.ply out --format ply --gt-images i", "--gt-images has no effect on ply"),
        ("batch scene.ply out --format ply --cameras cameras.json", "--cameras needs one of"),
        ("batch scene.ply out --format pt --max-memory 1GB", "--max-memory has no effect on pt"),
    ],
)  # fmt: skip
def test_invalid_actions_are_refused(folder, typed, said):
    assert said in folder.refuse(*typed.split())


def test_encode_applies_actions_first(folder):
    typed = [CROP, *FILTER]
    status, out, err = folder.run("encode", "scene.ply", "o.egs", *typed, "--json")
    assert (status, err.count("removed")) == (0, 2)
    edited = expected(read_ply("scene.ply"), CROP, "--filter=opacity>0.5")
    write_ply("edited.ply", edited)
    encode_file("edited.ply", "expected.egs")
    assert (folder.path / "o.egs").read_bytes() == (folder.path / "expected.egs").read_bytes()
    told = json.loads(out)
    assert told["ratio"] == pytest.approx(edited.float_bytes / told["output_bytes"])


def piped(*arguments: str, data: bytes = b"") -> bytes:
    command = [sys.executable, "-m", "gs_codec", *arguments]
    return subprocess.run(command, input=data, capture_output=True, check=True).stdout


@pytest.mark.thorough
def test_scenes_pass_through_pipes(folder):
    data = piped("convert", "-", "-", TURN, data=(folder.path / "scene.ply").read_bytes())
    (folder.path / "turned.ply").write_bytes(data)
    assert_same_bits(read_ply("turned.ply"), expected(read_ply("scene.ply"), TURN))
    coded = piped("convert", "-", "-", "--format", "egs", data=data)
    encode_file("turned.ply", "turned.egs")
    assert coded == (folder.path / "turned.egs").read_bytes()


@pytest.mark.parametrize("target", ["o.ply", "o.egs", "o.csv"])
@pytest.mark.parametrize("source", ["scene.ply", "scene.egs"])
def test_results_are_the_same_below_a_memory_limit(folder, monkeypatch, source, target):
    actions = [Action("crop-box", "-9,-9,-9,9,9,1"), Action("rotate", "1,2,3"),
               Action("filter", "opacity>0.1"), Action("sh-degree", "2"), Action("sort", "morton"),
               Action("remove-nan")]  # fmt: skip
    convert_file([source, "decoded.ply"], f"whole-{target}", actions=actions)
    monkeypatch.setattr(arrays, "_LARGE", 0)
    monkeypatch.setattr(arrays, "_SEGMENT", 5000)
    monkeypatch.setattr("gs_codec.codecs.decode._SLAB", 300)
    monkeypatch.setattr(memory_limit, "_check", lambda least, what: None)
    monkeypatch.setattr(memory_limit, "_FIXED", -(10**9))
    convert_file([source, "decoded.ply"], target, actions=actions, max_memory=1)
    assert (folder.path / target).read_bytes() == (folder.path / f"whole-{target}").read_bytes()
    with pytest.raises(InvalidInput, match="max-memory: expected one of"):
        convert_file(source, "o.rad", max_memory=1)


def test_editing_below_a_limit_uses_files_instead_of_memory(tmp_path, monkeypatch):
    """Arrays that grow with the scene are in files, from reader to writer."""
    write_ply(tmp_path / "scene.ply", random_scene(3000, 3, seed=2))
    monkeypatch.setattr(arrays, "_LARGE", 0)
    held: list[bool] = []
    write = write_ply

    def written(path, scene):
        held.extend(not plane.flags.owndata for plane in (scene.positions, scene.f_rest))
        return write(path, scene)

    monkeypatch.setattr("gs_codec.formats.ply.writer.write_ply", written)
    actions = [Action("crop-sphere", "0,0,0,2"), Action("rotate", "1,2,3")]
    convert_file(tmp_path / "scene.ply", tmp_path / "o.ply", actions=actions, max_memory=10**10)
    assert held == [True, True]


def test_batches_edit_and_convert(folder):
    (folder.path / "in").mkdir()
    for name in ("scene.ply", "scene.egs"):
        (folder.path / name).rename(folder.path / "in" / name.replace("scene", name[-3:]))
    typed = ["in", "out", *FILTER, CROP, "--jobs", "1"]
    status, out, err = folder.run("batch", *typed, "--format", "ply")
    assert (status, out.startswith("2 scenes converted; ")) == (0, True), err
    for name in ("ply.ply", "egs.egs"):
        edited = expected(read_scene(f"in/{name}"), "--filter=opacity>0.5", CROP)
        assert_same_bits(
            replace(read_ply(f"out/{name[:3]}.ply"), comments=()), replace(edited, comments=())
        )
    told = [
        json.loads(line) for line in (folder.path / "out/report.jsonl").read_text().splitlines()
    ]
    assert all(record["changed"]["removed"] == 1500 - record["gaussians"] for record in told)
    status, out, _ = folder.run("batch", "in", "coded", *FILTER, CROP, "--jobs", "1")
    assert out.startswith("1 scene encoded")
    convert_file("out/ply.ply", "expected.egs", Config(extra="error"))
    assert (folder.path / "coded/ply.egs").read_bytes() == (
        folder.path / "expected.egs"
    ).read_bytes()


@pytest.mark.thorough
def test_batches_resume_depending_on_files_of_actions(folder):
    def matrix(scale: float) -> None:
        rows = (scale * np.eye(3, 4)).tolist()
        (folder.path / "m.json").write_text(json.dumps(rows))

    typed = ["batch", "scene.ply", "out", "--transform", "m.json", "--jobs", "1", "--resume"]
    matrix(2.0)
    assert folder.run(*typed)[1].startswith("1 scene encoded")
    assert "1 already done" in folder.run(*typed)[1]
    matrix(3.0)
    assert folder.run(*typed)[1].startswith("1 scene encoded")


@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        ("gs-codec con", ["convert"]),
        ("gs-codec convert --crop", ["--crop-box", "--crop-sphere"]),
        ("gs-codec inspect --hist", ["--histogram"]),
    ],
)
def test_shells_complete_commands_and_options(typed, completed):
    number = str(len(typed.split()) - 1)
    asked = {"_GS_CODEC_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": number}
    program = Path(sys.executable).with_name("gs-codec")
    done = subprocess.run(
        [program], env=os.environ | asked, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == completed


@pytest.mark.parametrize(
    "cameras", [[], ["--cameras", "cameras.json"], thorough(["--cameras", "auto"])]
)
@pytest.mark.parametrize("action", [["--gaussians", "600"], ["--keep", "40%"]])
def test_scenes_are_decimated(folder, action, cameras):
    quick = ["--views", "2", "--width", "40"] * bool(cameras)
    status, out, err = folder.run("convert", "scene.ply", "o.ply", *action, *cameras, *quick)
    assert (status, out.split(",")[0]) == (0, "o.ply: 600 Gaussians"), err
    assert f"{' '.join(action)[2:]}: removed 900 of 1,500 Gaussians\n" in err
    plan = None if not cameras else Plan(cameras=cameras[1], views=2, width=40)
    assert_same_bits(read_ply("o.ply"), decimate(read_ply("scene.ply"), 600, plan))


def test_cleaning_reports_reasons(folder):
    scene = read_ply("scene.ply")
    stray = scene.take(np.array([0]))
    stray.positions[:] = 500.0
    write_ply("stray.ply", merge_scenes([scene, stray]))
    typed = ("--remove-floaters", "--keep-largest-cluster")
    status, out, err = folder.run("convert", "stray.ply", "o.ply", *typed, "--json")
    assert status == 0
    floaters, cluster = json.loads(out)["actions"]
    assert floaters["details"]["isolated"] == floaters["before"] - floaters["after"] > 0
    assert re.search(r"remove-floaters: removed \d+ of 1,501 Gaussians \(isolated \d+, hardly", err)
    clean = keep_largest_cluster(remove_floaters(read_ply("stray.ply")))
    assert (clean.count, clean.positions.max() < 500) == (cluster["after"], True)
    assert_same_bits(read_ply("o.ply"), clean)


def test_cameras_guide_cleaning(folder):
    assert folder.run(
        "convert", "scene.ply", "o.ply", "--remove-floaters", "--cameras", "cameras.json"
    )[0] == 0  # fmt: skip
    scene = read_ply("scene.ply")
    assert_same_bits(read_ply("o.ply"), remove_floaters(scene, "cameras.json"))
    with pytest.raises(InvalidInput, match="'auto'"):
        remove_floaters(scene, "auto")

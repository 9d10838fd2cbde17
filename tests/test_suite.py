"""``bench suite``: every part measured once, lines suit the report, rejected input, Ctrl-C."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from scenes import estimate_few_cameras, random_scene
from typer.testing import CliRunner

import gs_codec
from gs_codec.bench import measure, measured_scenes
from gs_codec.bench import processes as apart
from gs_codec.bench import processes as scaling
from gs_codec.bench import side_by_side as beside
from gs_codec.bench.measured_scenes import open_with_cameras
from gs_codec.bench.peers import AbsentPeer
from gs_codec.bench.suite import measurements
from gs_codec.bench.suite.measurements import GROUPS, Options, run_suite, scene_line
from gs_codec.bench.suite.suite_tables import escaped
from gs_codec.cameras.camera_files import read_cameras
from gs_codec.cameras.image_files import write_png
from gs_codec.cli import main
from gs_codec.cli.main import app
from gs_codec.config import PROFILE_CHOICES, Config
from gs_codec.errors import InvalidInput, MissingTool
from gs_codec.formats.ply.writer import write_ply
from gs_codec.rendering.renderer import render
from samples.generate import generate, orbit_cameras

pytestmark = pytest.mark.slow

WIDTH = 36


def make_scene(folder: Path, count: int, views: int = 0, photographs: bool = False) -> Path:
    """A folder of a scene, as trainers leave it."""
    folder.mkdir(parents=True)
    scene, path = generate(count, 1, seed=count), folder / "point_cloud.ply"
    write_ply(path, scene)
    if views:
        (folder / "cameras.json").write_text(json.dumps(orbit_cameras(views)))
    if photographs:
        (folder / "images").mkdir()
        for camera in read_cameras(folder / "cameras.json"):
            small = camera.resized(WIDTH, 24)
            write_png(folder / "images" / f"{camera.name}.png", render(scene, small).colour * 0.9)
    return path


def run_here(arguments: list[str]) -> apart.Usage:
    """Run in this process; otherwise there would be dozens of processes."""
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    return apart.Usage(0.5, 0.25, 100_000_000)


def stand_in(patch: pytest.MonkeyPatch) -> None:
    """Use fewer views, and stand-ins for other codecs: quick, exact, slow, and missing."""

    def peers(extra, threads):
        other, exact = beside.our_codecs([Config("paper-s"), Config("lossless")])
        slow = replace(other, name="slow", once=True, own_process=True)
        others = [replace(other, name="other v1"), replace(exact, name="exact v2"), slow]
        return [*others, AbsentPeer("third", "third: get it")]

    for module in (measure, scaling):
        patch.setattr(module, "run_in_process", run_here)
    patch.setattr(measurements, "find_peers", peers)
    patch.setattr(measurements, "SIZES", (150, 300))
    patch.setattr(measurements, "REFINED", (10.0, 5000.0))
    patch.setattr(beside, "_ITERATIONS", 5)
    patch.setattr(beside, "_compile", lambda *_: None)
    patch.setattr(measured_scenes, "_MEASURED", 3)
    patch.setattr(measured_scenes, "_ENCODED_BY", 6)
    estimate_few_cameras(patch)


IN_OTHERS = ("ours as spz v4, m", "ours as sog, m", "ours as compressed.ply, m")


@pytest.fixture(scope="module")
def suite(tmp_path_factory) -> tuple[list[dict], str, Path]:
    """Lines, stderr, and the folder: one scene with photographs, one with its own views only."""
    folder = tmp_path_factory.mktemp("suite")
    scenes = [make_scene(folder / "plain", 400), make_scene(folder / "shot", 300, 9, True)]
    out = folder / "new" / "out"
    options = ["--out", str(out), "--repeats", "1", "--width", str(WIDTH), "--threads", "2"]
    arguments = ["bench", "suite", *map(str, scenes), *options]
    with pytest.MonkeyPatch.context() as patch:
        stand_in(patch)
        patch.setattr(sys, "argv", ["gs-codec", *arguments])
        result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    lines = [json.loads(line) for line in (out / "suite.jsonl").read_text().splitlines()]
    printed = [line for line in result.stdout.splitlines() if line.startswith("{")]
    assert [json.loads(line) for line in printed] == lines
    return lines, result.stderr, out


def of(lines: list[dict], kind: str, scene: str | None = None) -> list[dict]:
    return [x for x in lines if x["kind"] == kind and scene in (None, x.get("scene"))]


@pytest.mark.thorough
def test_all_kinds_of_lines_exist_and_name_their_scene(suite):
    lines, _, _ = suite
    common = {"scene", "memory", "beside", "point", "geometry"}
    for scene, others in (("shot", set()), ("plain", {"scaling", "device"})):
        assert {line["kind"] for line in lines if line.get("scene") == scene} == common | others
    assert [line["kind"] for line in lines if "scene" not in line] == ["machine"]


@pytest.mark.thorough
def test_the_first_line_identifies_the_run(suite):
    lines, _, out = suite
    machine = lines[0]
    assert (machine["repeats"], machine["skipped"]) == (1, [])
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", machine["date"])
    assert machine["command"].startswith("gs-codec bench suite ")
    assert f"--out {out} --repeats 1 --width {WIDTH} --threads 2" in machine["command"]


@pytest.mark.thorough
def test_a_scene_states_its_measuring_views(suite):
    [shot], [plain] = (of(suite[0], "scene", name) for name in ("shot", "plain"))
    assert (shot["gaussians"], shot["sh_degree"], shot["photographs"]) == (300, 1, True)
    assert (shot["cameras"], shot["measured_views"], shot["encoded_by_views"]) == (
        "cameras.json", 3, 6,
    )  # fmt: skip
    assert (shot["width"], shot["height"]) == (WIDTH, 24)
    assert (plain["cameras"], plain["measured_views"], plain["encoded_by_views"]) == ("auto", 3, 6)
    assert not plain["photographs"]
    assert plain["input_bytes"] > 400 * 4 * 23


@pytest.mark.thorough
def test_codecs_are_measured_side_by_side(suite):
    guided = [f"{profile}, camera-guided" for profile in ("l", "m", "s")]
    pruned = ["m, 39 % pruned", "m, 58.8 % pruned"]
    expected = [*PROFILE_CHOICES, *guided, "m, estimated cameras", *pruned]
    expected += ["other v1", "exact v2", "third"]
    expected += [*IN_OTHERS, *(f"{name}, camera-guided" for name in IN_OTHERS)]
    refined = [f"m, {ratio}x refined{how}" for ratio in (10, 5000) for how in ("", ", renders")]
    for scene in ("shot", "plain"):
        found = of(suite[0], "beside", scene)
        others = refined if scene == "shot" else []
        assert sorted(line["codec"] for line in found) == sorted([*expected, *others])
        assert found[-1]["absent"] == "third: get it"
        absent = [line["codec"] for line in found[:-1] if "absent" in line]
        assert sorted(absent) == sorted(name for name in others if "5000" in name)
        for line in found[:-1]:
            if "absent" in line:
                continue
            assert ("delta" in line) == (scene == "shot")
            assert line["bits_per_gaussian"] == pytest.approx(
                8 * line["output_bytes"] / line["gaussians"]
            )
        memory = of(suite[0], "memory", scene)
        assert [line["profile"] for line in memory] == list(PROFILE_CHOICES)


@pytest.mark.thorough
@pytest.mark.usefixtures("few_cameras")
def test_estimated_cameras_are_those_of_encode(suite):
    lines, _, out = suite
    ply = out.parents[1] / "shot" / "point_cloud.ply"
    data = gs_codec.encode(gs_codec.read(ply), plan=gs_codec.Plan(cameras="auto", views=6))
    sizes = {line["codec"]: line.get("output_bytes") for line in of(lines, "beside", "shot")}
    assert sizes["m, estimated cameras"] == len(data) != sizes["m, camera-guided"]


@pytest.mark.thorough
def test_pruned_scenes_are_smaller_than_all_of_them(suite):
    for scene in ("shot", "plain"):
        bits = {line["codec"]: line.get("output_bytes") for line in of(suite[0], "beside", scene)}
        assert bits["m, 58.8 % pruned"] < bits["m, 39 % pruned"] < bits["m, camera-guided"]


@pytest.mark.thorough
def test_measured_profiles_become_points_unchanged(suite):
    for scene in ("shot", "plain"):
        measured = {line["codec"]: line for line in of(suite[0], "beside", scene)}
        found = of(suite[0], "point", scene)
        named = [line for line in found if line["point"] in PROFILE_CHOICES]
        assert len(named) == 9
        for line in named:
            guided = ", camera-guided" if line["curve"] == "camera-guided" else ""
            same = {"kind": "beside"}
            assert measured[line["point"] + guided].items() <= (line | same).items()


@pytest.mark.thorough
def test_curves_reach_each_other_or_end(suite):
    for scene in ("shot", "plain"):
        curves: dict[str, dict[str, float]] = {}
        for line in of(suite[0], "point", scene):
            curves.setdefault(line["curve"], {})[line["point"]] = line["mean"]["psnr"]
        assert list(curves) == ["paper", "camera-free", "camera-guided"]
        others = [
            line["mean"]["psnr"]
            for line in of(suite[0], "beside", scene)
            if not beside.is_ours(line["codec"]) and line.get("mean", {}).get("psnr") is not None
        ]
        finest = max(curves["paper"]["paper-l"], *others)
        for points in (curves["camera-free"], curves["camera-guided"]):
            assert max(points.values()) >= finest or "l, steps / 4" in points
            assert ("l, steps / 2" in points) == (max(points[p] for p in "lms") < finest)
            named = [points[p] for p in "lms"]
            assert max(curves["paper"].values()) >= max(named) or (
                "paper-l + 2 bits" in curves["paper"]
            )


@pytest.mark.thorough
def test_device_measurements_are_absent_without_a_device(suite):
    found = of(suite[0], "device")
    if any("absent" not in line for line in found):
        pytest.skip("a device is here")
    assert [(line["scene"], line["work"]) for line in found] == [
        ("plain", "decoding"),
        ("plain", "refining"),
    ]
    report = (suite[2] / "report.md").read_text()
    for line in found:
        assert line["absent"].startswith(f"{line['work']} on a device: ")
        assert escaped(line["absent"]) in report


@pytest.mark.thorough
def test_costs_grow_over_the_largest_scene_tiled(suite):
    found = of(suite[0], "scaling")
    expected = {(profile, size) for profile in ("m", "paper-m") for size in (150, 300)}
    assert {(line["profile"], line["gaussians"]) for line in found} == expected
    for line in found:
        assert line["scene"] == "plain"
        assert line["float_bytes"] == 4 * 23 * line["gaussians"]
        assert line["encode"] == {"seconds": 0.5, "cpu_seconds": 0.25, "peak_bytes": 100_000_000}


@pytest.mark.thorough
def test_positions_are_compared_with_open3ds_octree(suite):
    for scene, count in (("shot", 300), ("plain", 400)):
        ours, theirs = of(suite[0], "geometry", scene)
        assert (ours["coder"], theirs["coder"]) == ("count tree", "Open3D's Octree")
        assert (ours["depth"], theirs["depth"]) == (16, 10)
        assert ours["gaussians"] == theirs["gaussians"] == count
        steps = {"build_seconds", "walk_seconds"}
        assert {key for key in ours if key.endswith("_seconds")} == steps | {"decode_seconds"}
        assert {key for key in theirs if key.endswith("_seconds")} == steps
        assert min(ours[key] for key in steps) > 0
        # A point takes less than its 48 bits; leaves are single or shared.
        assert 2 * count < ours["bytes"] < 6 * count
        assert 10 < theirs["nodes"] <= 1 + 10 * count


@pytest.mark.thorough
def test_progress_and_absent_codecs_are_reported(suite):
    _, said, out = suite
    assert re.search(r"^ *\d+:\d\d shot: codecs compared$", said, re.MULTILINE)
    assert re.search(r"^ *\d+:\d\d plain: scenes of growing size$", said, re.MULTILINE)
    assert "shot: scenes of growing size" not in said
    assert said.count("third: get it") == 1
    assert said.splitlines()[-1] == f"report: {out / 'report.md'}"


@pytest.mark.thorough
def test_the_report_is_written(suite):
    _, _, out = suite
    page = (out / "report.md").read_text()
    for text in (
        "## shot (300, 1)",
        "## plain (400, 1)",
        "## Positions",
        "| shot | count tree | 16 |",
        "39 % pruned",
        "third: get it",
    ):
        assert text in page
    table = (out / "answers.md").read_text()
    assert "plain, " in table
    for picture in ("rate-shot", "time-plain", "frontier-plain", "scaling"):
        assert (out / f"{picture}.png").stat().st_size > 1000


def test_skipped_groups_are_not_measured(tmp_path, monkeypatch):
    stand_in(monkeypatch)
    path = make_scene(tmp_path / "scene", 100, 6)
    told: list[str] = []
    options = Options((path,), 1, None, WIDTH, frozenset(GROUPS) - {"curves", "codecs"})
    lines = list(run_suite(options, "again", told.append))
    assert {line["kind"] for line in lines} == {"machine", "scene", "beside", "point"}
    assert lines[0]["skipped"] == sorted(options.skip)
    assert [line["codec"] for line in of(lines, "beside")] == [*PROFILE_CHOICES, *IN_OTHERS]
    assert {line["curve"] for line in of(lines, "point")} == {"paper", "camera-free"}
    assert told == ["scene: codecs compared", "scene: rate-quality curves"]


def test_help_names_every_group():
    alone = CliRunner().invoke(app, ["bench", "suite", "-h"])
    assert alone.exit_code == 0
    for group in GROUPS:
        assert group in alone.stdout


def test_marked_cameras_are_held_out(tmp_path):
    path = make_scene(tmp_path / "scene", 50, 6)
    cameras = orbit_cameras(6)
    for number, camera in enumerate(cameras):
        camera["split"] = "test" if number in (1, 4) else "train"
    (tmp_path / "scene" / "cameras.json").write_text(json.dumps(cameras))
    measured = open_with_cameras(path, WIDTH)
    assert [camera.name for camera in measured.cameras] == ["00001", "00004"]
    assert scene_line(measured)["encoded_by_views"] == 4


def test_one_camera_measures_and_guides(tmp_path):
    line = scene_line(open_with_cameras(make_scene(tmp_path / "scene", 50, 1), WIDTH))
    assert (line["measured_views"], line["encoded_by_views"]) == (1, 1)


def test_photographs_of_other_cameras_are_refused(tmp_path):
    path = make_scene(tmp_path / "scene", 50, 3)
    (tmp_path / "scene" / "images").mkdir()
    with pytest.raises(InvalidInput, match="no image of 1 camera"):
        open_with_cameras(path, WIDTH)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "no scenes given, .*`make suite`"),
        (["missing.ply"], "missing.ply"),
        (["a/scene.ply", "b/scene.ply"], "b/scene.ply: has the same name 'scene' as a/scene.ply"),
        (["a/scene.ply", "--threads", "0"], "threads 0: expected"),
        (["a/scene.ply", "--width", "0"], "width 0: expected"),
        (["a/scene.ply", "--skip", "lunch"], "--skip lunch: expected one of codecs, curves, "),
        (["a/scene.ply", "--out", "file"], "file"),
        (["a/scene.ply", "--out", "taken"], "taken: not empty; choose another folder"),
        (["a/scene.ply", "--out", "taken", "--overwrite"], "taken/suite.jsonl: a directory"),
    ],
)
def test_invalid_requests_are_refused_before_the_work(tmp_path, monkeypatch, arguments, message):
    for name in "ab":
        (tmp_path / name).mkdir()
        write_ply(tmp_path / name / "scene.ply", random_scene(20, 0, seed=1))
    (tmp_path / "file").touch()
    (tmp_path / "taken" / "suite.jsonl").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    given = arguments if "--out" in arguments else [*arguments, "--out", "out"]
    result = CliRunner().invoke(app, ["bench", "suite", *given])
    assert isinstance(result.exception, InvalidInput)
    assert re.search(message, str(result.exception))
    assert result.stdout == ""
    assert not (tmp_path / "out").exists()


def test_without_matplotlib_nothing_is_started(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    result = CliRunner().invoke(app, ["bench", "suite", "x.ply", "--out", str(tmp_path / "out")])
    assert isinstance(result.exception, MissingTool)
    assert not (tmp_path / "out").exists()


def test_ctrl_c_keeps_finished_measurements(tmp_path, monkeypatch, capsys):
    stand_in(monkeypatch)
    path, out = make_scene(tmp_path / "scene", 60), tmp_path / "out"

    def measure_and_stop(*_):
        yield {"kind": "memory", "scene": "scene"}
        raise KeyboardInterrupt

    monkeypatch.setitem(measurements.STAGES, "codecs", ("codecs", measure_and_stop))
    arguments = ["gs-codec", "bench", "suite", str(path), "--out", str(out), "--width", "36"]
    monkeypatch.setattr(sys, "argv", arguments)
    with pytest.raises(SystemExit) as stopped:
        main.main()
    assert stopped.value.code == 130
    lines = [json.loads(line) for line in (out / "suite.jsonl").read_text().splitlines()]
    assert lines[-1] == {"kind": "memory", "scene": "scene"}
    assert lines[0]["kind"] == "machine"
    assert not (out / "report.md").exists()
    assert capsys.readouterr().err.endswith("gs-codec: interrupted\n")


def test_make_suite_measures_samples():
    text = (Path(__file__).parents[1] / "Makefile").read_text()
    recipe = text.partition("\nsuite:")[2].partition("\n\n")[0]
    assert "samples/generate.py" in recipe
    assert "bench suite" in recipe
    assert "$(SCENES)" in recipe

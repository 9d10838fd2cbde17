"""``bench suite``: every part measured once, lines as the report wants them, refusals, Ctrl-C."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest
from scenes import random_scene
from typer.testing import CliRunner

from gs_codec import paper
from gs_codec.bench import ablated, apart, held_out, host, measure, points, scaling, start
from gs_codec.bench.beside import our_codec
from gs_codec.bench.curves import Curve
from gs_codec.bench.equal import compare_at_equal_quality
from gs_codec.bench.peers import AbsentPeer
from gs_codec.bench.suite import stages
from gs_codec.bench.suite.options import GROUPS, Options
from gs_codec.bench.suite.report import write_report
from gs_codec.bench.suite.run import run_suite
from gs_codec.bench.suite.scenes import open_scene
from gs_codec.cli import main
from gs_codec.cli.main import app
from gs_codec.config import PROFILE_CHOICES, Config
from gs_codec.errors import InvalidInput, MissingTool
from gs_codec.io.ply import write_ply
from gs_codec.rendering.camera_files import read_cameras
from gs_codec.rendering.images import write_png
from gs_codec.rendering.renderer import render
from samples.generate import generate, orbit_cameras

REPORT = "gs_codec.bench.suite.report"
WIDTH = 36


def make_scene(folder: Path, count: int, views: int = 0, photographs: bool = False) -> Path:
    """A scene in a folder as trainers leave it."""
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
    """In place of a process of its own, of which there would be dozens."""
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    return apart.Usage(0.5, 0.25, 100_000_000)


def stand_in(patch: pytest.MonkeyPatch) -> list[tuple[list[dict], Path]]:
    """Fewer views, a peer that is there and one that is not; what the report is written from."""

    def peers(extra, threads):
        other = replace(our_codec(Config("paper-s")), name="other v1")
        exact = replace(our_codec(Config("lossless")), name="exact v2")
        return [other, exact, AbsentPeer("third", "third: get it")]

    reported: list[tuple[list[dict], Path]] = []
    report = ModuleType(REPORT)
    report.write_report = lambda lines, folder: reported.append((lines, folder))  # type: ignore[attr-defined]
    patch.setitem(sys.modules, REPORT, report)
    for module in (measure, points, scaling, start):
        patch.setattr(module, "run_apart", run_here)
    patch.setattr(stages, "find_peers", peers)
    patch.setattr(held_out, "_MEASURED", 3)
    patch.setattr(held_out, "_ENCODED_BY", 6)
    patch.setattr(stages, "SIZES", (150, 300))
    return reported


@pytest.fixture(scope="module")
def suite(tmp_path_factory) -> tuple[list[dict], str, Path]:
    """Lines, what was said, and the folder: a scene with photographs, and one of its own views."""
    folder = tmp_path_factory.mktemp("suite")
    scenes = [make_scene(folder / "plain", 400), make_scene(folder / "shot", 300, 9, True)]
    out = folder / "new" / "out"
    options = ["--out", str(out), "--repeats", "1", "--width", str(WIDTH), "--threads", "2"]
    with pytest.MonkeyPatch.context() as patch:
        reported = stand_in(patch)
        result = CliRunner().invoke(app, ["bench", "suite", *map(str, scenes), *options])
    assert result.exit_code == 0, result.output
    lines = [json.loads(line) for line in (out / "suite.jsonl").read_text().splitlines()]
    assert reported == [(lines, out)]
    printed = [line for line in result.stdout.splitlines() if line.startswith("{")]
    assert [json.loads(line) for line in printed] == lines
    return lines, result.stderr, out


def of(lines: list[dict], kind: str, scene: str | None = None) -> list[dict]:
    return [x for x in lines if x["kind"] == kind and scene in (None, x.get("scene"))]


def test_every_kind_of_line_is_there_and_says_its_scene(suite):
    lines, _, _ = suite
    general = {"machine", "paper"}
    common = {
        "scene", "codec", "error", "memory", "beside", "point", "gain", "bd-rate", "equal", "part",
        "points", "ablation",
    }  # fmt: skip
    for scene, others in (("shot", {"pruned"}), ("plain", {"coder", "scaling", "growth", "start"})):
        found = {line["kind"] for line in lines if line["kind"] not in general}
        here = {line["kind"] for line in lines if line.get("scene") == scene}
        assert here == common | others
        assert here <= found
    assert {line["kind"] for line in lines if "scene" not in line} == general
    assert lines[0]["kind"] == "machine"


def test_the_run_can_be_told_from_its_first_line(suite):
    lines, _, out = suite
    machine = lines[0]
    assert machine["processor"]
    assert machine["cores"] >= 1
    assert machine["memory_bytes"] > 1e8
    assert machine["packages"].keys() >= {"numpy", "numba", "pcodec"}
    assert (machine["seed"], machine["repeats"]) == (0, 1)
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", machine["date"])
    assert machine["command"].startswith("gs-codec bench suite ")
    assert f"--out {out} --repeats 1 --seed 0 --threads 2 --width {WIDTH}" in machine["command"]
    assert machine["commit"] is None or re.fullmatch(r"[0-9a-f]{40}(\+changes)?", machine["commit"])


def test_a_scene_says_what_views_it_is_measured_in(suite):
    [shot], [plain] = (of(suite[0], "scene", name) for name in ("shot", "plain"))
    assert (shot["gaussians"], shot["sh_degree"], shot["photographs"]) == (300, 1, True)
    assert (shot["cameras"], shot["measured_views"], shot["encoded_by_views"]) == (
        "cameras.json", 3, 6,
    )  # fmt: skip
    assert (shot["width"], shot["height"]) == (WIDTH, 24)
    assert (plain["cameras"], plain["measured_views"], plain["encoded_by_views"]) == ("auto", 3, 6)
    assert not plain["photographs"]
    assert plain["ply_bytes"] > 400 * 4 * 23


def test_codecs_stand_beside_each_other(suite):
    views = [f"{profile}, by views" for profile in ("l", "m", "s")]
    for scene in ("shot", "plain"):
        found = of(suite[0], "beside", scene)
        names = [line["codec"] for line in found]
        assert sorted(names) == sorted([*PROFILE_CHOICES, *views, "other v1", "exact v2", "third"])
        assert found[-1]["absent"] == "third: get it"
        assert all(("delta" in line) == (scene == "shot") for line in found[:-1])
        profiles = [line["profile"] for line in of(suite[0], "codec", scene)]
        assert profiles == list(PROFILE_CHOICES)


def test_pruned_scenes_have_the_fields_of_the_others(suite):
    other = next(line for line in of(suite[0], "beside") if line["codec"] == "m, by views")
    found = of(suite[0], "pruned")
    assert [line["codec"] for line in found] == ["m, 39 % pruned", "m, 58.8 % pruned"]
    for line, kept in zip(found, (183, 124), strict=True):
        assert line.keys() - {"kept"} == other.keys()
        assert (line["gaussians"], line["kept"]) == (300, kept)
        assert line["bits_per_gaussian"] == pytest.approx(8 * line["file_bytes"] / 300)
        assert line["bits_per_gaussian"] < other["bits_per_gaussian"]


def test_profiles_that_were_measured_are_points_as_they_are(suite):
    for scene in ("shot", "plain"):
        measured = {line["codec"]: line for line in of(suite[0], "beside", scene)}
        found = of(suite[0], "point", scene)
        named = [line for line in found if line["point"] in PROFILE_CHOICES]
        assert len(named) == 9
        for line in named:
            views = ", by views" if line["curve"] == "by views" else ""
            other = measured[line["point"] + views]
            assert line["bits_per_gaussian"] == other["bits_per_gaussian"]
            assert line["mean"] == other["mean"]
            assert line["encode_seconds"] == other["encode_seconds"]["median"]
            assert line["by_views"] == bool(views)


def test_others_stand_beside_curves_at_their_quality(suite):
    for scene in ("shot", "plain"):
        found = of(suite[0], "equal", scene)
        lossy, exact = found[:-1], found[-1]
        assert [line["curve"] for line in lossy] == ["paper", "by attributes", "by views"]
        for line in lossy:
            assert line["codec"] == "other v1"
            here = [x for x in of(suite[0], "point", scene) if x["curve"] == line["curve"]]
            expected = Curve.through_lines(here).bits_at(line["psnr"])
            assert line["curve_bits_per_gaussian"] == expected
        # The other is paper-s under another name.
        assert lossy[0]["saving_percent"] == pytest.approx(0, abs=1e-6)
        assert (exact["codec"], exact["curve"], exact["psnr"]) == (
            "exact v2", "lossless", None,
        )  # fmt: skip


def _beside(codec: str, bits: float, psnr: float | None) -> dict:
    return {
        "kind": "beside", "scene": "x", "codec": codec, "bits_per_gaussian": bits,
        "mean": {"psnr": psnr},
    }  # fmt: skip


def test_the_smallest_scene_is_measured_first(suite):
    lines = suite[0]
    assert [line["scene"] for line in of(lines, "scene")] == ["plain", "shot"]
    measured = [line["scene"] for line in of(lines, "codec")]
    assert measured == ["shot"] * len(PROFILE_CHOICES) + ["plain"] * len(PROFILE_CHOICES)


def test_slow_ones_that_failed_are_not_tried_on_larger_scenes(monkeypatch):
    quick = our_codec(Config("paper-s"))
    found = [replace(quick, name="slow", once=True), replace(quick, name="quick")]
    monkeypatch.setattr(stages, "find_peers", lambda *_: [*found, AbsentPeer("none", "none: no")])
    options = Options((Path("x.ply"),))
    assert stages._others(options, []) == [*found, AbsentPeer("none", "none: no")]
    lines = [
        {"kind": "beside", "scene": "a", "codec": name, "absent": f"{name} of a: did not end"}
        for name in ("slow", "quick")
    ]
    lines.append(lines[0] | {"scene": "b", "absent": "slow of a: did not end; not tried"})
    first, second, _ = stages._others(options, lines)
    why = "slow of a: did not end; not tried on larger scenes"
    assert first == AbsentPeer("slow", why)
    assert second == found[1]
    assert stages._others(Options((Path("x.ply"),), skip=frozenset({"peers"})), lines) == []


def test_what_curves_do_not_reach_is_out_of_range():
    points = [
        {"kind": "point", "curve": "paper", "bits_per_gaussian": bits, "mean": {"psnr": psnr}}
        for psnr, bits in ((40.0, 64.0), (50.0, 128.0))
    ]
    lines = [*points, _beside("a", 100.0, 45.0), _beside("b", 100.0, 39.0), _beside("m", 1.0, 45.0)]
    a, b = compare_at_equal_quality([*lines, {"kind": "beside", "codec": "c", "absent": "c: no"}])
    assert a["curve_bits_per_gaussian"] == pytest.approx(2**6.5)
    assert a["saving_percent"] == pytest.approx(100 - 2**6.5)
    assert (b["codec"], b["curve_bits_per_gaussian"], b["saving_percent"]) == ("b", None, None)
    [only] = compare_at_equal_quality([_beside("zip", 1000.0, None)])
    assert (only["curve"], only["curve_bits_per_gaussian"]) == ("lossless", None)


def test_the_ablation_has_the_papers_steps(suite):
    steps = list(paper.ABLATION)
    ours = [step if step != "optimisation" else "colour refit" for step in steps]
    for scene, photographs in (("shot", True), ("plain", False)):
        found = of(suite[0], "ablation", scene)
        assert [line["step"] for line in found] == ours
        assert {line["photographs"] for line in found} == {photographs}
        kept = round(found[0]["gaussians"] * (1 - ablated.STEPS.prune_importance / 100))
        assert abs(found[1]["gaussians"] - kept) <= 1
        assert found[-1]["file_bytes"] < found[0]["file_bytes"] / 4
        assert found[-1]["quality"]["psnr"] > 10
    published = [line["step"] for line in of(suite[0], "paper") if "step" in line]
    assert published == steps


def test_published_figures_are_lines(suite):
    found = of(suite[0], "paper")
    assert {line["device"]: line["encode"] for line in found if "device" in line} == {
        "CPU": 16.4, "RTX 3090": 3.6,
    }  # fmt: skip
    entropies = {line["group"]: line["entropy_bits"] for line in found if "group" in line}
    assert entropies == paper.ENTROPY_BITS


def test_costs_grow_over_the_largest_scene_tiled(suite):
    found = of(suite[0], "scaling")
    expected = [("m", 150), ("m", 300), ("paper-m", 150), ("paper-m", 300)]
    assert [(line["profile"], line["gaussians"]) for line in found] == expected
    assert {tuple(line["options"]) for line in found} == {("--threads", "2")}
    assert [line["profile"] for line in of(suite[0], "growth")] == ["m", "paper-m"]


def test_every_kind_of_command_is_started(suite):
    found = of(suite[0], "start")
    commands = ["--help", "encode", "decode", "verify", "inspect", "convert", "compare"]
    assert [line["command"] for line in found] == commands
    assert {line["scene"] for line in found} == {"plain"}
    assert all(line["cpu_seconds"]["median"] == 0.25 for line in found)


def test_what_is_measured_and_found_is_told(suite):
    _, said, out = suite
    assert re.search(r"^ *\d+:\d\d shot: codecs beside each other$", said, re.MULTILINE)
    assert re.search(r"^ *\d+:\d\d plain: growing scenes$", said, re.MULTILINE)
    assert "shot: growing scenes" not in said
    assert "plain: pruned scenes" not in said
    assert re.search(r"^shot, other v1 +\d+\.\d+ +\d+\.\d( +\S+){3}$", said, re.MULTILINE)
    assert re.search(r"^plain, by views +BD-rate", said, re.MULTILINE)
    assert said.count("third: get it") == 1
    assert said.splitlines()[-1] == f"report: {out / 'report.html'}"


def test_the_report_takes_these_lines(suite, tmp_path):
    write_report(suite[0], tmp_path)
    page = (tmp_path / "report.html").read_text().replace("\xa0", " ")
    for text in ("shot", "plain", "other v1", "39 % pruned", "third: get it", "bench suite"):
        assert text in page
    table = (tmp_path / "headline.md").read_text()
    assert "plain (400, 1)" in table
    assert "shot (300, 1)" in table


def test_groups_left_out_are_lines_and_nothing_else(tmp_path, monkeypatch):
    stand_in(monkeypatch)
    path = make_scene(tmp_path / "scene", 200, 6, True)
    told: list[str] = []
    left_out = frozenset(GROUPS) - {"curves"}
    options = Options((path,), repeats=1, width=WIDTH, skip=left_out)
    lines = list(run_suite(options, "again", told.append))
    kinds = {line["kind"] for line in lines}
    measured = {"scene", "codec", "error", "memory", "beside", "point", "gain", "bd-rate"}
    assert kinds == {"machine", "paper", "skipped"} | measured
    groups = [line["group"] for line in of(lines, "skipped")]
    assert groups == [group for group in GROUPS if group != "curves"]
    assert [line["codec"] for line in of(lines, "beside")] == list(PROFILE_CHOICES)
    assert {line["curve"] for line in of(lines, "point")} == {"paper", "by attributes"}
    stages_told = ["profiles", "codecs beside each other", "rate-distortion curves"]
    assert told == [f"scene: {stage}" for stage in stages_told]


def test_marked_cameras_are_held_out_as_they_say(tmp_path):
    path = make_scene(tmp_path / "scene", 50, 6)
    cameras = orbit_cameras(6)
    for number, camera in enumerate(cameras):
        camera["split"] = "test" if number in (1, 4) else "train"
    (tmp_path / "scene" / "cameras.json").write_text(json.dumps(cameras))
    measured = open_scene(path, WIDTH)
    assert [camera.name for camera in measured.cameras] == ["00001", "00004"]
    assert measured.line["encoded_by_views"] == 4


def test_one_camera_is_measured_in_and_encoded_by(tmp_path):
    line = open_scene(make_scene(tmp_path / "scene", 50, 1), WIDTH).line
    assert (line["measured_views"], line["encoded_by_views"]) == (1, 1)


def test_photographs_of_other_cameras_are_refused(tmp_path):
    path = make_scene(tmp_path / "scene", 50, 3)
    (tmp_path / "scene" / "images").mkdir()
    with pytest.raises(InvalidInput, match="no image of the 1 cameras"):
        open_scene(path, WIDTH)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "no scenes given, .*`make suite`"),
        (["missing.ply"], "missing.ply"),
        (["a/scene.ply", "b/scene.ply"], "b/scene.ply: called 'scene', as a/scene.ply is"),
        (["a/scene.ply", "--threads", "0"], "threads 0: expected"),
        (["a/scene.ply", "--width", "0"], "width 0: expected"),
        (["a/scene.ply", "--skip", "lunch"], "--skip lunch: expected one of peers, views, "),
        (["a/scene.ply", "--out", "file"], "file"),
        (["a/scene.ply", "--out", "taken"], "taken: not empty, expected another folder"),
        (["a/scene.ply", "--out", "taken", "--overwrite"], "taken/suite.jsonl: a directory"),
    ],
)
def test_what_cannot_be_done_is_refused_before_the_work(tmp_path, monkeypatch, arguments, message):
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
    assert not (tmp_path / "out" / "suite.jsonl").exists()


def test_without_matplotlib_nothing_is_begun(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    result = CliRunner().invoke(app, ["bench", "suite", "x.ply", "--out", str(tmp_path / "out")])
    assert isinstance(result.exception, MissingTool)
    assert not (tmp_path / "out").exists()


def test_ctrl_c_leaves_what_was_measured(tmp_path, monkeypatch, capsys):
    reported = stand_in(monkeypatch)
    path, out = make_scene(tmp_path / "scene", 60), tmp_path / "out"

    def measure_and_stop(*_):
        yield {"kind": "codec", "scene": "scene"}
        raise KeyboardInterrupt

    monkeypatch.setattr(stages, "measure_scene", measure_and_stop)
    arguments = ["gs-codec", "bench", "suite", str(path), "--out", str(out), "--width", "36"]
    monkeypatch.setattr(sys, "argv", arguments)
    with pytest.raises(SystemExit) as stopped:
        main.main()
    assert stopped.value.code == 130
    lines = [json.loads(line) for line in (out / "suite.jsonl").read_text().splitlines()]
    assert lines[-1] == {"kind": "codec", "scene": "scene"}
    assert lines[0]["kind"] == "machine"
    assert not reported
    assert capsys.readouterr().err.endswith("gs-codec: interrupted\n")


def test_the_suite_is_told_from_scenes(tmp_path, monkeypatch):
    runner = CliRunner()
    both = runner.invoke(app, ["bench", "--help"])
    assert both.exit_code == 0
    assert re.search(r"--peers.*Commands.*suite", both.stdout, re.DOTALL)
    alone = runner.invoke(app, ["bench", "suite", "-h"])
    assert alone.exit_code == 0
    assert "--skip" in alone.stdout
    assert "--peers" not in alone.stdout
    monkeypatch.chdir(tmp_path)
    for arguments in (["./suite"], ["-p", "paper-m", "suite"], ["other", "suite"]):
        result = runner.invoke(app, ["bench", *arguments, "--points"])
        assert isinstance(result.exception, InvalidInput), arguments
        assert "No such file" in str(result.exception)


def test_a_checkout_tells_its_commit(tmp_path, monkeypatch):
    monkeypatch.setattr(host, "__file__", str(tmp_path / "gs_codec" / "bench" / "host.py"))
    assert host.commit() is None
    (tmp_path / ".git").mkdir()
    for changes, expected in (("", "f" * 40), (" M file", "f" * 40 + "+changes")):
        said = {"rev-parse": "f" * 40, "status": changes}
        monkeypatch.setattr(host, "_git", lambda root, what, *_, said=said: said[what])
        assert host.commit() == expected
    monkeypatch.setattr(host, "_git", lambda *_: None)
    assert host.commit() is None


def test_make_suite_measures_samples():
    text = (Path(__file__).parents[1] / "Makefile").read_text()
    recipe = text.partition("\nsuite:")[2].partition("\n\n")[0]
    assert "samples/generate.py" in recipe
    assert "bench suite" in recipe
    assert "$(SCENES)" in recipe

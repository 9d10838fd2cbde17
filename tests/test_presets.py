"""The preset `entropygs` is the paper's pipeline, in every interface; and its tables."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import assert_same_floats, random_scene
from typer.testing import CliRunner

import gs_codec
from gs_codec.bench.reproduce import tables_of
from gs_codec.cli.main import app
from gs_codec.codecs import decode_scene
from gs_codec.codecs.entropygs import paper
from gs_codec.codecs.inspection import inspect_bytes
from gs_codec.config import PROFILES, Config
from gs_codec.errors import InvalidInput
from gs_codec.files.encode_file import encode_file
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import write_ply
from gs_codec.plan import Plan, Steps
from gs_codec.preparation.prune import keep_near
from gs_codec.presets import PRESETS, Preset
from samples.generate import generate, orbit_cameras

PRESET = PRESETS["entropygs"]
FEW = ["--refine", "4"]


@pytest.fixture(scope="module")
def still_life():
    return generate(700, sh_degree=1, seed=5)


@pytest.fixture
def folder(still_life, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_ply("scene.ply", still_life)
    Path("cameras.json").write_text(json.dumps(orbit_cameras(5, 40, 30)))
    return tmp_path


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_percentages_are_those_of_the_papers_sizes():
    sizes = [size for _, size in paper.ABLATION.values()][:3]
    importance, geometry = (after / before for before, after in zip(sizes, sizes[1:], strict=False))
    assert PRESET.steps.prune_importance == pytest.approx(100 * (1 - importance), abs=0.1)
    assert PRESET.steps.prune_geometry == pytest.approx(100 * (1 - geometry ** (1 / 3)), abs=0.01)


def test_the_width_gives_a_laplace_distribution_the_papers_entropy():
    """With 4 bits over this many scales on either side."""
    scales = PRESET.config.laplace_scales
    assert scales == PRESET.steps.rectify
    values = np.random.default_rng(0).laplace(0, 0.1, (9, 200_000)).astype(np.float32)
    scene = replace(random_scene(200_000, 1, seed=1), f_rest=values)
    _, report = gs_codec.codecs.encode_scene(scene, replace(PRESET.config, geometry="octree"))
    members = [cost for cost in report.costs if cost.stream == "sh1"]
    entropy = sum(cost.shannon_bits for cost in members) / len(members) / scene.count
    assert entropy == pytest.approx(paper.ENTROPY_BITS["sh-ac"], abs=0.05)
    assert {cost.model for cost in members} == {"laplace"}


def test_options_are_those_that_differ_from_the_defaults():
    assert PRESET.options() == {
        "prune_importance": 65.0, "prune_geometry": 0.2, "geometry_rule": "largest",
        "rectify": 7.5, "refine": 6000, "keep_refined": True,
        "profile": "paper-m", "geometry": "auto", "laplace_scales": 7.5,
    }  # fmt: skip
    assert Preset(Steps(), Config()).options() == {}


def test_the_preset_uses_only_the_papers_methods():
    config = PRESET.config
    assert (config.models, config.geometry, config.depths) == ("parametric", "auto", {})
    assert config.profile in PROFILES
    ours = ("prune", "prune_max_psnr_drop", "compact_sh", "refit_colour")
    assert all(getattr(PRESET.steps, name) == getattr(Steps(), name) for name in ours)


def test_the_command_is_the_library(folder, monkeypatch):
    monkeypatch.delenv("GS_CODEC_TMC3", raising=False)
    monkeypatch.setenv("PATH", "")
    views = ["--cameras", "cameras.json", *FEW]
    assert run("encode", "scene.ply", "a.egs", "--preset", "entropygs", *views).exit_code == 0
    plan = Plan(replace(PRESET.steps, refine=4), "cameras.json")
    encode_file("scene.ply", "b.egs", PRESET.config, plan)
    assert Path("a.egs").read_bytes() == Path("b.egs").read_bytes()
    # Unprepared, or with cameras only, the file has different bytes.
    encode_file("scene.ply", "c.egs", PRESET.config)
    assert Path("a.egs").read_bytes() != Path("c.egs").read_bytes()
    result = run("prepare", "scene.ply", "d.egs", "--preset", "entropygs", *views)
    assert Path("d.egs").read_bytes() == Path("a.egs").read_bytes()
    steps = ["importance pruning", "geometry pruning", "rectification", "optimisation"]
    rows = [line.split("  ")[0] for line in result.stdout.splitlines()]
    assert [row for row in rows if row in steps] == steps


def test_pruning_is_reported_in_the_order_of_the_steps(folder):
    percent = ["--prune-geometry", "5", "--prune-importance", "20", "--cameras", "cameras.json"]
    rows = run("prepare", "scene.ply", "pruned.ply", *percent).stdout.splitlines()
    assert [row.split(":")[0] for row in rows[:2]] == ["pruned by importance", "pruned by geometry"]


def test_typed_options_override_the_preset(folder):
    preset = ["--preset", "entropygs", "--cameras", "cameras.json"]
    typed = ["-p", "paper-s", "--refine", "0", "--models", "best", "--geometry", "octree"]
    assert run("encode", "scene.ply", "a.egs", *preset, *typed).exit_code == 0
    plan = Plan(replace(PRESET.steps, refine=0), "cameras.json")
    config = replace(PRESET.config, profile="paper-s", models="best", geometry="octree")
    encode_file("scene.ply", "b.egs", config, plan)
    assert Path("a.egs").read_bytes() == Path("b.egs").read_bytes()
    assert inspect_bytes(Path("a.egs").read_bytes()).profile == "paper-s"
    percent = ["--prune-importance", "10", "--refine", "0"]
    assert run("prepare", "scene.ply", "c.ply", *preset, *percent).exit_code == 0
    left = 700 - 70
    for _ in range(3):
        left -= int(left * 0.002 + 1e-6)
    assert read_ply("c.ply").count == left


def test_largest_values_are_removed_regardless_of_the_origin():
    """The paper's rule depends on the origin, ours does not."""
    scene = random_scene(1000, 0, seed=3)
    moved = replace(scene, positions=scene.positions + np.float32(50))
    kept = {rule: keep_near(scene, 5, rule).tolist() for rule in ("median", "largest")}
    assert keep_near(moved, 5, "median").tolist() == kept["median"]
    assert keep_near(moved, 5, "largest").tolist() != kept["largest"]
    limit = np.sort(np.abs(scene.positions[0]))[950]
    assert np.all(np.abs(scene.take(np.array(kept["largest"])).positions[0]) <= limit)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("encode scene.ply o.egs --preset paper", "--preset 'paper': expected one of entropygs"),
        ("encode scene.ply o.egs --preset entropygs -p m", "--preset uses paper-l, paper-m"),
        ("prepare scene.ply o.ply --preset entropygs -p l", "not profile 'l'"),
        ("batch scene.ply out --preset entropygs -p lossless", "not profile 'lossless'"),
        ("bench paper scene.ply --out . --refine 4", "not empty; choose another folder"),
        (
            "bench paper scene.ply ./scene.ply --out out",
            "has the same name 'scene' as scene.ply",
        ),
        ("bench paper none.ply --out out", "none.ply: No such file"),
    ],
)
def test_invalid_presets_are_refused(folder, arguments, message):
    result = run(*arguments.split())
    assert isinstance(result.exception, InvalidInput), result.output
    assert message in str(result.exception)


def test_a_preset_has_a_name():
    assert gs_codec.preset("entropygs") is PRESET
    with pytest.raises(InvalidInput, match="preset 'paper': expected one of entropygs"):
        gs_codec.preset("paper")


def test_a_rule_needs_something_to_prune():
    with pytest.raises(InvalidInput, match="geometry_rule: needs prune_geometry"):
        Steps(geometry_rule="largest")


# bench paper


@pytest.fixture(scope="module")
def reproduced(still_life, tmp_path_factory):
    """The folder of a run, and its output."""
    folder = tmp_path_factory.mktemp("paper")
    write_ply(folder / "still.ply", still_life)
    (folder / "cameras.json").write_text(json.dumps(orbit_cameras(6, 40, 30)))
    options = ["--out", folder / "out", *FEW]
    return folder, run("bench", "paper", folder / "still.ply", *options)


def lines_of(folder):
    return [json.loads(line) for line in (folder / "out" / "paper.jsonl").read_text().splitlines()]


def test_bench_paper_has_every_step_and_profile(reproduced):
    folder, result = reproduced
    assert result.exit_code == 0, result.output
    machine, *lines = lines_of(folder)
    assert (machine["kind"], machine["iterations"]) == ("machine", 4)
    assert {line["scene"] for line in lines} == {"still"}
    steps = [x for x in lines if x["kind"] == "step"]
    prepared = ["original", "importance pruning", "geometry pruning", "rectification"]
    coded = ["quantisation", "entropy coding", "geometry coding"]
    assert [x["step"] for x in steps if not x["profile"]] == [*prepared, "optimisation"]
    for profile in PROFILES:
        members = [x for x in steps if x["profile"] == profile]
        assert [x["step"] for x in members] == coded
        (line,) = (x for x in lines if x["kind"] == "profile" and x["profile"] == profile)
        assert members[-1]["bytes"] == line["output_bytes"]
        assert line["input_bytes"] == (folder / "still.ply").stat().st_size
        assert all(seconds > 0 for seconds in line["seconds"].values())
    sizes = [x["bytes"] for x in steps if x["profile"] in (None, "paper-m")]
    assert sizes[:5] == sorted(sizes[:5], reverse=True)
    assert max(sizes[5:]) < sizes[4] / 3


def test_the_page_shows_the_measurements(reproduced):
    folder, result = reproduced
    page = (folder / "out" / "paper.md").read_text()
    assert result.stdout.strip() == page.strip()
    assert page == tables_of(lines_of(folder))
    assert "| PSNR dB | delta-PSNR | SSIM | delta-SSIM | LPIPS | delta-LPIPS |" in page
    for published in ("0.41", "2.436", "26.9", "28.3x", "-0.04", "16.4"):
        assert published in page
    lines = lines_of(folder)
    medium = next(x for x in lines if x["kind"] == "profile" and x["profile"] == "paper-m")
    assert f"| still | `paper-m` | {medium['output_bytes'] / 1e6:.2f} | " in page
    assert f"{medium['input_bytes'] / medium['output_bytes']:.1f}x" in page
    assert f"| {medium['quality']['ssim']:.4f} | {medium['delta']['ssim']:+.4f} |" in page
    titles = [row for row in page.splitlines() if row.startswith("## ")]
    assert len(titles) == 5
    tables = [block for block in page.split("\n\n") if block.startswith("|")]
    assert all(len({row.count("|") for row in table.splitlines()}) == 1 for table in tables)
    assert len(tables) == 5


@pytest.mark.thorough
def test_the_preset_resumes_from_its_checkpoint(reproduced):
    folder, _ = reproduced
    before = lines_of(folder)
    kept = (folder / "out" / "still.checkpoint").read_bytes()
    options = ["--out", folder / "out", "--overwrite", *FEW]
    assert run("bench", "paper", folder / "still.ply", *options).exit_code == 0
    assert (folder / "out" / "still.checkpoint").read_bytes() == kept
    for old, new in zip(before, lines_of(folder), strict=True):
        numbers = {"seconds", "command"}
        assert {k: v for k, v in old.items() if k not in numbers} == {
            k: v for k, v in new.items() if k not in numbers
        }


def test_the_coded_scene_is_the_prepared_one(reproduced):
    folder, _ = reproduced
    plan = Plan(replace(PRESET.steps, refine=4), folder / "cameras.json")
    encode_file(folder / "still.ply", folder / "again.egs", PRESET.config, plan)
    lines = lines_of(folder)
    medium = next(x for x in lines if x["kind"] == "profile" and x["profile"] == "paper-m")
    assert (folder / "again.egs").stat().st_size == medium["output_bytes"]
    assert_same_floats(
        decode_scene((folder / "again.egs").read_bytes()),
        decode_scene((folder / "again.egs").read_bytes(), threads=2),
    )
    psnr = [x["psnr"] for x in lines if x["kind"] == "step" and x["profile"] == "paper-m"]
    assert len(set(psnr)) == 1
    assert math.isfinite(psnr[0])

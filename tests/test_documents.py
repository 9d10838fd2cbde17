"""JSON documents of commands: the same keys in all, null for missing values."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import strict_json
from scenes import random_scene

from gs_codec.cli.documents import KEYS
from gs_codec.cli.main import NAMES
from gs_codec.formats.ply.writer import write_ply
from gs_codec.report import SCHEMA, finite

VIEWS = ["--cameras", "cameras.json"]

#: Arguments of each command that prints a document, and its input, output and Gaussians.
COMMANDS = {
    "encode": (["scene.ply", "a.egs"], "scene.ply", "a.egs", 1500),
    "encode spz": (["scene.ply", "a.spz"], "scene.ply", "a.spz", 1500),
    "decode": (["scene.egs", "a.ply"], "scene.egs", "a.ply", 1500),
    "verify": (["scene.egs"], "scene.egs", None, 1500),
    "verify ply": (["scene.ply"], "scene.ply", None, 1500),
    "convert": (["scene.ply", "a.splat"], "scene.ply", "a.splat", 1500),
    "convert two": (["scene.ply", "scene.egs", "a.ply"], ["scene.ply", "scene.egs"], "a.ply", 3000),
    "prepare": (["scene.ply", "a.ply", "--prune", "30", *VIEWS], "scene.ply", "a.ply", 1050),
    "batch": (["in", "out"], "in", "out", 1500),
    "inspect": (["scene.egs"], "scene.egs", None, 1500),
    "inspect ply": (["scene.ply"], "scene.ply", None, 1500),
    "inspect values": (["scene.egs", "--histogram"], "scene.egs", None, 1500),
    "compare": (["scene.ply", "decoded.ply"], ["scene.ply", "decoded.ply"], None, [1500, 1500]),
    "compare views": (
        ["scene.ply", "scene.ply", *VIEWS], ["scene.ply", "scene.ply"], None, [1500, 1500],
    ),
    "render": (["scene.ply", *VIEWS, "--out", "a"], "scene.ply", "a", 1500),
    "analyze": (["scene.ply", "--sample", "300"], "scene.ply", None, 1500),
}  # fmt: skip

#: Keys of Python reports and older documents, which would be second names for the same values.
OTHER_NAMES = {"count", "file", "file_bytes", "a", "b", "systems", "source", "scene"}


def document(folder, *arguments: str) -> dict:
    status, out, _ = folder.run(*arguments, "--json")
    assert status == 0
    return strict_json(out)


def test_every_command_is_tested():
    """Except `share` and `warm`, which take long, and `bench`, which prints lines."""
    assert {case.split()[0] for case in COMMANDS} == set(NAMES) - {"share", "bench", "warm"}


@pytest.mark.parametrize("case", COMMANDS)
def test_documents_have_the_same_keys(folder, case):
    if case == "batch":
        Path("in").mkdir()
        shutil.copy("scene.ply", "in/scene.ply")
    arguments, source, target, gaussians = COMMANDS[case]
    command = case.split()[0]
    told = document(folder, command, *arguments)
    assert list(told)[: len(KEYS)] == list(KEYS)
    assert (told["schema"], told["command"], told["error"]) == (SCHEMA, command, None)
    assert (told["input"], told["output"], told["gaussians"]) == (source, target, gaussians)
    assert told["seconds"] > 0
    assert isinstance(told["warnings"], list)
    assert not OTHER_NAMES & told.keys()
    if told["stages"]:
        assert told["seconds"] == pytest.approx(sum(told["stages"].values()))
    if command in ("encode", "decode", "convert", "prepare"):
        sources = [source] if isinstance(source, str) else source
        assert told["input_bytes"] == sum(Path(each).stat().st_size for each in sources)
    if isinstance(source, str) and Path(source).is_file() and told["input_bytes"] is not None:
        assert told["input_bytes"] == Path(source).stat().st_size
    size = told["input_bytes"]
    if target is not None and Path(target).is_file():
        size = told["output_bytes"]
        assert size == Path(target).stat().st_size
    if told["bits_per_gaussian"] is not None and command != "batch":
        assert told["bits_per_gaussian"] == pytest.approx(8 * size / told["gaussians"])


def test_lines_of_a_batch_have_these_keys(folder):
    Path("in").mkdir()
    shutil.copy("scene.ply", "in/scene.ply")
    Path("in/bad.ply").write_bytes(b"ply\n")
    status, out, _ = folder.run("batch", "in", "out", "--json")
    whole = strict_json(out)
    lines = map(strict_json, Path("out/report.jsonl").read_text().splitlines())
    bad, good = sorted(lines, key=lambda line: line["error"] is None)  # they end in any order
    assert status == 1
    assert (whole["done"], whole["failed"], whole["input"]) == (1, 1, "in")
    of_line = set(KEYS) - {"command", "profile", "format"}
    assert of_line <= bad.keys() & good.keys()
    assert [bad[key] for key in ("output_bytes", "gaussians", "ratio", "seconds")] == [None] * 4
    assert (bad["error"]["kind"], good["error"]) == ("InvalidInput", None)
    for key in ("input_bytes", "output_bytes", "gaussians", "ratio", "bits_per_gaussian"):
        assert good[key] == pytest.approx(whole[key])
    assert good["seconds"] == pytest.approx(sum(good["stages"].values()))


def test_report_of_preparation_has_these_keys(folder):
    arguments = ["scene.ply", "a.ply", "--prune", "30", *VIEWS, "--report", "r"]
    told = document(folder, "prepare", *arguments)
    saved = json.loads(Path("r/report.json").read_text())
    assert (saved["input_gaussians"], saved["gaussians"]) == (1500, 1050)
    assert [step["gaussians"] for step in saved["steps"]] == [1500, 1050, 1050]
    assert saved == {name: told[name] for name in saved}


def test_warnings_are_in_the_document(folder):
    told = document(folder, "convert", "scene.ply", "a.splat")
    assert told["warnings"] == [f"a.splat: {line}" for line in told["lost"]] != []
    assert document(folder, "inspect", "scene.ply")["warnings"] == []


@pytest.mark.parametrize(
    ("typed", "kind", "text"),
    [
        ("encode none.ply a.egs", "InvalidInput", "none.ply: No such file or directory"),
        ("verify cut.egs", "TruncatedStream", "cut.egs: "),
        ("encode scene.ply", "Usage", "Missing argument"),
        ("encode scene.ply a.egs --threads x", "InvalidInput", "--threads x: expected an integer"),
        ("inspect none.ply", "InvalidInput", "none.ply: No such file or directory"),
        ("compare scene.ply a.egs --none", "Usage", "No such option: --none"),
        ("batch none out", "InvalidInput", "none: no such file or folder"),
    ],
)
def test_errors_are_documents_too(folder, typed, kind, text):
    Path("cut.egs").write_bytes(Path("scene.egs").read_bytes()[:-5])
    status, out, err = folder.run(*typed.split(), "--json")
    told = strict_json(out)
    assert (status, told["schema"], told["command"]) == (2, SCHEMA, typed.split()[0])
    assert told["error"]["kind"] == kind
    assert text in told["error"]["text"]
    assert err.splitlines()[0] == f"gs-codec: error: {told['error']['text']}"
    assert folder.run(*typed.split()).out == ""


@pytest.mark.parametrize(
    "typed",
    [
        "encode none.ply -",
        "encode scene.ply - --fps 5",
        "encode scene.ply - --effort high --profile lossless",
        "decode scene.egs - --view none.json",
        "convert scene.ply - --format splat --quiet --verbose",
    ],
)
def test_errors_do_not_corrupt_a_piped_scene(folder, typed):
    status, out, err = folder.run(*typed.split(), "--json")
    assert (status, out) == (2, "")
    assert strict_json(err.splitlines()[-1])["error"]["kind"] == "InvalidInput"


def test_nonfinite_values_are_null(folder):
    assert finite({"a": [math.nan, -math.inf, 1.5], "b": ({"c": math.inf},)}) == {
        "a": [None, None, 1.5], "b": [{"c": None}],
    }  # fmt: skip
    scene = random_scene(40, 1, seed=3)
    scene.positions[0, :2] = np.nan, np.inf
    write_ply("bad.ply", scene)
    for typed in (["inspect"], ["inspect", "--histogram"], ["verify"]):
        assert document(folder, typed[0], "bad.ply", *typed[1:])["gaussians"] == 40


def test_reason_is_stated_if_views_are_not_measured(folder):
    faint = random_scene(300, 0, seed=1)
    write_ply("faint.ply", replace(faint, opacity=np.full_like(faint.opacity, -9.0)))
    line = folder.run("encode", "faint.ply", "o.egs").out.splitlines()[-1]
    assert line.startswith("rendered views: not measured, because nearly all crops are empty, ")
    assert document(folder, "encode", "faint.ply", "p.egs")["warnings"] == [line]
    assert document(folder, "encode", "faint.ply", "q.egs", "-p", "lossless")["warnings"] == []
    shared = ("faint.ply", "--out", "o.html", "--cameras", "cameras.json")
    assert document(folder, "share", *shared)["warnings"] == [line]
    assert document(folder, "convert", "faint.ply", "o.sog")["warnings"][-1] == line
    assert folder.run("convert", "faint.ply", "p.sog").out.splitlines()[-1] == line
    assert document(folder, "batch", "faint.ply", "coded")["warnings"] == []
    record = json.loads(Path("coded", "report.jsonl").read_text())
    assert record["warnings"] == [f"{Path('faint.ply').absolute()}: {line}"]
    folder.monkeypatch.setattr("gs_codec.encoding.retry.loss_by_plan", lambda *_: None)
    pruned = ("scene.ply", "p.ply", "--prune", "30", *VIEWS)
    assert document(folder, "prepare", *pruned)["warnings"][-1] == line
    assert folder.run("prepare", *pruned, "--overwrite").out.splitlines()[-1] == line


def test_a_bit_exact_file_of_a_pruned_scene_states_its_loss(folder):
    typed = ("encode", "scene.ply", "o.egs", "-p", "lossless", "--prune", "30", *VIEWS)
    loss = document(folder, *typed)["rendered"]["loss"]
    assert loss > 0
    line = folder.run(*typed, "--overwrite").out.splitlines()[-1]
    assert line.startswith("rendered views")
    assert "a loss of" in line

"""Shell input: globs, percentages, help, verbosity, completion."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from command_line import strict_json
from typer.main import get_command

from gs_codec.cli.main import NAMES, app


def commands() -> dict[str, object]:
    """All commands and subcommands, by their typed names."""
    group = get_command(app)
    found = {name: group.get_command(None, name) for name in NAMES}
    found |= {f"bench {name}": each for name, each in found["bench"].commands.items()}
    return found


@pytest.mark.parametrize("name", commands())
def test_help_and_its_other_name_are_the_same(folder, name):
    shown = folder.run(*name.split(), "--help")
    assert shown == folder.run("help", *name.split())
    assert shown.status == 0
    assert f"Usage: gs-codec {name} " in shown.out
    for word in ("<bool>", "<int>", "{", "python -m"):
        assert word not in shown.out.replace("{in}", "").replace("{out}", "")
    if name != "bench":
        assert {"--quiet", "--verbose"} <= {o for p in commands()[name].params for o in p.opts}


def test_help_alone_lists_commands(folder):
    shown = folder.run("help")
    assert shown == folder.run("--help")
    assert all(f" {name} " in shown.out for name in NAMES)
    assert folder.refuse("help", "none") == "gs-codec: error: No such command 'none'.\n"


@pytest.mark.parametrize(
    ("typed", "error", "usage"),
    [
        ("encode", "Missing argument 'IN'.", "encode [OPTIONS] IN OUT"),
        ("encode a.ply", "Missing argument 'OUT'.", "encode [OPTIONS] IN OUT"),
        ("decode", "Missing argument 'IN'.", "decode [OPTIONS] IN [OUT]"),
        ("convert a.ply", "Missing argument: expected IN... OUT", "convert [OPTIONS] IN... OUT"),
        ("render a.ply", "Missing option '--cameras'.", "render [OPTIONS] SCENE"),
        ("bench run", "Missing argument: expected SCENE...", "bench run [OPTIONS] SCENE..."),
    ],
)
def test_usage_follows_the_missing_argument(folder, typed, error, usage):
    name = " ".join(word for word in typed.split() if word != "a.ply")
    expected = f"gs-codec: error: {error}\nusage: gs-codec {usage} (more: gs-codec help {name})\n"
    assert folder.run(*typed.split()) == (2, "", expected)


@pytest.mark.parametrize(
    ("typed", "wanted"),
    [
        ("encode in/a.ply in/b.ply all.egs", ["batch 'in/*.ply' DST", "convert in/*.ply OUT"]),
        (
            "encode a.spz b.spz c.spz all.egs",
            ["batch '*.spz' DST", "sequence: gs-codec encode '*.spz' OUT"],
        ),
        ("batch in/a.ply in/b.ply out", ["in quotes: gs-codec batch 'in/*.ply' DST"]),
        ("decode a.egs b.egs out", ["batch '*.egs' DST --format ply"]),
        ("verify a.egs b.egs", ["usage: gs-codec verify [OPTIONS] FILE"]),
    ],
)
def test_globs_that_the_shell_expanded(folder, typed, wanted):
    error = folder.refuse(*typed.split())
    assert all(text in error for text in wanted)


@pytest.mark.parametrize(("typed", "kept"), [("40", 600), ("40%", 600), ("0.4%", 6)])
def test_shares_accept_a_percent_sign(folder, typed, kept):
    told = strict_json(folder.run("convert", "scene.ply", "a.ply", "--keep", typed, "--json").out)
    assert told["gaussians"] == kept


@pytest.mark.parametrize("typed", ["30", "30%"])
def test_percentages_of_pruning(folder, typed):
    views = ["--cameras", "cameras.json"]
    out = folder.run("prepare", "scene.ply", "a.ply", "--prune", typed, *views, "--json").out
    assert strict_json(out)["gaussians"] == 1050


def test_ambiguous_fractions_are_refused(folder):
    error = folder.refuse("convert", "scene.ply", "a.ply", "--keep", "0.4")
    assert "--keep 0.4: expected percent, for example 40% or 0.4%" in error
    assert "--threads 2%: expected an integer" in folder.refuse(
        "encode", "scene.ply", "a.egs", "--threads", "2%"
    )


def test_decode_names_its_output(folder):
    assert "scene.ply: already exists" in folder.refuse("decode", "scene.egs")
    Path("scene.ply").unlink()
    status, out, _ = folder.run("decode", "scene.egs")
    assert (status, out.split(":")[0]) == (0, "scene.ply")
    assert Path("scene.ply").read_bytes() == Path("decoded.ply").read_bytes()
    assert "missing OUT" in folder.refuse("decode", "-")


@pytest.mark.parametrize(
    "typed",
    ["encode scene.ply a.egs", "decode scene.egs a.ply", "convert scene.ply a.ply", "verify "
     "scene.egs", "batch scene.ply out", "render scene.ply --cameras cameras.json --out a",
     "prepare scene.ply a.ply --rectify 7.5 --cameras cameras.json"],
)  # fmt: skip
def test_quiet_commands_print_nothing(folder, typed):
    assert folder.run(*typed.split(), "--quiet") == (0, "", "")
    again = ["--overwrite"] * (not typed.startswith("verify"))
    status, out, _ = folder.run(*typed.split(), *again)
    assert (status, bool(out)) == (0, True)


def test_quiet_leaves_results_warnings_and_errors(folder, caplog):
    assert folder.run("inspect", "scene.egs", "-q").out == folder.run("inspect", "scene.egs").out
    assert folder.run("convert", "scene.ply", "a.splat", "-q") == (0, "", "")
    assert caplog.messages[0].startswith("a.splat: opacity, colour and rotation rounded")
    assert strict_json(folder.run("verify", "scene.egs", "-q", "--json").out)["gaussians"] == 1500
    assert "No such file" in folder.run("inspect", "none.ply", "-q").err
    Path("bad.ply").write_bytes(b"ply\n")
    status, out, err = folder.run("batch", "bad.ply", "out", "-q")
    assert (status, out) == (1, "")
    assert re.fullmatch(r"\[1/1\] error: .*bad\.ply: .*\n", err)
    assert "--quiet and --verbose cannot be combined" in folder.refuse(
        "verify", "scene.egs", "-q", "-v"
    )


def test_verbose_prints_stages_and_memory(folder, caplog):
    status, out, err = folder.run("encode", "scene.ply", "a.egs", "-p", "paper-m", "-v")
    assert (status, bool(out)) == (0, True)
    assert re.fullmatch(r"read: \d+\.\d{3} s", caplog.messages[0])
    assert re.search(r"^\d+\.\d\d s, [\d.]+ [MG]B of memory$", err, re.MULTILINE)
    assert "of memory" not in folder.run("verify", "a.egs").err


def test_a_batch_keeps_suffixes_that_distinguish_scenes(folder):
    Path("in").mkdir()
    shutil.copy("scene.ply", "in/a.ply")
    shutil.copy("scene.ply", "in/b.ply")
    folder.run("encode", "scene.ply", "in/a.spz", "-q")
    status, out, _ = folder.run("batch", "in", "out", "-p", "lossless", "--json")
    told = strict_json(out)
    assert status == 0
    assert sorted(path.name for path in Path("out").glob("*.egs")) == [
        "a.ply.egs", "a.spz.egs", "b.egs",
    ]  # fmt: skip
    floats = 3 * 1500 * 59 * 4
    assert told["ratio"] == pytest.approx(floats / told["output_bytes"])
    shutil.rmtree("out")
    Path("in/a.spz").unlink()
    told = strict_json(folder.run("batch", "in", "out", "-p", "lossless", "--json").out)
    assert told["ratio"] == pytest.approx(told["input_bytes"] / told["output_bytes"])
    assert sorted(path.name for path in Path("out").glob("*.egs")) == ["a.egs", "b.egs"]


@pytest.mark.parametrize(
    ("command", "typed", "completed"),
    [
        ("encode", "-p", ["paper-l", "paper-m", "paper-s"]),
        ("encode", "--geometry", ["octree", "gpcc", "auto"]),
        ("batch", "--on-error", ["continue", "stop"]),
    ],
)
def test_values_are_completed(command, typed, completed):
    each = commands()[command]
    (param,) = [p for p in each.params if typed in p.opts]
    begun = "paper" if typed == "-p" else ""
    found = param.shell_complete(None, begun)
    assert [item if isinstance(item, str) else item.value for item in found] == completed


def test_expert_options_are_completed():
    each = commands()["encode"]
    context = each.make_context("encode", [], resilient_parsing=True)
    found = [item.value for item in each.shell_complete(context, "--co")]
    assert found == ["--coarseness", "--coder"]
    assert [p.hidden for p in each.params if p.name == "coder"] == [True]

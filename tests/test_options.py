"""Options without effect in a combination are rejected, in every command."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from typer.main import get_command

from gs_codec.cli.main import app
from gs_codec.cli.options import parse_value
from gs_codec.config import Config
from gs_codec.files.encode_file import encode_file
from gs_codec.plan import Plan, Steps

#: Typed form of each option that a command may ignore.
VALUES = {
    "cameras": "--cameras cameras.json", "views": "--views 64", "width": "--width 40",
    "background": "--background black", "gt-images": "--gt-images images",
    "checkpoint": "--checkpoint kept", "allow-prune": "--allow-prune",
    "models": "--models parametric", "coder": "--coder rans",
    "laplace-scales": "--laplace-scales 9", "geometry-rule": "--geometry-rule median",
    "preset": "--preset entropygs",
    "geometry": "--geometry octree", "tmc3": "--tmc3 tmc3", "verify": "--no-verify",
    "keep-order": "--keep-order", "depth": "--depth opacity=8",
    "coarseness": "--coarseness 2", "block-size": "--block-size 2048",
    "profile": "--profile m", "images": "--images views", "split": "--split all",
    "device": "--device cpu", "overwrite": "--overwrite", "channels": "--channels",
    "max-memory": "--max-memory 1GB", "error-scale": "--error-scale mean",
    "lpips": "--lpips weights.pth", "effort": "--effort fast",
    "gltf-compression": "--gltf-compression spz", "at": "--at 8,47,400", "level": "--level 1",
    "lod-levels": "--lod-levels 2", "lod": "--lod", "strict": "--strict",
}  # fmt: skip

_ENCODE = ("cameras", "views", "width", "background", "gt-images")
_PAPER = ("geometry", "tmc3", "verify", "models", "coder", "laplace-scales")

#: Commands, and the options without effect in them.
IGNORED = {
    "encode scene.ply o.egs -p paper-m": (
        *_ENCODE, "keep-order", "allow-prune", "verify", "coarseness",
    ),
    "encode scene.ply o.egs -p lossless": (*_ENCODE, *_PAPER, "depth", "allow-prune"),
    "encode scene.ply o.egs": (*_ENCODE[1:], *_PAPER, "keep-order", "allow-prune"),
    "encode scene.ply o.egs -p medium": (*_ENCODE[1:], *_PAPER, "keep-order", "allow-prune"),
    "encode scene.ply o.egs --cameras cameras.json": ("gt-images",),
    "encode scene.ply o.egs --target-ratio 9": (
        *_ENCODE[1:], "keep-order", *_PAPER, "coarseness", "strict",
    ),
    "encode scene.ply o.egs --max-psnr-drop 1": ("max-memory",),
    "encode scene.ply o.egs --prune 10": ("allow-prune", "checkpoint", "max-memory", *_PAPER),
    "encode scene.ply o.egs -p s": ("preset",),
    "batch scene.ply out -p lossless": ("preset",),
    "prepare scene.ply o.ply --rectify 7": (
        "checkpoint", "geometry-rule", *_PAPER, "keep-order", "lod",
    ),
    "batch scene.ply out": ("views", "width", "background", "gt-images", *_PAPER, "allow-prune"),
    "batch scene.ply out -p paper-m": ("cameras", "views", "width", "background", "keep-order"),
    "batch scene.ply out --resume": ("overwrite",),
    "batch scene.ply out --format ply": ("device",),
    "batch scene.ply out --target-ratio 9": ("max-memory",),
    "convert scene.ply o.splat": (
        *("profile", "depth", "coarseness", "block-size", "effort"), *_PAPER, "gltf-compression",
        *("at", "level", "lod-levels", "strict"),
    ),
    "convert scene.ply o.sog": ("block-size", "lod-levels"),
    "convert scene.ply o.ssog": ("strict",),
    "convert scene.ply tileset.json": ("block-size", "lod-levels", "strict"),
    "convert scene.ply o.egs": ("lod-levels",),
    "encode scene.ply o.glb": ("profile", "effort", "cameras"),
    "convert scene.egs o.ply": ("keep-order",),
    "compare scene.ply scene.egs": (
        "images", "gt-images", "lpips", "width", "split", "background", "device", "overwrite",
    ),
    "compare scene.ply scene.egs --cameras auto": ("overwrite",),
    "render scene.ply --cameras cameras.json --out o.json": ("background", "device"),
    "inspect scene.egs --json": ("channels",),
    "analyze scene.ply --out out": ("width", "error-scale"),
    "bench run scene.ply": ("gt-images", "width"),
    "bench peers scene.ply": ("gt-images", "width"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("command", "option"), [(c, option) for c, options in IGNORED.items() for option in options]
)
def test_option_without_effect_is_refused(folder, command, option):
    line = folder.refuse(*command.split(), *VALUES[option].split())
    assert re.search(option.replace("-", "[-_]"), line)


@pytest.mark.parametrize(
    ("command", "typed"),
    [
        ("encode scene.ply o.egs", "--no-verify"),
        ("encode scene.ply o.egs", "--allow-prune"),
        ("encode scene.ply o.egs", "--views 3"),
        ("convert scene.ply o.splat", "--depth opacity=8"),
        ("convert scene.ply o.splat", "--block-size 2048"),
    ],
)
def test_refusal_names_the_option_as_typed(folder, command, typed):
    line = folder.refuse(*command.split(), *typed.split())
    assert line.startswith(f"gs-codec: error: {typed.split()[0]} ")


def test_a_file_that_looks_like_an_option_is_told_how_to_be_named(folder, run_viewer):
    folder.path.joinpath("-x.egs").touch()
    hint = "No such option: -x; write the name of the file as ./-x.egs\n"
    assert folder.refuse("inspect", "-x.egs") == f"gs-codec: error: {hint}"
    assert run_viewer("-x.egs")[2] == f"gs-viewer: error: {hint}"


@pytest.mark.parametrize("typed", ["-o o.egs", "-oo.egs"])
def test_who_types_an_option_for_the_output_is_told_the_usage(folder, typed):
    line = folder.refuse("encode", "scene.ply", *typed.split())
    usage = "usage: gs-codec encode [OPTIONS] IN OUT (more: gs-codec help encode)"
    assert line == f"gs-codec: error: No such option: -o; {usage}\n"
    line = folder.refuse("share", "scene.ply", *typed.split())
    assert line == "gs-codec: error: No such option: -o; write --out\n"


@pytest.mark.parametrize("command", ["encode scene.ply o.spz -p s", "convert scene.ply o.glb -p s"])
def test_a_loss_can_be_limited_in_formats_with_step_sizes(folder, command):
    compressed = ["--gltf-compression", "spz"] if "glb" in command else []
    assert folder.run(*command.split(), *compressed, "--strict").status == 0


# Expert options


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ("--coarsness 1.2", "No such option: --coarsness"),
        ("--nosuch", "No such option: --nosuch"),
        ("--nosuch=3", "No such option: --nosuch"),
        ("--verify", "No such option: --verify"),
        ("--no-keep-order", "No such option: --no-keep-order"),
        ("--depth 3", "--depth 3: expected GROUP=BITS"),
        ("--depth=", "--depth : expected GROUP=BITS"),
        ("--depth sh-ac", "--depth sh-ac: expected GROUP=BITS"),
        ("--depth sh-ac=x", "--depth sh-ac=x: expected an integer"),
        ("--depth =3", "depth group '': expected one of geometry, sh-dc, "),
        ("--depth colour=3", "depth group 'colour': expected one of geometry, sh-dc, "),
        ("--depth opacity=3 --depth colour=3", "depth group 'colour': expected one of geometry, "),
        ("--views", "Option '--views' requires an argument."),
        ("--no-verify=yes", "Option '--no-verify' does not take a value."),
        ("--keep-order=1", "Option '--keep-order' does not take a value."),
        ("--views many", "--views many: expected an integer"),
        ("--views=", "--views : expected an integer"),
        ("--views 1_0", "--views 1_0: expected an integer"),
        ("--views 0", "--views 0: expected at least 1"),
        ("--coarseness fine", "--coarseness fine: expected a number"),
        ("--coarseness nan", "--coarseness nan: expected a number"),
        ("--coarseness inf", "--coarseness inf: expected a number"),
        ("--coarseness 65", "--coarseness 65.0: expected 1/64 to 64"),
        ("--coarseness .01", "--coarseness 0.01: expected 1/64 to 64"),
        ("--geometry best", "--geometry 'best': expected one of octree, gpcc, auto"),
        ("--background red", "--background red: expected black or white"),
        ("--block-size 5", "--block-size 5: expected an integer from 1024 to 65536"),
        ("--tmc3=", "--tmc3 : expected a value"),
        ("--target-bpg 0", "target bits 0.0: expected a number above 0"),
        ("--threads many", "--threads many: expected an integer"),
        ("--prune half", "--prune half: expected a number"),
        ("--cameras=", "--cameras : expected a value"),
        ("-p best", "--profile 'best': expected one of l, m, s, "),
    ],
)
def test_invalid_values_of_options_are_refused_in_one_line(folder, typed, message):
    cameras = [] if "target" in typed else ["--cameras", "cameras.json"]
    assert message in folder.refuse("encode", "scene.ply", "o.egs", *cameras, *typed.split())


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("max_bytes", "9000000000000000", 9 * 10**15),
        ("views", "+8", 8),
        ("prune", ".5", 0.5),
        ("prune", "5.", 5.0),
        ("compact_sh", "3e-5", 3e-5),
        ("compact_sh", "1E+2", 100.0),
        ("depth", "sh-ac=3", ("sh-ac", 3)),
        ("background", "white", (1.0, 1.0, 1.0)),
        ("report", "a b", Path("a b")),
    ],
)
def test_syntax_of_values(name, text, value):
    found = parse_value(name, text)
    assert (found, type(found)) == (value, type(value))


@pytest.mark.parametrize("command", ["encode", "batch", "convert"])
def test_misspelt_expert_option_is_recognised(folder, command):
    line = folder.refuse(command, "scene.ply", "o.egs", "--coarsness", "2")
    assert line.count("--coarseness") == 1


def test_expert_options_equal_the_librarys(folder):
    typed = (
        "--depth opacity=5 --depth sh-ac=4 --depth opacity=6 --coarseness 1.25 --block-size 1024"
    )
    assert folder.run("encode", "scene.ply", "a.egs", *typed.split()).status == 0
    depths = {"opacity": 6, "sh-ac": 4}
    encode_file("scene.ply", "b.egs", Config(depths=depths, coarseness=1.25, block_size=1024))
    assert Path("a.egs").read_bytes() == Path("b.egs").read_bytes()
    views = "--cameras cameras.json --views 1 --background white"
    assert folder.run("encode", "scene.ply", "c.egs", *views.split()).status == 0
    encode_file("scene.ply", "d.egs", plan=Plan(Steps(), "cameras.json", None, None, 1, (1, 1, 1)))
    assert Path("c.egs").read_bytes() == Path("d.egs").read_bytes()
    kept = "-p lossless --keep-order"
    assert folder.run("encode", "scene.ply", "e.egs", *kept.split()).status == 0
    encode_file("scene.ply", "f.egs", Config("lossless", keep_order=True))
    assert Path("e.egs").read_bytes() == Path("f.egs").read_bytes()


def _options(name: str, *, hidden: bool) -> set[str]:
    """Typed names of a command's options."""
    params = get_command(app).get_command(None, name).params
    options = [p for p in params if p.param_type_name == "option" and p.hidden == hidden]
    return {(*p.opts, *p.secondary_opts)[0] for p in options} - {"--help"}


def test_encode_shows_at_most_18_options_and_batch_the_same():
    assert len(_options("encode", hidden=False)) <= 18
    assert _options("encode", hidden=False) <= _options("batch", hidden=False)
    # These are for a single scene or sequence, for stdin, or are shared by workers.
    alone = {"--checkpoint", "--dask", "--input-format", "--fps", "--group", "--target-bitrate"}
    assert _options("encode", hidden=True) - alone == _options("batch", hidden=True)


#: Expert options of encode.
EXPERT = (
    "--depth", "--block-size", "--keep-order", "--coarseness", "--geometry", "--tmc3",
    "--no-verify", "--dask", "--target-bpg", "--allow-prune", "--width", "--views", "--background",
    "--checkpoint",
)  # fmt: skip


def test_expert_options_of_encode():
    assert _options("encode", hidden=True) >= set(EXPERT)


@pytest.mark.parametrize("columns", ["80", "160"])
@pytest.mark.parametrize("command", ["encode", "batch", "convert", "prepare"])
def test_help_lists_expert_options_once_at_its_end(folder, command, columns):
    folder.monkeypatch.setenv("COLUMNS", columns)
    shown, heading, listed = folder.run(command, "--help").out.partition("Expert options:")
    assert heading
    for name in _options(command, hidden=True):
        assert len(re.findall(rf"^ {re.escape(name)} ", listed, re.MULTILINE)) == 1, name
        assert not re.search(rf"^. {re.escape(name)} ", shown, re.MULTILINE), name
    assert all(len(line.rstrip()) < 80 for line in listed.splitlines())


@pytest.mark.parametrize(("word", "short"), [("high", "l"), ("medium", "m"), ("low", "s")])
def test_words_for_profiles(folder, word, short):
    assert Config(word) == Config(short)
    report = json.loads(folder.run("encode", "scene.ply", "a.egs", "-p", word, "--json").out)
    assert report["profile"] == short
    assert json.loads(folder.run("inspect", "a.egs", "--json").out)["profile"] == short
    folder.monkeypatch.setenv("COLUMNS", "160")
    assert f"{short} ({word})" in folder.run("encode", "--help").out

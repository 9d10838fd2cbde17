"""Options that would have no effect beside the others are refused, in every command."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from typer.main import get_command

from gs_codec.cli.main import app
from gs_codec.config import Config
from gs_codec.files.coding import encode_file
from gs_codec.preparation.steps import Plan, Steps

#: How each option that a command may ignore is typed.
VALUES = {
    "cameras": "--cameras cameras.json", "views": "--set views=64", "width": "--set width=40",
    "background": "--set background=black", "gt-images": "--gt-images images",
    "checkpoint": "--checkpoint kept", "allow-prune": "--set allow-prune=yes",
    "geometry": "--set geometry=octree", "tmc3": "--set tmc3=tmc3", "verify": "--set verify=no",
    "keep-order": "--set keep-order=yes", "depth": "--set depth.opacity=8",
    "coarseness": "--set coarseness=2", "block-size": "--set block-size=2048",
    "profile": "--profile m", "images": "--images views", "split": "--split all",
    "device": "--device cpu", "overwrite": "--overwrite", "channels": "--channels",
    "max-memory": "--max-memory 1GB", "plain width": "--width 40",
    "plain background": "--background black",
}  # fmt: skip

_ENCODE = ("cameras", "views", "width", "background", "gt-images")
_GPCC = ("geometry", "tmc3", "verify")

#: Commands, and options that have no effect there.
IGNORED = {
    "encode scene.ply o.egs -p paper-m": (
        *_ENCODE, "keep-order", "allow-prune", "verify", "coarseness",
    ),
    "encode scene.ply o.egs -p lossless": (*_ENCODE, *_GPCC, "depth", "allow-prune"),
    "encode scene.ply o.egs": (*_ENCODE[1:], *_GPCC, "keep-order", "allow-prune"),
    "encode scene.ply o.egs -p medium": (*_ENCODE[1:], *_GPCC, "keep-order", "allow-prune"),
    "encode scene.ply o.egs --cameras cameras.json": ("gt-images",),
    "encode scene.ply o.egs --target-ratio 9": (*_ENCODE[1:], "keep-order", *_GPCC),
    "encode scene.ply o.egs --max-psnr-drop 1": ("max-memory",),
    "encode scene.ply o.egs --prune 10": ("allow-prune", "max-memory", *_GPCC),
    "prepare scene.ply o.ply --rectify": ("checkpoint", *_GPCC, "keep-order"),
    "batch scene.ply out": ("views", "width", "background", "gt-images", *_GPCC, "allow-prune"),
    "batch scene.ply out -p paper-m": ("cameras", "views", "width", "background", "keep-order"),
    "batch scene.ply out --resume": ("overwrite",),
    "batch scene.ply out --target-ratio 9": ("max-memory",),
    "convert scene.ply o.splat": ("profile", "depth", "coarseness", "block-size", *_GPCC),
    "convert scene.egs o.ply": ("keep-order",),
    "compare scene.ply scene.egs": (
        "images", "gt-images", "plain width", "split", "plain background", "device", "overwrite",
    ),
    "compare scene.ply scene.egs --cameras auto": ("overwrite",),
    "inspect scene.egs --json": ("channels",),
    "analyze scene.ply --out out": ("plain width",),
    "bench run scene.ply": ("gt-images", "plain width"),
    "bench peers scene.ply": ("gt-images", "plain width"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("command", "option"), [(c, option) for c, options in IGNORED.items() for option in options]
)
def test_option_without_effect_is_refused(folder, command, option):
    line = folder.refuse(*command.split(), *VALUES[option].split())
    assert re.search(option.removeprefix("plain ").replace("-", "[-_]"), line)


# --set


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ("coarsness=1.2", "no such name, expected one of depth.GROUP, block-size, keep-order, "),
        ("profile=l", "no such name, expected one of depth.GROUP, "),
        ("refine=5", "no such name, "),
        ("=3", "no such name, "),
        ("", "no such name, "),
        ("depth=3", "no such name, "),
        ("views.x=3", "no such name, "),
        ("depth.colour=3", "depth group 'colour': expected one of geometry, sh-dc, "),
        ("views", "--set views: expected views=N"),
        ("verify", "--set verify: expected verify=yes|no"),
        ("views=many", "--set views=many: expected an integer"),
        ("views=0", "views 0: expected at least 1"),
        ("coarseness=fine", "--set coarseness=fine: expected a number"),
        ("coarseness=nan", "--set coarseness=nan: expected a number"),
        ("coarseness=65", "coarseness 65.0: expected 1/64 to 64"),
        ("keep-order=1", "--set keep-order=1: expected yes or no"),
        ("geometry=best", "geometry 'best': expected one of octree, gpcc, auto"),
        ("background=red", "--set background=red: expected black or white"),
        ("block-size=5", "block_size 5: expected an integer from 1024 to 65536"),
        ("tmc3=", "--set tmc3=: expected a value"),
        ("target-bpg=0", "target bits 0.0: expected a number above 0"),
    ],
)
def test_what_set_does_not_know_is_refused_in_one_line(folder, typed, message):
    cameras = [] if "target" in typed else ["--cameras", "cameras.json"]
    assert message in folder.refuse("encode", "scene.ply", "o.egs", *cameras, "--set", typed)


def test_set_does_what_the_library_does(folder):
    typed = ["depth.opacity=6", "depth.sh-ac=4", "coarseness=1.25", "block-size=1024"]
    options = [word for each in typed for word in ("--set", each)]
    assert folder.run("encode", "scene.ply", "a.egs", *options).status == 0
    depths = {"opacity": 6, "sh-ac": 4}
    encode_file("scene.ply", "b.egs", Config(depths=depths, coarseness=1.25, block_size=1024))
    assert Path("a.egs").read_bytes() == Path("b.egs").read_bytes()
    views = ["--cameras", "cameras.json", "--set", "views=1", "--set", "background=white"]
    assert folder.run("encode", "scene.ply", "c.egs", *views).status == 0
    encode_file("scene.ply", "d.egs", plan=Plan(Steps(), "cameras.json", None, None, 1, (1, 1, 1)))
    assert Path("c.egs").read_bytes() == Path("d.egs").read_bytes()


def test_encode_has_at_most_16_options_and_batch_the_same():
    def options(name: str) -> set[str]:
        params = get_command(app).get_command(None, name).params
        return {p.name for p in params if p.param_type_name == "option"} - {"help"}

    assert len(options("encode")) == 16
    assert options("encode") <= options("batch")


@pytest.mark.parametrize("command", ["encode", "batch", "convert", "prepare"])
def test_help_lists_what_set_takes(folder, command):
    names = re.findall(r"one of (.*)", folder.refuse(command, "scene.ply", "o.egs", "--set", "x=1"))
    listed = folder.run(command, "--help").out
    for name in names[0].split(", "):
        assert re.search(rf"^ *{re.escape(name)}=", listed, re.MULTILINE), name


@pytest.mark.parametrize(("word", "short"), [("high", "l"), ("medium", "m"), ("low", "s")])
def test_words_for_profiles(folder, word, short):
    assert Config(word) == Config(short)
    report = json.loads(folder.run("encode", "scene.ply", "a.egs", "-p", word, "--json").out)
    assert report["profile"] == short
    assert json.loads(folder.run("inspect", "a.egs", "--json").out)["profile"] == short
    folder.monkeypatch.setenv("COLUMNS", "160")
    assert f"{short} ({word})" in folder.run("encode", "--help").out

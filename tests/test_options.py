"""Options that would have no effect beside the others are refused, in every command."""

from __future__ import annotations

import re

import pytest

#: A value for each option that a command may ignore.
VALUES = {
    "cameras": "cameras.json", "views": "64", "width": "40", "background": "black",
    "against-gt": "images", "report": "report", "checkpoint": "kept", "allow-prune": None,
    "geometry": "octree", "tmc3": "tmc3", "no-verify": None, "keep-order": None,
    "profile": "m", "depth": "opacity=8", "images": "views", "split": "all", "device": "cpu",
    "overwrite": None, "channels": None, "max-memory": "1GB",
}  # fmt: skip

_ENCODE = ("cameras", "views", "width", "background", "report", "checkpoint", "against-gt")
_GPCC = ("geometry", "tmc3", "no-verify")

#: Commands, and options that have no effect there.
IGNORED = {
    "encode scene.ply o.egs -p paper-m": (*_ENCODE, "keep-order", "allow-prune", "no-verify"),
    "encode scene.ply o.egs -p lossless": (*_ENCODE, *_GPCC, "depth", "allow-prune"),
    "encode scene.ply o.egs": (*_ENCODE[1:], *_GPCC, "keep-order", "allow-prune"),
    "encode scene.ply o.egs --cameras cameras.json": ("report", "checkpoint", "against-gt"),
    "encode scene.ply o.egs --target-ratio 9": (*_ENCODE[1:], "keep-order", *_GPCC),
    "encode scene.ply o.egs --max-psnr-drop 1": ("report", "checkpoint", "max-memory"),
    "encode scene.ply o.egs --rectify": ("checkpoint", "allow-prune", "max-memory", *_GPCC),
    "prepare scene.ply o.ply --rectify": ("checkpoint",),
    "batch scene.ply out": ("views", "width", "background", "against-gt", *_GPCC, "allow-prune"),
    "batch scene.ply out -p paper-m": ("cameras", "views", "width", "background", "keep-order"),
    "batch scene.ply out --resume": ("overwrite",),
    "convert scene.ply o.splat": ("profile", "depth"),
    "convert scene.egs o.ply": ("keep-order",),
    "compare scene.ply scene.egs": (
        "images", "against-gt", "width", "split", "background", "device", "overwrite",
    ),
    "compare scene.ply scene.egs --cameras auto": ("overwrite",),
    "inspect scene.egs --json": ("channels",),
    "analyze scene.ply --out out": ("width",),
    "bench run scene.ply": ("against-gt", "width"),
    "bench peers scene.ply": ("against-gt", "width"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("command", "option"), [(c, option) for c, options in IGNORED.items() for option in options]
)
def test_option_without_effect_is_refused(folder, command, option):
    value = VALUES[option]
    line = folder.refuse(*command.split(), f"--{option}", *([] if value is None else [value]))
    assert re.search(option.removeprefix("no-").replace("-", "[-_]"), line)

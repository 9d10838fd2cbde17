"""Suffixes of the files that scenes are written to."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from gs_codec.config import EGS, FORMATS, SSOG, STREAMED, UNBUNDLED, Config
from gs_codec.errors import InvalidInput
from gs_codec.runtime.atomic import check_writable

#: Of formats that scenes are encoded to, of those of plain floats, of those with levels made by
#: `convert`, and of all that are written.
ENCODED = (*(f".{name}" for name in FORMATS), UNBUNDLED)
PLAIN = (".ply", ".pt", ".ckpt", ".csv")
LEVELLED = (SSOG, STREAMED)
WRITTEN = (*ENCODED, *LEVELLED, *PLAIN)

#: Names of formats that are read from one file.
READ = ("splat", "ksplat", "gltf", "ply", "egs", "spz", "sog", "usd", "pt")

#: Of formats that are written part by part, below a memory limit.
IN_PARTS = (".egs", ".ply", ".csv")


def suffix_of(path: str | Path, known: tuple[str, ...] = WRITTEN) -> str:
    """The suffix of a scene to be written, which selects its format.

    Raises
    ------
    InvalidInput
        If it is none of `known`, or one that has to be the whole name and is not.
    """
    suffix = known_suffix(path)
    if suffix not in known:
        suffix = suffix or Path(path).suffix.lower()
        expected = " or ".join(filter(None, [", ".join(known[:-1]), known[-1]]))
        other = "; `convert` writes that" if suffix in WRITTEN else ""
        raise InvalidInput(f"{path}: suffix '{suffix}', expected {expected}{other}")
    if suffix == STREAMED and Path(path).name != STREAMED:
        raise InvalidInput(f"{path}: expected the name {STREAMED}, which viewers look for")
    return suffix


def known_suffix(path: str | Path) -> str:
    """The suffix of a format that is written, the longest that fits; "" if it is none."""
    name = Path(path).name.lower()
    return max((s for s in WRITTEN if name.endswith(s)), key=len, default="")


def format_of(suffix: str) -> str:
    """The format of a suffix from `suffix_of`."""
    return "sog" if suffix in (UNBUNDLED, *LEVELLED) else suffix.removeprefix(".")


def config_for(path: str | Path, config: Config, known: tuple[str, ...] = ENCODED) -> Config:
    """The configuration with the format of a file's suffix.

    Raises
    ------
    InvalidInput
        If it is none of `known`, or the configuration asks for another format.
    """
    form = format_of(suffix_of(path, known))
    if config.format not in (EGS, form):
        raise InvalidInput(f"{path}: format '{config.format}', expected .{config.format}")
    return replace(config, format=form)


def check_target(
    sources: Sequence[str | Path],
    target: str | Path,
    known: tuple[str, ...] = WRITTEN,
    overwrite: bool = True,
) -> str:
    """The suffix of a target; refuses one that cannot be written, before the work is done."""
    for source in sources:
        if os.path.exists(source) and os.path.exists(target) and os.path.samefile(source, target):
            raise InvalidInput(f"{target}: input and output are the same file")
    check_writable(target, overwrite)
    suffix = suffix_of(target, known)
    if suffix.startswith(".usd"):
        from gs_codec.formats.usd.scene import require_usd_core

        require_usd_core(suffix)
    return suffix

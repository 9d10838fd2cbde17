"""Suffixes of output files."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from gs_codec.config import EGS, Config
from gs_codec.errors import InvalidInput
from gs_codec.format_table import (
    FORMATS,
    STREAMED,
    TILESET,
    UNBUNDLED,
    format_of,
    read,
    written,
)
from gs_codec.runtime.atomic import check_writable
from gs_codec.runtime.wording import listed

#: Suffixes of formats that scenes are encoded to, of formats with plain floats, of those with
#: levels made by `convert`, and of all output formats.
ENCODED = written("steps", "fixed")
PLAIN = written("floats")
LEVELLED = written("levels")
WRITTEN = (*ENCODED, *LEVELLED, *PLAIN)

#: Patterns of the other files of scenes in several files.
_BESIDE = {TILESET: "tiles/*", STREAMED: "[0-9]*_[0-9]*/*", UNBUNDLED: "means_[lu].webp"}

#: Names of formats that are read from a single file.
READ_NAMES = tuple(known.name for known in FORMATS if f".{known.name}" in read())


def suffix_of(path: str | Path, known: tuple[str, ...] = WRITTEN) -> str:
    """The suffix of an output file, which selects the format.

    Raises InvalidInput if it is not in `known`, or must be the whole name and is not.
    """
    suffix = known_suffix(path)
    if suffix not in known:
        suffix = suffix or Path(path).suffix.lower()
        other = "; `convert` writes that" if suffix in WRITTEN else ""
        raise InvalidInput(f"{path}: suffix '{suffix}', expected {listed(known)}{other}")
    if not suffix.startswith(".") and Path(path).name != suffix:
        raise InvalidInput(f"{path}: expected the name {suffix}, which viewers look for")
    return suffix


def known_suffix(path: str | Path) -> str:
    """The longest matching suffix of an output format; "" if there is none."""
    name = Path(path).name.lower()
    return max((s for s in WRITTEN if name.endswith(s)), key=len, default="")


def format_name(suffix: str) -> str:
    """The format of a suffix from `known_suffix`, as in `Config.format`."""
    return format_of(suffix).code(suffix) if suffix else ""


def config_for(path: str | Path, config: Config, known: tuple[str, ...] = ENCODED) -> Config:
    """The configuration with the format of a file's suffix.

    Raises InvalidInput if it is not in `known`, or the configuration selects another format.
    """
    form = format_name(suffix_of(path, known))
    if config.format not in (EGS, form):
        raise InvalidInput(f"{path}: format '{config.format}', expected .{config.format}")
    return replace(config, format=form)


def check_no_source(sources: Sequence[str | Path], target: str | Path) -> None:
    """Raise InvalidInput if a target is the file of a source."""
    for source in sources:
        if os.path.exists(source) and os.path.exists(target) and os.path.samefile(source, target):
            raise InvalidInput(f"{target}: input and output are the same file")


def check_target(
    sources: Sequence[str | Path],
    target: str | Path,
    known: tuple[str, ...] = WRITTEN,
    overwrite: bool = True,
) -> str:
    """The suffix of a target; rejects targets that cannot be written, before any work."""
    check_no_source(sources, target)
    check_place(target, overwrite)
    suffix = suffix_of(target, known)
    format_of(suffix).check_installed()
    return suffix


def check_place(target: str | Path, overwrite: bool) -> None:
    """Like `check_writable`, for all files of a scene."""
    folder, name = Path(target).parent, Path(target).name
    check_writable(target, overwrite, name == TILESET)
    if not overwrite and name in _BESIDE:
        for found in folder.glob(_BESIDE[name]):
            raise InvalidInput(
                f"{found}: already exists; choose another folder or pass overwrite=True"
            )

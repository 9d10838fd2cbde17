"""Suffixes of the files that scenes are written to."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from gs_codec.config import EGS, FORMATS, Config
from gs_codec.errors import InvalidInput

#: Of formats that scenes are encoded to, and of all that are written.
ENCODED = tuple(f".{name}" for name in FORMATS)
WRITTEN = (*ENCODED, ".ply")


def suffix_of(path: str | Path, known: tuple[str, ...] = WRITTEN) -> str:
    """The suffix of a scene to be written, which selects its format.

    Raises
    ------
    InvalidInput
        If it is none of `known`.
    """
    suffix = known_suffix(path)
    if suffix not in known:
        suffix = suffix or Path(path).suffix.lower()
        expected = " or ".join(filter(None, [", ".join(known[:-1]), known[-1]]))
        other = "; `convert` writes that" if suffix in WRITTEN else ""
        raise InvalidInput(f"{path}: suffix '{suffix}', expected {expected}{other}")
    return suffix


def known_suffix(path: str | Path) -> str:
    """The suffix of a format that is written, the longest that fits; "" if it is none."""
    name = Path(path).name.lower()
    return max((s for s in WRITTEN if name.endswith(s)), key=len, default="")


def config_for(path: str | Path, config: Config) -> Config:
    """The configuration with the format of a file's suffix.

    Raises
    ------
    InvalidInput
        If scenes are not encoded to it, or the configuration asks for another.
    """
    suffix = suffix_of(path, ENCODED)
    if config.format not in (EGS, suffix[1:]):
        raise InvalidInput(f"{path}: format '{config.format}', expected .{config.format}")
    return replace(config, format=suffix[1:])

"""Options of the commands, made from the dataclasses of the library."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import typer

from gs_codec.config import Config, Option, RateTarget
from gs_codec.errors import InvalidInput
from gs_codec.preparation.steps import Plan, Steps

_SIZE = re.compile(r"(\d+(?:\.\d+)?) ?((?:[kmg]i?)?)b?")
_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "ki": 2**10, "mi": 2**20, "gi": 2**30}

#: How numbers are typed.
_NUMBERS: Mapping[type, str] = {
    int: r"-?[0-9]{1,12}",
    float: r"-?[0-9]{1,12}(\.[0-9]{1,20})?(e-?[0-9]{1,2})?",
}

#: Options by their names in Python, and their defaults; first those that are no field.
OPTIONS = {
    "max_memory": Option(
        "Most memory to use: 4GB, 512MiB; the rest goes to temporary files.",
        int, metavar="SIZE", shown="what is needed", unit="bytes",
    ),
    "max_bytes": Option(
        "Largest size of a scene's floats, bytes.", int, shown="1 GiB or 1000 times the file"
    ),
    "overwrite": Option("Replace what exists; without it, that is an error.", bool),
    "json": Option("Print the report as JSON.", bool),
    "report": Option("Write report.json, ablation.md, labels.npy there.", Path, metavar="DIR"),
    "set": Option("Set an expert option, see below; may be repeated.", metavar="NAME=VALUE"),
    "split": Option(
        "Cameras to use: all, test, train, or held-out (test where they are marked, else all)."
    ),
    "device": Option(
        "Draw on cpu, on cuda with gsplat, or auto: cuda where possible.",
        values={name: name for name in ("auto", "cpu", "cuda")},
    ),
}  # fmt: skip
DEFAULTS: dict[str, Any] = {"overwrite": False, "json": False, "device": "auto"}

for _settings in (Config, RateTarget, Plan, Steps):
    for _field in fields(_settings):
        if _described := _field.metadata.get("option"):
            OPTIONS[_described.name or _field.name] = _described
            if _field.default is not MISSING:
                DEFAULTS[_described.name or _field.name] = _field.default


def typer_option(name: str) -> Any:
    """The option `name` for a parameter of a command."""
    described = OPTIONS[name]

    def parse(text: Any) -> Any:
        return parse_value(f"--{dashed(name)} ", described, text)

    return typer.Option(
        f"--{dashed(name)}",
        *(["-p"] if name == "profile" else []),
        help=described.help,
        metavar=described.metavar or "|".join(described.values) or None,
        show_default=described.shown or True,
        parser=parse if described.unit or isinstance(described.values, Mapping) else None,
    )


def parse_value(typed: str, described: Option, text: Any) -> Any:
    """The value that a text means for an option, which is called `typed` in errors.

    Raises
    ------
    InvalidInput
        If it means none.
    """
    if not isinstance(text, str):  # a default
        return text
    if described.unit:
        return parse_size(typed, text)
    words = {"yes": True, "no": False} if described.kind is bool else described.values
    if isinstance(words, Mapping):
        if text in words:
            return words[text]
        expected = " or ".join(words) if len(words) < 3 else f"one of {', '.join(words)}"
    elif re.fullmatch(_NUMBERS.get(described.kind, ".+"), text):
        return described.kind(text)
    else:
        expected = {int: "an integer", float: "a number"}.get(described.kind, "a value")
    raise InvalidInput(f"{typed}{text}: expected {expected}")


def parse_size(typed: str, text: str) -> int:
    """Bytes of a size with or without a unit, the value of an option."""
    found = _SIZE.fullmatch(text.strip().lower())
    if not found:
        raise InvalidInput(f"{typed}{text}: expected a size, for example 5MB or 800kB")
    return int(float(found[1]) * _UNITS[found[2]])


def value_of(described: Option) -> str:
    """What stands for the value of an option where it is described."""
    kinds = {bool: "yes|no", int: "N", float: "X"}
    known = "|".join(described.values) or kinds.get(described.kind, "TEXT")
    return described.metavar or known


def set_name(name: str) -> str:
    """The name of an option for ``--set``."""
    return dashed(name) + (".GROUP" if OPTIONS[name].keys else "")


def dashed(name: str) -> str:
    """The name of an option as it is typed."""
    return name.replace("_", "-")

"""Command-line options, made from the dataclasses of the library."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields, replace
from pathlib import Path
from typing import Any

import typer

from gs_codec.config import CODED_FORMATS, Config, Option, RateTarget
from gs_codec.errors import InvalidInput
from gs_codec.files.suffixes import ENCODED, PLAIN, READ_NAMES
from gs_codec.format_table import unmarked_names
from gs_codec.plan import Plan, Steps
from gs_codec.presets import PRESETS
from gs_codec.runtime.wording import listed

_SIZE = re.compile(r"(\d+(?:\.\d+)?) ?((?:[kmg]i?)?)b?")
_BIT_RATE = re.compile(r"(\d+(?:\.\d+)?) ?([kmg]?)(?:bit/s|bps|b/s)?")
_WITH_UNITS = {
    "bytes": (_SIZE, "a size, for example 5MB or 800kB"),
    "bit/s": (_BIT_RATE, "a bit rate, for example 20Mbit/s or 800kbit/s"),
}
_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "ki": 2**10, "mi": 2**20, "gi": 2**30}

#: Suffixes that scenes are encoded to, and all output suffixes.
ENCODED_SHOWN = listed(ENCODED)
WRITTEN_SHOWN = f"{', '.join(PLAIN)}, {ENCODED_SHOWN}"

#: Parsers of numbers, and their names.
_NUMBERS: Mapping[type, tuple[str, str]] = {
    int: (r"[-+]?[0-9]{1,30}", "an integer"),
    float: (r"[-+]?([0-9]{1,30}\.?[0-9]{0,30}|\.[0-9]{1,30})([eE][-+]?[0-9]{1,2})?", "a number"),
}

#: Options by Python name, and their defaults; first those that are not fields.
OPTIONS = {
    "max_memory": Option(
        "Maximum memory (4GB, 512MiB); further data goes to temporary files.",
        int, metavar="SIZE", shown="no limit", unit="bytes",
    ),
    "max_bytes": Option(
        "Maximum size of a scene's floats, bytes.", int, shown="1 GiB, or 1000x the file if more"
    ),
    "preset": Option(
        "Run the paper's whole pipeline; --refine and -p paper-* change it.",
        values=tuple(PRESETS),
    ),
    "dask": Option(
        "Dask scheduler to use, or local to start workers on this machine.", metavar="ADDRESS",
    ),
    "fps": Option(
        "Frames per second of a sequence.", float, metavar="X", low=0.001, high=1e6,
        expected="0.001 to a million", shown="as stated, or 30",
    ),
    "group": Option(
        "Of a sequence: maximum number of frames in the group of a key frame. Smaller groups give "
        "faster access to any frame, but a larger file.",
        int, low=1, high=1 << 24, shown="30",
    ),
    "input_format": Option(
        f"Format of stdin or a pipe, required for {listed(unmarked_names(), 'and')}.",
        metavar="NAME", values=READ_NAMES,
    ),
    "overwrite": Option("Overwrite existing output.", bool),
    "json": Option("Print the report as JSON.", bool),
    "quiet": Option("Hide progress and reports; print only results, warnings and errors.", bool),
    "verbose": Option("Print the time of each stage, total time and memory.", bool),
    "report": Option("Folder for report.json, ablation.md and labels.npy.", Path, metavar="DIR"),
    "split": Option(
        "Cameras to use: all, test, train, or held-out (test if any are marked, otherwise all)."
    ),
    "error_scale": Option(
        "Scale of errors: standard deviations of the channel, or mean square over the "
        "attribute's mean, as in the paper.",
        values={name: name for name in ("deviation", "mean")},
    ),
}  # fmt: skip
DEFAULTS: dict[str, Any] = {
    "overwrite": False,
    "json": False,
    "quiet": False,
    "verbose": False,
    "error_scale": "deviation",
}

for _settings in (Config, RateTarget, Plan, Steps):
    for _field in fields(_settings):
        if _described := _field.metadata.get("option"):
            OPTIONS[_described.name or _field.name] = _described
            if _field.default is not MISSING:
                DEFAULTS[_described.name or _field.name] = _field.default

OPTIONS["format"] = replace(
    OPTIONS["format"], values=(*CODED_FORMATS, *(suffix.removeprefix(".") for suffix in PLAIN))
)


#: Options that also have a letter.
_SHORT = {"profile": "-p", "quiet": "-q", "verbose": "-v"}


def completion(words: Sequence[str]) -> Callable[[str], list[str]]:
    """A completer for one of some words."""
    return lambda incomplete: [word for word in words if word.startswith(incomplete)]


def typer_option(name: str, hidden: bool = False, other_default: bool = False) -> Any:
    """The option `name` for a parameter of a command, which may have another default."""
    described, typed = OPTIONS[name], typed_name(name)
    switch = described.kind is bool

    def parse(text: Any) -> Any:
        return parse_value(name, text)

    return typer.Option(
        f" /{typed}" if DEFAULTS.get(name) is True else typed,  # "/" declares the negative form
        *([_SHORT[name]] if name in _SHORT else []),
        help=described.help,
        metavar=metavar_of(described),
        autocompletion=completion(tuple(described.values)) if described.values else None,
        show_default=(not other_default and described.shown) or True,
        parser=None if switch else parse,
        hidden=hidden,
    )


def parse_value(name: str, text: Any) -> Any:
    """Parse the text of an option's value; with its key, if the option has keys.

    Raises InvalidInput if it is invalid or out of range.
    """
    if not isinstance(text, str):  # already a default value
        return text
    described, typed = OPTIONS[name], f"{typed_name(name)} {text}"
    if described.keys:
        key, equals, number = text.partition("=")
        if not equals:
            raise InvalidInput(f"{typed}: expected {described.metavar}")
        return key, _read(described, number, typed)
    value = _read(described, text, typed)
    described.check(typed_name(name), value)
    return value


def _read(described: Option, text: str, typed: str) -> Any:
    words = described.values
    pattern, expected = _NUMBERS.get(described.kind, ("(?s).+", "a value"))
    if described.unit:
        form, expected = _WITH_UNITS[described.unit]
        if found := form.fullmatch(text.strip().lower()):
            return int(float(found[1]) * _UNITS[found[2]])
    elif isinstance(words, Mapping):
        if text in words:
            return words[text]
        expected = " or ".join(words) if len(words) < 3 else f"one of {', '.join(words)}"
    elif re.fullmatch(pattern, text := text.removesuffix("%" * described.percent)):
        return described.kind(text)
    raise InvalidInput(f"{typed}: expected {expected}")


def metavar_of(described: Option) -> str:
    """Placeholder of an option's value in the help; a switch has none."""
    kinds = {bool: "", int: "N", float: "X"}
    return described.metavar or "|".join(described.values) or kinds.get(described.kind, "TEXT")


def completed(typed: Sequence[str]) -> list[str]:
    """The typed arguments, with values added to options that may stand alone."""
    alone = {typed_name(n): str(o.alone) for n, o in OPTIONS.items() if o.alone is not None}
    full = []
    for text, following in zip(typed, [*typed, ""][1:], strict=True):
        full.append(text)
        if text in alone and not re.match(r"[-+]?\d", following):
            full.append(alone[text])
    return full


def typed_name(name: str) -> str:
    """The typed form of an option's name; an option that is on by default is switched off."""
    return ("--no-" if DEFAULTS.get(name) is True else "--") + name.replace("_", "-")

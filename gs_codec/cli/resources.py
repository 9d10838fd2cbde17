"""Options of what commands may use: threads, memory, programs; and sizes as they are typed."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer

from gs_codec.errors import InvalidInput

_SIZE = re.compile(r"(\d+(?:\.\d+)?) ?((?:[kmg]i?)?)b?")
_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "ki": 2**10, "mi": 2**20, "gi": 2**30}

Threads = Annotated[
    int | None, typer.Option(help="Worker threads, 1-256.", show_default="all processors")
]

Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace what exists; without, that is refused.")
]

MaxMemory = Annotated[
    str | None,
    typer.Option(
        metavar="SIZE", help="Most memory to take: 4GB, 512MiB.", show_default="what is needed"
    ),
]

MaxBytes = Annotated[
    int | None,
    typer.Option(
        help="Largest size of a scene's floats.", show_default="1 GiB or 1000 times the file"
    ),
]

Decoder = Annotated[
    Path | None,
    typer.Option(
        metavar="PATH",
        help="G-PCC program, for files coded with it.",
        show_default="GS_CODEC_TMC3, or tmc3 in PATH",
    ),
]


def parse_memory(text: str | None) -> int | None:
    """Bytes that ``--max-memory`` says."""
    return None if text is None else parse_size("--max-memory", text)


def parse_size(option: str, text: str) -> int:
    """Bytes of a size with or without a unit, the value of an option."""
    found = _SIZE.fullmatch(text.strip().lower())
    if not found:
        raise InvalidInput(f"{option} {text}: expected a size, for example 5MB or 800kB")
    return int(float(found[1]) * _UNITS[found[2]])

"""Words of messages: numbers with nouns and units, options as typed, other packages' warnings."""

from __future__ import annotations

import logging
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import SupportsIndex, TextIO

log = logging.getLogger(__name__)

#: Python arguments that messages of the library name: `overwrite=True`, `extra="drop"`.
_ARGUMENT = re.compile(r'\b(overwrite|nonfinite|extra|cameras)=(?:True|"(\w+)")')
_COMBINED = re.compile(r"^(?=(?:dask|lod|max-memory): cannot be combined)")
_ACTION = re.compile(r'\bAction\("([a-z-]+)"(?:, "([^"]*)")?\)')


def counted(number: SupportsIndex, noun: str) -> str:
    """A number and its noun: "1 Gaussian", "1,234 Gaussians", "2 properties"."""
    return f"{number:,} {noun if number == 1 else _plural(noun)}"


def listed(names: Sequence[str], word: str = "or") -> str:
    """Names in a sentence: ``a, b or c``."""
    *first, last = names
    return f"{', '.join(first)} {word} {last}" if first else last


def _plural(noun: str) -> str:
    if noun.endswith("y"):
        return f"{noun[:-1]}ies"
    return f"{noun}es" if noun.endswith(("ss", "x")) else f"{noun}s"


def size_text(size: float) -> str:
    """A number of bytes with its unit, decimal."""
    if size < 1000:
        return counted(round(size), "byte")
    for unit in ("kB", "MB"):
        size /= 1000
        if size < 999.995:
            return f"{size:.2f} {unit}"
    return f"{size / 1000:.2f} GB"


def as_typed(text: str) -> str:
    """Replace Python arguments in a message of the library by options of the commands."""
    return _ACTION.sub(_option, _ARGUMENT.sub(_option, _COMBINED.sub("--", text)))


def _option(found: re.Match[str]) -> str:
    name, value = found.groups()
    return f"--{name}{'=' if value.startswith('-') else ' '}{value}" if value else f"--{name}"


def log_warnings() -> None:
    """From now on, log the warnings of Python, NumPy and other packages in this process."""
    warnings.showwarning = _log


def _log(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Replacement for `warnings.showwarning`."""
    text = " ".join(str(message).split())
    log.warning("%s (%s, line %d)", text, Path(filename).name, lineno)

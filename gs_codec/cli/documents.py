"""The JSON document that commands print with ``--json``, with the same keys in all."""

from __future__ import annotations

import json
import logging
import sys
import time
from collections.abc import Mapping
from typing import Any, TextIO

from gs_codec.cli.streams import is_stdout
from gs_codec.errors import printable
from gs_codec.report import NOT_MEASURED, SCHEMA, finite, lacks_loss
from gs_codec.runtime.wording import as_typed

#: Keys of every document, in this order; null for missing values.
KEYS = (
    "schema", "command", "input", "output", "gaussians", "sh_degree", "profile", "format",
    "input_bytes", "output_bytes", "ratio", "bits_per_gaussian", "seconds", "stages", "warnings",
    "error",
)  # fmt: skip

#: Fields of Python reports with a different key in documents.
_NAMES = {"count": "gaussians", "file_bytes": "output_bytes"}


class _Run(logging.Handler):
    """The running command: start time, warnings, and where its document goes."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.begin([], None)

    def begin(self, typed: list[str], command: str | None) -> None:
        self.command, self.as_json = command, "--json" in typed
        self.start = time.perf_counter()
        self.warnings: list[str] = []
        self.file: TextIO | None = None

    def emit(self, record: logging.LogRecord) -> None:
        self.warnings.append(printable(as_typed(record.getMessage())))


_run = _Run()

#: Commands that write scenes to stdout.
_TO_STDOUT = ("convert", "decode", "encode", "prepare")


def begin_run(typed: list[str], command: str | None) -> None:
    """Begin the document of a command; `typed` are all its arguments."""
    _run.begin(typed, command)
    # Until the arguments are parsed, any `-` after the first one counts as the output.
    keep_off_stdout(command in _TO_STDOUT and any(map(is_stdout, typed[2:])))
    logging.getLogger().addHandler(_run)


def keep_off_stdout(is_taken: bool) -> None:
    """Print the document to stderr if a scene goes to stdout."""
    _run.file = sys.stderr if is_taken else None


def print_document(**shown: Any) -> None:
    """Print the document of the command; `shown` are its values, by key or by Python field name.

    `stages` are seconds by stage, `seconds` by default their sum.
    """
    values = _renamed(shown)
    if "lost" in values:
        values["lost"] = list(map(as_typed, values["lost"]))
    warned = [*_run.warnings, *[NOT_MEASURED] * _lacks_loss(values)]
    whole = {"schema": SCHEMA, "command": _run.command, "warnings": warned} | values
    if whole.get("seconds") is None:
        stages = whole.get("stages")
        whole["seconds"] = sum(stages.values()) if stages else time.perf_counter() - _run.start
    ordered = {key: whole.get(key) for key in KEYS}
    file = _run.file
    print(json.dumps(finite(ordered | whole), allow_nan=False), file=file)


def _lacks_loss(values: Mapping[str, Any]) -> bool:
    """Whether a loss in rendered views should be stated, but is not."""
    if _run.command == "share":
        return any(each["encoded"] and not each["rendered"] for each in values.get("scenes", ()))
    prepared = _run.command == "prepare" or values.get("prepared") is not None
    return lacks_loss(values.get("rendered", {}), values.get("profile"), prepared)


def print_error(kind: str, text: str) -> None:
    """Print the document of a command that failed, if `--json` was given."""
    if _run.as_json:
        print_document(error={"kind": kind, "text": text})


def _renamed(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {_NAMES.get(name, name): _renamed(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_renamed(each) for each in value]
    return value

"""What the commands print: results on stdout, status and progress on stderr."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

from gs_codec.report import Progress as ProgressCallback

#: What commands read.
SCENES = "A scene: .ply, .egs, .splat, .spz, .sog or its meta.json."


def print_json(value: Any) -> None:
    """One JSON document on stdout."""
    print(json.dumps(value))


def print_text(text: str) -> None:
    """A line on stdout."""
    print(text)


def print_status(text: str) -> None:
    """A line on stderr."""
    print(text, file=sys.stderr)


def print_table(columns: list[str], rows: list[list[str]], file: TextIO | None = None) -> None:
    """Aligned columns; the first to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(columns, *rows, strict=True)]
    for row in [columns, *rows]:
        cells = [cell.rjust(width) for cell, width in zip(row, widths, strict=True)]
        cells[0] = row[0].ljust(widths[0])
        print("  ".join(cells).rstrip(), file=file)


@contextmanager
def progress_bar(enabled: bool = True) -> Iterator[ProgressCallback | None]:
    """A progress bar on stderr while the block runs, if stderr is a terminal."""
    console = Console(stderr=True)
    if not (enabled and console.is_terminal):
        yield None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn())
    with Progress(*columns, TimeElapsedColumn(), console=console, transient=True) as bar:
        tasks: dict[str, Any] = {}

        def update(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=total)
            bar.update(tasks[stage], completed=done)

        yield update


def size_text(size: float) -> str:
    """A number of bytes with its unit, decimal."""
    for unit in ("bytes", "kB", "MB"):
        if size < 1000 or unit == "MB":
            break
        size /= 1000
    return f"{size:.0f} {unit}" if unit == "bytes" else f"{size:.2f} {unit}"

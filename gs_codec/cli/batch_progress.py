"""How far a batch has come: bars on a terminal, lines elsewhere; on stderr."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)

from gs_codec.cli.output import progress_lines, smaller
from gs_codec.errors import printable


@contextmanager
def watching() -> Iterator[Any]:
    """A watcher that shows what it hears."""
    console = Console(stderr=True, emoji=False, highlight=False, markup=False, soft_wrap=True)
    if not console.is_terminal:
        yield _Lines(console)
        return
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeElapsedColumn(), console=console, transient=True) as bars:
        yield _Bars(console, bars)


class _Lines:
    """A line for each scene that is done, and for what is being done where that takes long."""

    def __init__(self, console: Console) -> None:
        self._console, self._total, self._count = console, 0, 0
        self._told = progress_lines(time.monotonic)

    def begun(self, total: int, skipped: int, report: str) -> None:
        """See `Watcher.begun`."""
        self._total = total
        done = f", {skipped:,} complete before" if skipped else ""
        self.said(f"scenes to encode: {total:,}{done}; report: {report}")

    def started(self, task: Any) -> None:
        """See `Watcher.started`."""

    def stage(self, task: Any, stage: str, done: int, total: int) -> None:
        """See `Watcher.stage`."""
        self._told(f"{task.name}: {stage}", done, total)

    def ended(self, task: Any, record: Any) -> None:
        """See `Watcher.ended`."""
        self._count += 1
        for warning in record.warnings:
            self.said(f"warning: {warning}")
        place = f"[{self._count}/{self._total}] "
        if record.error is not None:
            self.said(f"{place}error: {record.error['text']}")
            return
        sizes = smaller(record.input_bytes, record.output_bytes, record.ratio)
        self.said(f"{place}{task.name}: {record.gaussians:,} Gaussians, {sizes}")

    def said(self, text: str) -> None:
        """See `Watcher.said`."""
        self._console.print(printable(text))


class _Bars(_Lines):
    """Lines above a bar for the whole and one for the stage of each scene that is running."""

    def __init__(self, console: Console, bars: Progress) -> None:
        super().__init__(console)
        self._bars, self._whole, self._running = bars, TaskID(0), dict[str, TaskID]()

    def begun(self, total: int, skipped: int, report: str) -> None:
        """See `Watcher.begun`."""
        super().begun(total, skipped, report)
        self._whole = self._bars.add_task("scenes", total=total)

    def started(self, task: Any) -> None:
        """See `Watcher.started`."""
        if task.name not in self._running:
            self._running[task.name] = self._bars.add_task(printable(task.name), total=None)

    def stage(self, task: Any, stage: str, done: int, total: int) -> None:
        """See `Watcher.stage`."""
        self.started(task)  # somewhere else, which nobody told
        text = printable(f"{task.name}: {stage}")
        self._bars.update(self._running[task.name], description=text, completed=done, total=total)

    def ended(self, task: Any, record: Any) -> None:
        """See `Watcher.ended`."""
        if task.name in self._running:
            self._bars.remove_task(self._running.pop(task.name))
        super().ended(task, record)
        self._bars.advance(self._whole)

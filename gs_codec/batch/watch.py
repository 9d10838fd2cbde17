"""What a batch tells while it runs."""

from __future__ import annotations

import time

from gs_codec.batch.ledger import Record
from gs_codec.batch.scenes import Task
from gs_codec.report import Progress

#: Seconds between two reports of a stage, which nobody could read faster.
_EVERY = 0.1


class Watcher:
    """Hears what happens; this one does nothing about it."""

    def begun(self, total: int, skipped: int, report: str) -> None:
        """Work begins on so many scenes, besides those that are done already."""

    def started(self, task: Task) -> None:
        """A scene is begun."""

    def stage(self, task: Task, stage: str, done: int, total: int) -> None:
        """A stage of encoding it has come so far."""

    def ended(self, task: Task, record: Record) -> None:
        """A scene is done, or failed."""

    def said(self, text: str) -> None:
        """Something to know."""


def throttled(progress: Progress) -> Progress:
    """Every new stage, but of what is done of one no more than can be read."""
    last = ("", 0.0)

    def tell(stage: str, done: int, total: int) -> None:
        nonlocal last
        now = time.monotonic()
        if stage != last[0] or now - last[1] > _EVERY:
            last = (stage, now)
            progress(stage, done, total)

    return tell

"""What a batch tells while it runs."""

from __future__ import annotations

from gs_codec.batch.ledger import Record
from gs_codec.batch.scenes import Task


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

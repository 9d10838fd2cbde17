"""Events of a running batch."""

from __future__ import annotations

import time

from gs_codec.batch.ledger import Record
from gs_codec.batch.scenes import Task
from gs_codec.report import Progress

#: Least seconds between two progress reports of a stage.
_EVERY = 0.1


class Watcher:
    """Gets the events of a batch; this base class ignores them."""

    def begun(self, total: int, skipped: int, report: str) -> None:
        """The batch begins: `total` scenes to encode, `skipped` already done."""

    def started(self, task: Task) -> None:
        """A scene was started."""

    def stage(self, task: Task, stage: str, done: int, total: int) -> None:
        """Progress of a stage of encoding a scene."""

    def ended(self, task: Task, record: Record) -> None:
        """A scene is done, or failed."""

    def said(self, text: str) -> None:
        """A message for the user."""


def throttled(progress: Progress) -> Progress:
    """Pass on every new stage, and at most ten updates a second within a stage."""
    last = ("", 0.0)

    def tell(stage: str, done: int, total: int) -> None:
        nonlocal last
        now = time.monotonic()
        if stage != last[0] or now - last[1] > _EVERY:
            last = (stage, now)
            progress(stage, done, total)

    return tell

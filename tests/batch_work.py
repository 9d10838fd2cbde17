"""Replacements for the work of batch workers, found by name in their processes."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gs_codec.batch import run, work
from gs_codec.batch.ledger import Record
from gs_codec.batch.scene_tasks import Options, Task
from gs_codec.errors import GsCodecError
from gs_codec.workers.interface import Listener, Place, Serial

record_scene = work.record_scene

FOREVER = 3600.0


def lines(report: str | Path) -> int:
    """Number of complete lines of a report, which may not exist yet."""
    path = Path(report)
    return path.read_bytes().count(b"\n") if path.exists() else 0


def stuck_in_fsync(options: Options, task: Task, place: Place) -> Record:
    """Never finish writing an output once $REPORT has $HOLD lines; create $HELD."""

    def stick(descriptor: int) -> None:
        Path(os.environ["HELD"]).touch()
        time.sleep(FOREVER)

    if lines(os.environ["REPORT"]) >= int(os.environ["HOLD"]):
        os.fsync = stick
        # With unnamed temporary files, nothing would be left of unfinished outputs.
        os.__dict__.pop("O_TMPFILE", None)
    return record_scene(options, task, place)


def killed(options: Options, task: Task, place: Place) -> Record:
    """Die as if killed by the system: always at `twice.ply`, at `once.ply` the first time."""
    mark = Path(task.source.path).with_suffix(".mark")
    if task.name == "twice.ply" or (task.name == "once.ply" and not mark.exists()):
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return record_scene(options, task, place)


@contextmanager
def in_this_process(
    jobs: int, limit: int | None, folder: str, watcher: Listener
) -> Iterator[Serial]:
    """Replaces `Pool`."""
    yield Serial(folder, watcher)


def waiting(options: Options, task: Task, place: Place) -> Record:
    """Create $HELD, and continue once $GO exists."""
    Path(os.environ["HELD"]).touch()
    while not Path(os.environ["GO"]).exists():
        time.sleep(0.02)
    return record_scene(options, task, place)


def alone(options: Options, task: Task, place: Place) -> Record:
    """Fail if a thread is started."""

    def refuse(thread: threading.Thread) -> None:
        raise GsCodecError(f"{thread.name} started")

    threading.Thread.start = refuse
    return record_scene(options, task, place)


def held(options: Options, task: Task, place: Place) -> Record:
    """Hold a task of a Dask worker once $REPORT has $HOLD lines, and create $HELD."""
    while lines(os.environ["REPORT"]) < int(os.environ["HOLD"]):
        time.sleep(0.05)
    Path(os.environ["HELD"]).touch()
    time.sleep(FOREVER)
    return record_scene(options, task, place)


def main() -> None:
    """The command line, with workers that run $WORK, and with Ctrl-C enabled."""
    from gs_codec.cli.main import main as command

    signal.signal(signal.SIGINT, signal.default_int_handler)
    if "WORK" in os.environ:
        run.record_scene = globals()[os.environ["WORK"]]
    command()


def dask_setup(worker: Any) -> None:
    """Called by ``dask worker --preload``."""
    work.record_scene = held


if __name__ == "__main__":
    # Workers find the functions above by the name of this module, which is not __main__ there.
    from batch_work import main

    main()

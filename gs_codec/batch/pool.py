"""Worker processes: as many as fit into memory, ended with the process that started them."""

from __future__ import annotations

import multiprocessing
import multiprocessing.resource_tracker
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait

from gs_codec.batch.ledger import Record
from gs_codec.batch.redaction import redact_process
from gs_codec.batch.scenes import Task
from gs_codec.report import Progress
from gs_codec.runtime.programs import how_ended
from gs_codec.runtime.warned import log_warnings

#: What a worker does with a task: a function that can be pickled, or a partial of one.
Work = Callable[[Task, Progress], Record]

_SPAWN = multiprocessing.get_context("spawn")

#: Least seconds between two progress reports of a stage.
_EVERY = 0.1


class Pool:
    """Processes that work on one task after another.

    A task whose process is killed from outside is tried once more, alone, after all others.

    Parameters
    ----------
    work : callable
    jobs : int
        Most processes.
    limit : int, optional
        Bytes of memory for all running tasks; a task that needs more runs alone. None: no limit.
    watcher : Watcher
    """

    def __init__(self, work: Work, jobs: int, limit: int | None, watcher: Watcher) -> None:
        self._work, self._jobs, self._limit, self._watcher = work, jobs, limit, watcher
        self._waiting: deque[Task] = deque()
        self._again: deque[Task] = deque()
        self._idle: list[_Worker] = []
        self._busy: list[_Worker] = []
        self._tried: set[Task] = set()

    def run(self, tasks: Iterable[Task]) -> Generator[tuple[Task, Record], None, None]:
        """Yield each task and its record when it is done; end all processes at the end."""
        self._waiting.extend(tasks)
        try:
            self._start()
            while self._busy:
                for connection in wait([worker.connection for worker in self._busy]):
                    worker = next(w for w in self._busy if w.connection is connection)
                    if (record := self._hear(worker)) is not None:
                        yield worker.task, record
                self._start()
        finally:
            for worker in [*self._busy, *self._idle]:
                worker.end()

    def stop(self) -> None:
        """Start no more scenes."""
        self._waiting.clear()
        self._again.clear()

    def _start(self) -> None:
        """Start tasks while they fit."""
        while len(self._busy) < self._jobs and (task := self._next()) is not None:
            worker = self._idle.pop() if self._idle else _Worker(self._work)
            self._busy.append(worker)
            self._watcher.started(task)
            worker.give(task)

    def _next(self) -> Task | None:
        """The first waiting task that fits into memory beside the running ones."""
        taken = sum(worker.task.need for worker in self._busy)
        for task in self._waiting:
            if not self._busy or self._limit is None or taken + task.need <= self._limit:
                self._waiting.remove(task)
                return task
        return self._again.popleft() if self._again and not self._busy else None

    def _hear(self, worker: _Worker) -> Record | None:
        """Receive a message: return a record, or pass progress to the watcher."""
        try:
            said = worker.connection.recv()
        except (EOFError, OSError):
            return self._lost(worker)
        if isinstance(said, Record):
            self._busy.remove(worker)
            self._idle.append(worker)
            return said
        self._watcher.stage(worker.task, *said)
        return None

    def _lost(self, worker: _Worker) -> Record | None:
        self._busy.remove(worker)
        ended, task = worker.end(), worker.task
        if task not in self._tried:
            self._tried.add(task)
            self._again.append(task)
            self._watcher.said(f"{task.name}: its process {ended}; will be tried again alone")
            return None
        text = f"{task.shown[0]}: its process {ended}, twice; it may need more memory than there is"
        return Record(*task.shown, error={"kind": "WorkerLost", "text": text})


class _Worker:
    """A process, and the task it has."""

    task: Task

    def __init__(self, work: Work) -> None:
        self.connection, other = _SPAWN.Pipe()
        self.process = _SPAWN.Process(target=_serve, args=(other, work), daemon=True)
        with _without_interrupt():
            self.process.start()
        # Only the worker may hold its end of the pipe, so that it closes when the worker dies.
        other.close()

    def give(self, task: Task) -> None:
        """Send a task; if the process is gone, reading its answer shows that."""
        self.task = task
        with suppress(OSError):
            self.connection.send(task)

    def end(self) -> str:
        """Kill the process, whatever it does, and say how it ended."""
        self.process.kill()
        self.process.join()
        self.connection.close()
        return how_ended(self.process.exitcode or 0)


@contextmanager
def _without_interrupt() -> Iterator[None]:
    """Children started in the block ignore Ctrl-C; their parent ends them."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    # The tracker would start with the first process, and it unblocks signals: start it now.
    multiprocessing.resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(connection: Connection, work: Work) -> None:
    """Work on the tasks that come until the parent is gone."""
    redact_process()
    log_warnings()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    while True:
        try:
            task = connection.recv()
            connection.send(work(task, throttled(lambda *said: connection.send(said))))
        except (EOFError, BrokenPipeError, ConnectionResetError):
            return


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


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

"""Worker processes: as many as fit into memory; they end with their parent."""

from __future__ import annotations

import multiprocessing
import multiprocessing.resource_tracker
import os
import signal
import threading
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from typing import Any

from gs_codec.runtime.programs import how_ended
from gs_codec.runtime.redaction import redact_process
from gs_codec.runtime.wording import log_warnings
from gs_codec.workers.interface import (
    Done,
    Listener,
    Place,
    R,
    T,
    Task,
    Work,
    WorkerLost,
    throttled,
)

_SPAWN = multiprocessing.get_context("spawn")


class Pool:
    """Processes that run tasks one after another; see `Workers`.

    They end with the ``with`` block of the pool. A task whose process is killed from outside is
    retried once, alone, after all others.

    Parameters
    ----------
    jobs : int
        Maximum number of processes.
    limit : int, optional
        Bytes of memory for all running tasks; a task that needs more runs alone. None means no
        limit.
    folder : str
        Folder for temporary files of tasks.
    listener : Listener, optional
    """

    name, at_once = "workers", 1

    def __init__(
        self, jobs: int, limit: int | None, folder: str, listener: Listener | None = None
    ) -> None:
        self._jobs, self._limit, self._folder = jobs, limit, folder
        self._listener = listener or Listener()
        self._waiting, self._again = deque[Any](), deque[Any]()
        self._idle: list[_Worker] = []
        self._busy: list[_Worker] = []
        self._tried = set[str]()

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *error: object) -> None:
        for worker in [*self._busy, *self._idle]:
            worker.end()

    def run(self, work: Work[T, R], tasks: Iterable[T]) -> Generator[Done[T, R], None, None]:
        """See `Workers`."""
        self._waiting.extend(tasks)
        self._tried.clear()
        try:
            self._start(work)
            while self._busy:
                for connection in wait([worker.connection for worker in self._busy]):
                    worker = next(w for w in self._busy if w.connection is connection)
                    if (done := self._hear(worker)) is not None:
                        yield done
                self._start(work)
        finally:
            self.stop()
            while self._busy:
                self._busy.pop().end()

    def stop(self) -> None:
        """See `Workers`."""
        self._waiting.clear()
        self._again.clear()

    def _start(self, work: Work[T, R]) -> None:
        """Start tasks while they fit."""
        while len(self._busy) < self._jobs and (task := self._next()) is not None:
            worker = self._idle.pop() if self._idle else _Worker(self._jobs, self._folder)
            self._busy.append(worker)
            self._listener.started(task)
            worker.give(work, task)

    def _next(self) -> Any:
        """The first waiting task that fits into memory next to the running ones, or None."""
        taken = sum(worker.task.need for worker in self._busy)
        for task in self._waiting:
            if not self._busy or self._limit is None or taken + task.need <= self._limit:
                self._waiting.remove(task)
                return task
        return self._again.popleft() if self._again and not self._busy else None

    def _hear(self, worker: _Worker) -> Done | None:
        """Receive a message: return a finished task, or forward progress to the listener."""
        try:
            said = worker.connection.recv()
        except (EOFError, OSError):
            return self._lost(worker)
        if isinstance(said, Done):
            self._busy.remove(worker)
            self._idle.append(worker)
            return said
        self._listener.stage(worker.task, *said)
        return None

    def _lost(self, worker: _Worker) -> Done | None:
        self._busy.remove(worker)
        ended, task = worker.end(), worker.task
        if task.name not in self._tried:
            self._tried.add(task.name)
            self._again.append(task)
            self._listener.said(f"{task.name}: its process {ended}; retrying it alone")
            return None
        text = f"its process {ended}, twice; it may need more memory than available"
        return Done(task, error=WorkerLost(text))


class _Worker:
    """A process and its current task."""

    task: Task

    def __init__(self, jobs: int, folder: str) -> None:
        self.connection, other = _SPAWN.Pipe()
        self.process = _SPAWN.Process(target=_serve, args=(other, jobs, folder), daemon=True)
        with _without_interrupt():
            self.process.start()
        # Only the worker may hold its end of the pipe, so that the pipe closes when the worker
        # dies.
        other.close()

    def give(self, work: Work, task: Task) -> None:
        """Send a task; if the process is gone, reading its answer will show that."""
        self.task = task
        with suppress(OSError):
            self.connection.send((work, task))

    def end(self) -> str:
        """Kill the process, and return how it ended."""
        self.process.kill()
        self.process.join()
        self.connection.close()
        return how_ended(self.process.exitcode or 0)


@contextmanager
def _without_interrupt() -> Iterator[None]:
    """Make children started in the block ignore Ctrl-C; their parent ends them."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    # The tracker would start with the first process, and unblock signals, so start it now.
    multiprocessing.resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(connection: Connection, jobs: int, folder: str) -> None:
    """Run incoming tasks until the parent is gone."""
    redact_process()
    log_warnings()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    while True:
        try:
            work, task = connection.recv()
            place = Place(jobs, folder, throttled(lambda *said: connection.send(said)))
            connection.send(Done.by(work, task, place))
        except (EOFError, BrokenPipeError, ConnectionResetError):
            return


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)

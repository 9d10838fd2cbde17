"""Run jobs in a background thread; a new job replaces earlier ones of its kind."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from typing import TypeVar

from viewer.scenes.opened import Progress

#: Returns True if the job's result is no longer wanted.
Stale = Callable[[], bool]

#: Takes a function without arguments, and makes the window's thread call it.
Post = Callable[[Callable[[], None]], None]

Result = TypeVar("Result")


class Cancelled(Exception):
    """Ends a job whose result is no longer wanted."""


class Worker:
    """A thread that runs jobs and passes their results to the window's thread.

    Parameters
    ----------
    post : callable
        Takes a function without arguments and makes the window's thread call it.
    """

    def __init__(self, post: Post) -> None:
        self._post = post
        self._wanted: dict[str, int] = {}
        self._waiting: dict[str, Callable[[Stale, Post], None]] = {}
        self._running: str | None = None
        self._changed = threading.Condition()
        self._ended = False
        self._others: list[Worker] = []
        threading.Thread(target=self._run, daemon=True).start()

    def another(self) -> Worker:
        """Another thread, for jobs that must not wait for these; it ends with this one."""
        self._others.append(Worker(self._post))
        return self._others[-1]

    def submit(
        self,
        kind: str,
        job: Callable[[Stale], Result],
        done: Callable[[Result], None],
        failed: Callable[[Exception], None],
    ) -> None:
        """Run a job; it replaces unfinished jobs of its kind.

        `done` is called with its result, or `failed` with its exception.
        """
        with self._changed:
            self._wanted[kind] = self._wanted.get(kind, 0) + 1
            self._waiting[kind] = partial(_work, job, done, failed)
            self._changed.notify()

    def cancel(self, kind: str) -> None:
        """Drop the waiting job of a kind, and the result of the running one."""
        with self._changed:
            self._wanted[kind] = self._wanted.get(kind, 0) + 1
            self._waiting.pop(kind, None)

    def progress(self, stale: Stale, show: Callable[[float], None]) -> Progress:
        """A callback for a job's progress, 0-1; ends the job if it is stale."""

        def progress(stage: str, done: int, total: int) -> None:
            if stale():
                raise Cancelled
            self._post(lambda: None if stale() else show(done / max(total, 1)))

        return progress

    @property
    def kinds(self) -> set[str]:
        """Kinds of the waiting and running jobs."""
        with self._changed:
            return {*self._waiting, *filter(None, [self._running])}

    @property
    def busy(self) -> bool:
        """Whether any job is waiting or running."""
        return bool(self.kinds)

    def end(self) -> None:
        """Let this thread and further ones end after their current jobs."""
        with self._changed:
            self._ended = True
            self._waiting.clear()
            self._changed.notify()
        for other in self._others:
            other.end()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._running = None
                while not self._waiting and not self._ended:
                    self._changed.wait()
                if self._ended:
                    return
                kind = next(iter(self._waiting))
                work, number = self._waiting.pop(kind), self._wanted[kind]
                self._running = kind
            stale = partial(self._is_stale, kind, number)
            work(stale, partial(self._give, stale))

    def _is_stale(self, kind: str, number: int) -> bool:
        return self._ended or self._wanted[kind] != number

    def _give(self, stale: Stale, call: Callable[[], None]) -> None:
        """Pass on a job's result."""
        # The window may be gone when a job ends later.
        if not self._ended:
            self._post(lambda: None if stale() else call())


def _work(
    job: Callable[[Stale], Result],
    done: Callable[[Result], None],
    failed: Callable[[Exception], None],
    stale: Stale,
    give: Post,
) -> None:
    try:
        result = job(stale)
    except Exception as error:
        give(partial(failed, error))
    else:
        give(partial(done, result))

"""The common interface of workers, which run tasks and yield each when it is done; serial ones."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, Protocol, TypeVar

from gs_codec.errors import GsCodecError
from gs_codec.report import Progress

#: Minimum seconds between progress reports of a stage.
_EVERY = 0.1


class Task(Protocol):
    """A task for a worker; must be picklable."""

    @property
    def name(self) -> str:
        """Identifies the task in events."""

    @property
    def need(self) -> int:
        """Estimated memory, bytes."""


T = TypeVar("T", bound=Task)
R = TypeVar("R")


@dataclass(frozen=True)
class Place:
    """The environment of a task.

    Parameters
    ----------
    jobs : int
        Number of concurrent tasks on this machine, which share its processors.
    folder : str
        Folder for temporary files.
    progress : callable
        Called with the task's progress.
    """

    jobs: int
    folder: str
    progress: Progress


#: The function that workers call with a task: picklable, or a partial of such a function.
Work = Callable[[T, Place], R]


class WorkerLost(Exception):
    """The processes that ran a task died in every attempt."""


@dataclass(frozen=True)
class Done(Generic[T, R]):
    """A finished task: its result, or its error."""

    task: T
    value: R | None = None
    error: BaseException | None = None

    @classmethod
    def by(cls, work: Work[T, R], task: T, place: Place) -> Done[T, R]:
        """Run a task."""
        try:
            return cls(task, work(task, place))
        except GsCodecError as error:
            return cls(task, error=error)


class Listener:
    """Receives the events of tasks; this base class ignores them."""

    def started(self, task: Any) -> None:
        """A task has started; not reported by a cluster."""

    def stage(self, task: Any, stage: str, done: int, total: int) -> None:
        """A task made progress in one of its stages."""

    def said(self, text: str) -> None:
        """A message for the user."""


class Workers(Protocol):
    """Workers that run tasks.

    Attributes
    ----------
    name : str
        Name of the workers in errors.
    at_once : int
        Number of concurrent tasks of one process; 0 without processes.
    """

    name: str
    at_once: int

    def run(self, work: Work[T, R], tasks: Iterable[T]) -> Generator[Done[T, R], None, None]:
        """Yield each task when it is done; closing the generator abandons the others.

        Raises InvalidInput if the workers are gone.
        """

    def stop(self) -> None:
        """Start no more tasks."""


def throttled(progress: Progress) -> Progress:
    """Forward every new stage, and at most ten updates a second within a stage."""
    last = ("", 0.0)

    def tell(stage: str, done: int, total: int) -> None:
        nonlocal last
        now = time.monotonic()
        if stage != last[0] or now - last[1] > _EVERY:
            last = (stage, now)
            progress(stage, done, total)

    return tell


class Serial:
    """Runs tasks in this process; see `Workers`.

    Parameters
    ----------
    folder : str
        Folder for temporary files of tasks.
    listener : Listener, optional
    """

    name, at_once = "serial", 1

    def __init__(self, folder: str, listener: Listener | None = None) -> None:
        self._folder, self._listener = folder, listener or Listener()
        self._stopped = False

    def run(self, work: Work[T, R], tasks: Iterable[T]) -> Generator[Done[T, R], None, None]:
        """See `Workers`."""
        for task in tasks:
            if self._stopped:
                return
            self._listener.started(task)
            place = Place(1, self._folder, partial(self._listener.stage, task))
            yield Done.by(work, task, place)

    def stop(self) -> None:
        """See `Workers`."""
        self._stopped = True

"""Run tasks in this process, one after another."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from functools import partial

from gs_codec.workers.interface import Done, Listener, Place, R, T, Work


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

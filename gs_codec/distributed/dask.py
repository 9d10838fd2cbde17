"""Workers of a Dask scheduler."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import distributed

from gs_codec.batch.client import connected, threads_of_hosts
from gs_codec.batch.redaction import without_secrets
from gs_codec.distributed.workers import Task
from gs_codec.errors import GsCodecError, InvalidInput, one_line
from gs_codec.report import Progress
from gs_codec.runtime.threads import available_threads, using_threads


class DaskWorkers:
    """The workers of a scheduler; a task of a lost worker is done by another. See `Workers`."""

    def __init__(
        self, client: distributed.Client, name: str, at_once: int, progress: Progress | None
    ) -> None:
        self._client, self._name, self._progress = client, name, progress
        self.at_once = at_once

    def run(self, stage: str, task: Task, numbers: Sequence[int]) -> None:
        """See `Workers`."""
        futures = [
            self._client.submit(
                _alone, task, number, pure=False, key=f"{stage}-{number}-{id(task)}"
            )
            for number in numbers
        ]
        try:
            completed = distributed.as_completed(futures, loop=self._client.loop)
            for done, future in enumerate(completed, 1):
                self._check(stage, future)
                if self._progress is not None:
                    self._progress(stage, done, len(futures))
        finally:
            if self._client.status == "running":
                self._client.cancel(futures)

    def _check(self, stage: str, future: distributed.Future) -> None:
        if future.status == "finished":
            return
        if future.status in ("cancelled", "lost"):
            raise InvalidInput(
                f"{self._name}: lost the scheduler; run the same command again to continue"
            )
        error = future.exception()
        if isinstance(error, GsCodecError):
            raise error
        if isinstance(error, distributed.KilledWorker):
            raise InvalidInput(
                f"{self._name}: {stage}: workers kept failing; choose a smaller max-memory"
            )
        raise InvalidInput(f"{self._name}: {stage}: {one_line(error) or type(error).__name__}")


def _alone(task: Task, number: int) -> None:
    """A task in one thread: a worker has others for other tasks."""
    with using_threads(1):
        task(number)


@contextmanager
def dask_workers(address: str, progress: Progress | None = None) -> Iterator[DaskWorkers]:
    """The workers at an address, or local ones: one for each thread that may be used.

    Raises
    ------
    InvalidInput, MissingTool
        As `connected`; or if there are no workers.
    """
    name = f"dask {without_secrets(address)}"
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as scratch,
        connected(address, available_threads(), scratch, name) as client,
    ):
        if not threads_of_hosts(client):
            raise InvalidInput(f"{name}: no workers")
        known = client.scheduler_info(n_workers=-1)["workers"].values()
        at_once = max(each["nthreads"] for each in known)
        yield DaskWorkers(client, name, at_once, progress)

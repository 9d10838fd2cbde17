"""Workers of a Dask scheduler, which reassigns the tasks of a lost worker."""

from __future__ import annotations

import platform
import secrets
import threading
from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

import distributed

from gs_codec.errors import InvalidInput
from gs_codec.runtime.memory import available_bytes
from gs_codec.runtime.redaction import without_secrets
from gs_codec.workers.client import connected, threads_of_workers
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

#: Dask starts no tasks on a worker that uses more than this share of its memory limit.
_SHARE = 0.7

_GONE = "lost the scheduler; run the same command again to continue (batch: with --resume)"


class DaskWorkers:
    """The workers of a scheduler; see `Workers`.

    A worker runs as many tasks at once as it has threads, if they fit into 70 % of its memory
    limit. A task that needs more than the limit is rejected.
    """

    def __init__(
        self,
        client: distributed.Client,
        name: str,
        threads: Sequence[tuple[str, int]],
        listener: Listener,
    ) -> None:
        self.name, self.at_once = name, max((number for _, number in threads), default=0)
        self._client, self._listener = client, listener
        self._hosts = Counter[str]()
        for host, number in threads:
            self._hosts[host] += number
        self._futures: dict[Any, Any] = {}
        self._stopped = False

    def run(self, work: Work[T, R], tasks: Iterable[T]) -> Generator[Done[T, R], None, None]:
        """See `Workers`."""
        named = {task.name: task for task in tasks}
        topic = f"gs-codec-{secrets.token_hex(8)}"
        self._client.subscribe_topic(topic, lambda event: self._hear(named, event[1]))
        futures = self._futures = {
            self._client.submit(_do, work, task, self._hosts, topic, pure=False): task
            for task in named.values()
        }
        try:
            done = distributed.as_completed(futures, loop=self._client.loop)
            for future in done:
                task = futures.pop(future)
                if future.status not in ("cancelled", "lost"):
                    yield _done(task, future)
                elif not self._stopped:
                    raise InvalidInput(f"{self.name}: {_GONE}")
        finally:  # also when the caller stops iterating early
            self._cancel()
            if self._client.status == "running":
                self._client.unsubscribe_topic(topic)

    def stop(self) -> None:
        """Stop starting tasks; see `Workers`."""
        self._stopped = True
        self._cancel()

    def _cancel(self) -> None:
        if self._futures and self._client.status == "running":
            self._client.cancel(list(self._futures))

    def _hear(self, named: dict[str, Any], said: dict[str, Any]) -> None:
        """Forward progress of a worker; called on Dask's own thread, before the task is done."""
        self._listener.stage(named[said["name"]], said["stage"], said["done"], said["total"])


@contextmanager
def dask_workers(address: str, jobs: int, folder: str, listener: Listener) -> Iterator[DaskWorkers]:
    """The workers of the scheduler at an address, or of one started here; see `connected`.

    Raises
    ------
    InvalidInput, MissingTool
        As in `connected`; or if a worker has another version.
    """
    name = f"dask {without_secrets(address)}"
    with connected(address, jobs, folder, name) as client:
        yield DaskWorkers(client, name, threads_of_workers(client), listener)


def _done(task: T, future: distributed.Future) -> Done[T, Any]:
    if future.status == "finished":
        return Done(task, future.result())
    error = future.exception()
    if isinstance(error, distributed.KilledWorker):
        error = WorkerLost(str(error))
    return Done(task, error=error)


class _Gate:
    """Makes the threads of a worker wait until their tasks fit into its memory."""

    def __init__(self) -> None:
        self._taken, self._running, self._changed = 0, 0, threading.Condition()

    @contextmanager
    def passed(self, need: int, most: int | None) -> Iterator[None]:
        """Wait until the task fits into memory, or nothing else runs."""
        with self._changed:
            self._changed.wait_for(
                lambda: not self._running or most is None or self._taken + need <= most
            )
            self._taken += need
            self._running += 1
        try:
            yield
        finally:
            with self._changed:
                self._taken -= need
                self._running -= 1
                self._changed.notify_all()


_GATE = _Gate()


@lru_cache
def _free_at_first() -> int | None:
    """Memory for all tasks of this worker if Dask sets no limit for it."""
    return available_bytes()


def _do(work: Work[Task, R], task: Task, hosts: Counter[str], topic: str) -> R:
    """Run a task on a worker; progress is sent as Dask events."""
    worker = distributed.get_worker()
    limit = worker.memory_manager.memory_limit
    if limit is not None and task.need > limit:
        raise InvalidInput(
            f"needs about {task.need / 1e9:.1f} GB of memory, "
            f"the limit of {worker.address} is {limit / 1e9:.1f} GB"
        )
    most = _free_at_first() if limit is None else int(limit * _SHARE)
    # A worker that joined later is not counted in `hosts`.
    jobs = max(hosts[platform.node()], worker.state.nthreads)

    def tell(stage: str, done: int, total: int) -> None:
        said = {"name": task.name, "stage": stage, "done": done, "total": total}
        worker.log_event(topic, said)

    with _GATE.passed(task.need, most):
        return work(task, Place(jobs, worker.local_directory, throttled(tell)))

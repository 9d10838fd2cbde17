"""Run a batch on a Dask cluster; the scheduler retries the scenes of a lost worker."""

from __future__ import annotations

import platform
import secrets
import threading
from collections import Counter
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import lru_cache
from typing import Any

import distributed

from gs_codec.batch.client import connected, threads_of_hosts
from gs_codec.batch.ledger import Record
from gs_codec.batch.memory import available_bytes
from gs_codec.batch.pool import Watcher, throttled
from gs_codec.batch.redaction import without_secrets
from gs_codec.batch.scenes import Options, Task
from gs_codec.batch.work import encode_one
from gs_codec.errors import InvalidInput, one_line

#: Dask starts no tasks on a worker that uses more than this share of its memory limit.
_SHARE = 0.7


class Cluster:
    """Encodes scenes on the workers of a Dask scheduler, or of one started on this machine.

    A worker runs as many scenes at once as it has threads, but no more than fit into 70 % of its
    memory limit. A scene that needs more than the limit is refused. The scenes that run on a host
    share its processors equally.

    Parameters
    ----------
    address, jobs, folder
        As for `connected`.
    options : Options
    watcher : Watcher

    """

    def __init__(
        self, address: str, jobs: int, folder: str, options: Options, watcher: Watcher
    ) -> None:
        self._address, self._jobs, self._folder = address, jobs, folder
        self._name = f"dask {without_secrets(address)}"
        self._options, self._watcher = options, watcher
        self._futures: dict[Any, Task] = {}
        self._client: Any = None
        self._topic = f"gs-codec-{secrets.token_hex(8)}"

    def run(self, tasks: Sequence[Task]) -> Generator[tuple[Task, Record], None, None]:
        """Yield each task and its record when it is done.

        Raises
        ------
        InvalidInput, MissingTool
            If there is no scheduler at the address, or a worker has another version.
        """
        with ExitStack() as stack:
            self._client = stack.enter_context(
                connected(self._address, self._jobs, self._folder, self._name)
            )
            hosts = threads_of_hosts(self._client)
            names = {task.name: task for task in tasks}
            self._client.subscribe_topic(self._topic, lambda event: self._hear(names, event[1]))
            for task in tasks:
                future = self._client.submit(
                    _encode_there, task, self._options, hosts, self._topic, pure=False
                )
                self._futures[future] = task
            # Cancel what is still queued, also when the caller stops iterating early.
            stack.callback(self.stop)
            done = distributed.as_completed(self._futures, loop=self._client.loop)
            for future in done:
                task = self._futures.pop(future)
                if future.status not in ("cancelled", "lost"):
                    yield task, self._record(task, future)
                elif self._client.status != "running":
                    raise InvalidInput(f"{self._name}: the scheduler is gone")

    def stop(self) -> None:
        """Start no more scenes."""
        if self._futures and self._client.status == "running":
            self._client.cancel(list(self._futures))

    def _hear(self, names: dict[str, Task], said: dict[str, Any]) -> None:
        """Pass on progress of a worker; called on Dask's own thread, before the record comes."""
        task = names[said["name"]]
        self._watcher.stage(task, said["stage"], said["done"], said["total"])

    def _record(self, task: Task, future: Any) -> Record:
        if future.status == "finished":
            return future.result()
        error = future.exception()
        lost = isinstance(error, distributed.KilledWorker)
        kind = "WorkerLost" if lost else type(error).__name__
        text = f"{task.shown[0]}: {one_line(error) or kind}"
        return Record(*task.shown, error={"kind": kind, "text": text})


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


def _encode_there(task: Task, options: Options, hosts: Counter[str], topic: str) -> Record:
    """Encode a scene on a worker, with its share of the host; progress is sent as Dask events."""
    worker = distributed.get_worker()
    limit = worker.memory_manager.memory_limit
    if limit is not None and task.need > limit:
        text = (
            f"{task.shown[0]}: needs about {task.need / 1e9:.1f} GB of memory, "
            f"the limit of {worker.address} is {limit / 1e9:.1f} GB"
        )
        return Record(*task.shown, error={"kind": "InvalidInput", "text": text})
    most = _free_at_first() if limit is None else int(limit * _SHARE)
    # A worker that joined later is not counted in `hosts`.
    at_once = max(hosts[platform.node()], worker.state.nthreads)
    options = options.with_share(at_once)

    def tell(stage: str, done: int, total: int) -> None:
        said = {"name": task.name, "stage": stage, "done": done, "total": total}
        worker.log_event(topic, said)

    with _GATE.passed(task.need, most):
        return encode_one(task, options, worker.local_directory, throttled(tell))

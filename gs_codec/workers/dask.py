"""Workers of a Dask scheduler, which reassigns the tasks of a lost worker."""

from __future__ import annotations

import logging
import platform
import secrets
import signal
import threading
from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import lru_cache
from typing import Any

import dask
import distributed
from distributed.system import MEMORY_LIMIT

from gs_codec import __version__
from gs_codec.errors import InvalidInput, MissingTool, one_line
from gs_codec.runtime.memory import available_bytes
from gs_codec.runtime.optional import pip_install
from gs_codec.runtime.redaction import redacted, without_secrets
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

_HOST = "127.0.0.1"


@contextmanager
def connected(address: str, jobs: int, folder: str, name: str) -> Iterator[distributed.Client]:
    """A client of the scheduler at an address, or of a local cluster with `jobs` processes.

    Raises InvalidInput or MissingTool if there is no scheduler at the address, or a package for its
    address is missing.

    Parameters
    ----------
    address : str
        Address of the scheduler, or ``local``.
    jobs : int
        Worker processes of a local cluster.
    folder : str
        Folder for temporary files of a local cluster.
    name : str
        Name of the cluster in errors.
    """
    # Hide Dask's messages about workers that come and go.
    for known in ("distributed", *logging.getLogger("distributed").manager.loggerDict):
        if known.startswith("distributed"):
            logging.getLogger(known).setLevel(logging.CRITICAL)
    with ExitStack() as stack:
        try:
            scheduler: Any = address
            if scheduler == "local":
                scheduler = stack.enter_context(start_cluster(jobs, folder))
            client = stack.enter_context(distributed.Client(scheduler, set_as_default=False))
        except ImportError as error:
            text = f"{name}: {one_line(error)}; {pip_install('cluster')}"
            raise MissingTool(text) from error
        except (OSError, ValueError, TimeoutError) as error:
            cause = redacted(one_line(error), address)
            raise InvalidInput(f"{name}: no scheduler found ({cause})") from error
        yield client


def threads_of_workers(client: distributed.Client) -> list[tuple[str, int]]:
    """Host of each worker, and its number of concurrent tasks; checks versions.

    Raises InvalidInput if a worker has another version.
    """
    threads = []
    for worker, found in client.run(_introduced, on_error="return").items():
        if not isinstance(found, tuple):
            raise InvalidInput(f"{worker}: {_why_silent(found)}")
        version, host, number = found
        if version != __version__:
            has = f"gs_codec {version}"
            raise InvalidInput(f"{worker}: {has}, expected gs_codec {__version__} on workers")
        threads.append((host, number))
    return threads


def _why_silent(error: Any) -> str:
    """Why a worker did not introduce itself."""
    if isinstance(error, ModuleNotFoundError):
        return f"no gs_codec ({one_line(error)}), expected gs_codec {__version__} on workers"
    if isinstance(error, OSError):
        return "the worker ended or is unreachable"
    return f"the worker failed ({one_line(error) or type(error).__name__})"


def _introduced(dask_worker: Any) -> tuple[str, str, int]:
    """Version of gs_codec on a worker, name of its host, and number of its threads."""
    return __version__, platform.node(), dask_worker.state.nthreads


class _Silent:
    """Prevents a Dask node from serving web pages, which it does even without a dashboard."""

    def start_http_server(self, *arguments: Any, **options: Any) -> None:
        """Open no port."""


class LocalScheduler(_Silent, distributed.Scheduler):
    """A scheduler without web pages."""


class LocalWorker(_Silent, distributed.Worker):
    """A worker without web pages, in a separate process."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        # Ctrl-C is handled by the parent process, which ends this one.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        super().__init__(*arguments, **options)


def start_cluster(jobs: int, folder: str) -> distributed.SpecCluster:
    """Start a scheduler and `jobs` worker processes with their files in `folder`.

    They and their client authenticate with a key known only to this process. Other users of the
    machine can reach the ports, but cannot connect without the key.
    """
    security = distributed.Security.temporary()
    common = {"host": _HOST, "protocol": "tls://", "security": security}
    worker = {
        "cls": distributed.Nanny,
        "options": common
        | {
            "worker_class": LocalWorker,
            "nthreads": 1,
            "memory_limit": MEMORY_LIMIT // jobs,
            "local_directory": folder,
            "silence_logs": logging.CRITICAL,
        },
    }
    # Dask imports modules from its folder first; its default folder may belong to another user.
    with dask.config.set({"temporary-directory": folder}):
        return distributed.SpecCluster(
            workers=dict.fromkeys(range(jobs), worker),
            scheduler={"cls": LocalScheduler, "options": common | {"port": 0, "dashboard": False}},
            security=security,
            silence_logs=logging.CRITICAL,
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

    Raises InvalidInput or MissingTool, as in `connected`; or if a worker has another version.
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

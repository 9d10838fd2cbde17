"""Clients of a Dask scheduler, which may be started on this machine."""

from __future__ import annotations

import logging
import platform
import signal
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import dask
import distributed
from distributed.system import MEMORY_LIMIT

from gs_codec import __version__
from gs_codec.errors import InvalidInput, MissingTool, one_line
from gs_codec.runtime.optional import pip_install
from gs_codec.runtime.redaction import redacted

_HOST = "127.0.0.1"


@contextmanager
def connected(address: str, jobs: int, folder: str, name: str) -> Iterator[distributed.Client]:
    """A client of the scheduler at an address, or of a local cluster with `jobs` processes.

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

    Raises
    ------
    InvalidInput, MissingTool
        If there is no scheduler at the address, or a package for its address is missing.
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

    Raises
    ------
    InvalidInput
        If a worker has another version.
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

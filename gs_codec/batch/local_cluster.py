"""A private Dask cluster on this machine: only the process that starts it can connect."""

from __future__ import annotations

import logging
from typing import Any

import dask
from distributed import Nanny, Scheduler, Security, SpecCluster, Worker
from distributed.system import MEMORY_LIMIT

_HOST = "127.0.0.1"


class _Silent:
    """Keeps a Dask node from serving web pages, which it does even without a dashboard."""

    def start_http_server(self, *arguments: Any, **options: Any) -> None:
        """Open no port."""


class LocalScheduler(_Silent, Scheduler):
    """A scheduler without web pages."""


class LocalWorker(_Silent, Worker):
    """A worker without web pages."""


def start_cluster(jobs: int, folder: str) -> SpecCluster:
    """Start a scheduler and `jobs` worker processes that keep their files in `folder`.

    They and their client authenticate with a key that only this process has. Other users of the
    machine can reach the ports, but cannot connect without the key.
    """
    security = Security.temporary()
    common = {"host": _HOST, "protocol": "tls://", "security": security}
    worker = {
        "cls": Nanny,
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
        return SpecCluster(
            workers=dict.fromkeys(range(jobs), worker),
            scheduler={"cls": LocalScheduler, "options": common | {"port": 0, "dashboard": False}},
            security=security,
            silence_logs=logging.CRITICAL,
        )

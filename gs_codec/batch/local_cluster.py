"""A Dask cluster of this machine that only the process that starts it can talk to."""

from __future__ import annotations

import logging
from typing import Any

import dask
from distributed import Nanny, Scheduler, Security, SpecCluster, Worker
from distributed.system import MEMORY_LIMIT

_HOST = "127.0.0.1"


class _Silent:
    """Dask's nodes serve pages, without a dashboard too; these serve none."""

    def start_http_server(self, *arguments: Any, **options: Any) -> None:
        """Open no port."""


class LocalScheduler(_Silent, Scheduler):
    """A scheduler without pages."""


class LocalWorker(_Silent, Worker):
    """A worker without pages."""


def start_cluster(jobs: int, folder: str) -> SpecCluster:
    """Start a scheduler and `jobs` worker processes that keep their files in `folder`.

    They and their client know each other by a key of this process: whoever lacks it cannot
    connect, though every user of the machine reaches their ports.
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
    # Dask imports from its folder first; that of its choice may be another user's.
    with dask.config.set({"temporary-directory": folder}):
        return SpecCluster(
            workers=dict.fromkeys(range(jobs), worker),
            scheduler={"cls": LocalScheduler, "options": common | {"port": 0, "dashboard": False}},
            security=security,
            silence_logs=logging.CRITICAL,
        )

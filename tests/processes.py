"""Wait for other processes."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable
from typing import Any

#: Upper limit of any wait, in seconds; normal waits are much shorter.
LIMIT = 600

#: No timeouts on a busy machine.
PATIENT = {
    "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "300s",
    "DASK_DISTRIBUTED__COMM__TIMEOUTS__TCP": "300s",
    "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "10",
    "DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "30 minutes",
    "DASK_DISTRIBUTED__DEPLOY__LOST_WORKER_TIMEOUT": "300s",
}


def wait_for(condition: Callable[[], Any], process: subprocess.Popen) -> None:
    """Wait until a condition holds, which must happen before the process ends."""
    end = time.monotonic() + LIMIT
    while not condition():
        assert process.poll() is None, process.communicate(timeout=LIMIT)
        assert time.monotonic() < end
        time.sleep(0.02)


def finish(process: subprocess.Popen) -> tuple[int, str, str]:
    """Wait for a process and all its descendants, which hold its pipes open."""
    out, err = process.communicate(timeout=LIMIT)
    return process.returncode, out, err

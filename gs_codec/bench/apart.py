"""A command of the command line in a process of its own: its time and memory.

A small process runs it and reads what it took: a process counts at least the memory of the parent
that it was forked from.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass

from gs_codec.errors import GsCodecError

_RUN_AND_TELL = """
import json, resource, subprocess, sys, time
start = time.perf_counter()
status = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode
seconds = time.perf_counter() - start
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([seconds, used.ru_utime + used.ru_stime, 1024 * used.ru_maxrss]))
sys.exit(status != 0)
"""


@dataclass(frozen=True)
class Usage:
    """What a process took, its start included.

    Attributes
    ----------
    seconds : float
        By the clock.
    cpu_seconds : float
        Of processors.
    peak_bytes : int
        The largest resident size (Linux), mapped files included.
    """

    seconds: float
    cpu_seconds: float
    peak_bytes: int


def run_apart(arguments: list[str]) -> Usage:
    """Run ``gs-codec ARGUMENTS``.

    Raises
    ------
    GsCodecError
        If it fails; with the command's own message.
    """
    between = [sys.executable, "-I", "-S", "-c", _RUN_AND_TELL]
    command = [*between, sys.executable, "-m", "gs_codec", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"status {done.returncode}"]
        raise GsCodecError(lines[-1].removeprefix("gs-codec: error: "))
    return Usage(*json.loads(done.stdout))

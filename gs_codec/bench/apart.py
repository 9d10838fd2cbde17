"""A command of the command line in a process of its own, and what it took.

As a module this runs the command and prints that: ``wait4`` would count, for a process, the
memory of the parent it was forked from.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from gs_codec.cli.main import main
from gs_codec.errors import GsCodecError


@dataclass(frozen=True)
class Usage:
    """What a process took: time from its first line to its last, processors, memory at most.

    ``peak_bytes`` is the largest resident size (Linux), mapped files included, or 0 where the
    system does not tell.
    """

    seconds: float
    cpu_seconds: float
    peak_bytes: int


def run_apart(arguments: list[str]) -> Usage:
    """Run ``gs-codec ARGUMENTS``.

    Raises
    ------
    GsCodecError
        If it fails; with its own words.
    """
    command = [sys.executable, "-m", "gs_codec.bench.apart", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"status {done.returncode}"]
        raise GsCodecError(lines[-1].removeprefix("gs-codec: error: "))
    return Usage(**json.loads(done.stdout))


def peak_bytes() -> int:
    """Largest resident size of this process so far; 0 where the system does not tell."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return 1024 * int(line.split()[1])
    return 0


def _run() -> Usage:
    start = time.perf_counter()
    with open(os.devnull, "w") as sink, contextlib.redirect_stdout(sink):
        try:
            main()
        except SystemExit as stopped:
            if stopped.code:
                raise
    used = resource.getrusage(resource.RUSAGE_SELF)
    seconds = time.perf_counter() - start
    return Usage(seconds, used.ru_utime + used.ru_stime, peak_bytes())


if __name__ == "__main__":
    print(json.dumps(asdict(_run())))

"""Run one command of the command line and print the peak memory of this process, in bytes.

A module of its own because a process counts, in what ``wait4`` returns, the memory of the
parent it was forked from.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from gs_codec.cli.main import main


def peak_bytes() -> int:
    """Largest resident size so far (Linux), or 0 where the system does not tell."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return 1024 * int(line.split()[1])
    return 0


if __name__ == "__main__":
    with open(os.devnull, "w") as sink, contextlib.redirect_stdout(sink):
        try:
            main()
        except SystemExit as stopped:
            if stopped.code:
                raise
    print(peak_bytes())

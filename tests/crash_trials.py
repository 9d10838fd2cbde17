"""Run a command many times, kill it at a different moment each time, and report what is left.

    python crash_trials.py FOLDER SEED CALLS DELAYS COMMAND...

The command runs once in this process, then in its children. They kill themselves (SIGKILL, which
cannot be caught) at their k-th call of a Python or C function in the main thread: at CALLS random
k, and at twice as many between creating the file and naming it. This process kills them at DELAYS
random moments. It prints a JSON document: ``whole`` is the content of the folder after the complete
command, ``left`` the content after each kill, as digests by file name.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import random
import signal
import sys
import time
import types
from pathlib import Path


def run(command: list[str]) -> None:
    """Run a command in this process."""
    from gs_codec.cli import main as cli

    sys.argv = ["gs-codec", *command]
    sink = open(os.devnull, "w")  # noqa: SIM115
    # Exits are ignored: failures show in the files left behind.
    with sink, contextlib.redirect_stdout(sink), contextlib.suppress(SystemExit):
        cli.main()


def start(command: list[str], kill_at: int, writing_only: bool, output: int) -> int:
    """Run a command in a child that kills itself at a given call; return its process number.

    Calls are counted from the beginning (threads may shift this a little), or from creating the
    file.
    """
    pid = os.fork()
    if pid:
        return pid
    calls, made, named = 0, 0, 0

    def count(frame: types.FrameType, event: str, argument: object) -> None:
        nonlocal calls, made, named
        calls += event in ("call", "c_call")
        if frame.f_code.co_name == "_create":
            made = made or calls
        elif frame.f_code.co_name == "_keep_name":
            named = calls
        done = calls - made if made else -1
        if kill_at and kill_at == (done + 1 if writing_only else calls):
            os.kill(os.getpid(), signal.SIGKILL)

    sys.setprofile(count)
    run(command)
    sys.setprofile(None)
    os.write(output, f"{calls} {named - made}\n".encode())
    os._exit(0)


def contents(folder: Path) -> dict[str, str]:
    """Digest of each file."""
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}


def main() -> None:
    """Count the calls of the command, then kill it."""
    folder, command = Path(sys.argv[1]), sys.argv[5:]
    seed, calls, delays = map(int, sys.argv[2:5])
    kept = {path: path.read_bytes() for path in folder.iterdir()}
    reading, output = os.pipe()

    def reset() -> None:
        for path in folder.iterdir():
            path.unlink()
        for path, data in kept.items():
            path.write_bytes(data)

    run(command)
    reset()
    begin = time.monotonic()
    os.waitpid(start(command, 0, False, output), 0)
    took = time.monotonic() - begin
    total, writing = map(int, os.read(reading, 100).split())
    whole = contents(folder)
    rng = random.Random(seed)
    step = max(writing // (2 * calls), 1)
    moments = [(rng.randrange(1, total), False, 0.0) for _ in range(calls)]
    moments += [(k, True, 0.0) for k in range(1, writing + 2, step)]
    moments += [(0, False, rng.uniform(0, took)) for _ in range(delays)]
    left = []
    for kill_at, writing_only, delay in moments:
        reset()
        pid = start(command, kill_at, writing_only, output)
        if not kill_at:
            time.sleep(delay)
            os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        left.append(contents(folder))
    print(json.dumps({"calls": total, "whole": whole, "left": left}))


if __name__ == "__main__":
    main()

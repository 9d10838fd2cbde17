"""Run untrusted external programs.

They may abort, crash or hang on some inputs. Each run has its own process group and limits, and
every failure is a `ToolFailed`.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gs_codec.errors import MissingTool, ToolFailed, one_line
from gs_codec.runtime.wording import counted

# A shell sets the limits: setting them between fork and exec is unsafe with threads.
_LIMITED = 'ulimit -c 0; ulimit -S -t "$1"; ulimit -v "$2"; ulimit -f "$3"; shift 3; exec "$@"'

_LOG_BYTES = 4096

#: Minimum limit on the bytes of a file, so that the program's log has room.
_FILE = 1 << 20


@dataclass(frozen=True)
class Limits:
    """Limits of one run.

    Parameters
    ----------
    seconds : float
        Wall time; generous, because other programs may keep the processors busy.
    processor_seconds : int
    memory_bytes : int or None
        Address space; None for programs such as Node, which reserve more than the physical memory.
    """

    seconds: float = 600.0
    processor_seconds: int = 120
    memory_bytes: int | None = 4 << 30


def find_program(
    name: str, given: str | None, argument: str, how: str, limits: Limits, folder: str = ""
) -> tuple[str, str]:
    """Path of a program, and the first line it prints, which must contain its name.

    Raises MissingTool if there is none, or it is a different program.

    Parameters
    ----------
    name : str
    given : str, optional
        Its path, or its name in PATH; by default `name`.
    argument : str
        Argument that makes it print that line.
    how : str
        How to install it, for errors.
    limits : Limits
    folder : str
        Another folder to search for `name`.
    """
    found = shutil.which(given or name)
    if found is None and not given and folder:
        found = shutil.which(name, path=folder)
    if found is None:
        which = f"{given}: no such program" if given else f"{name}: not found"
        raise MissingTool(f"{which}; {how}")
    found = os.path.abspath(found)
    try:
        line = _first_line([found, argument], limits)
    except (OSError, ToolFailed) as error:
        raise MissingTool(f"{found}: cannot be run ({one_line(error)}); {how}") from error
    if name not in line.lower():
        raise MissingTool(f"{found}: not {name}, {argument} prints '{line[:80]}'; {how}")
    return found, line


def _first_line(command: Sequence[str], limits: Limits) -> str:
    """First line that a program prints, as printable ASCII; it may run for at most a minute.

    Raises ToolFailed or OSError if it does not end in time, or cannot be run.
    """
    with tempfile.TemporaryDirectory(prefix="gs_codec-") as folder:
        brief = replace(limits, seconds=60.0, processor_seconds=10)
        text = _run(command, folder, brief, 1 << 20)[0]
    return plain_text(text.partition(b"\n")[0])


def run_on_files(
    command: Sequence[str],
    inputs: Mapping[str, bytes | memoryview],
    output: str,
    limits: Limits,
    most: int,
) -> bytes:
    """Run a program in a folder with the files `inputs`; return the bytes of file `output`.

    Raises ToolFailed if it fails, exceeds its limits, or writes more than `most` bytes.
    """
    try:
        with tempfile.TemporaryDirectory(prefix="gs_codec-") as folder:
            for name, content in inputs.items():
                Path(folder, name).write_bytes(content)
            _, log, status = _run(command, folder, limits, most)
            if status:
                raise ToolFailed(_describe(status, log))
            return _read(Path(folder, output), most)
    except OSError as error:
        where = error.filename or "its files"
        raise ToolFailed(f"{where}: {one_line(error)}") from error


def plain_text(data: bytes | memoryview) -> str:
    """Untrusted bytes as printable ASCII."""
    text = bytes(data).decode("ascii", "replace").strip()
    return "".join(c if " " <= c <= "~" else "?" for c in text)


def _run(
    command: Sequence[str], folder: str, limits: Limits, most: int
) -> tuple[bytes, bytes, int]:
    """Run a command; return the start and end of its output, and its status (-N: signal N)."""
    try:
        import resource
    except ImportError:  # Windows
        raise MissingTool("other programs cannot be limited on this system") from None

    # In the units of the shell: seconds, KiB, 512 bytes.
    numbers = [
        _least(limits.processor_seconds, resource.getrlimit(resource.RLIMIT_CPU)[1], 1),
        _least(limits.memory_bytes, resource.getrlimit(resource.RLIMIT_AS)[1], 1 << 10),
        _least(max(most + 512, _FILE), resource.getrlimit(resource.RLIMIT_FSIZE)[1], 512),
    ]
    with tempfile.TemporaryFile(dir=folder) as log:
        process = subprocess.Popen(
            ["/bin/sh", "-c", _LIMITED, "sh", *numbers, *command],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            status = process.wait(limits.seconds)
        except subprocess.TimeoutExpired:
            raise ToolFailed(f"did not end in {limits.seconds:g} s") from None
        finally:
            end_group(process)
        log.seek(0)
        first = log.read(_LOG_BYTES)
        log.seek(max(log.seek(0, os.SEEK_END) - _LOG_BYTES, 0))
        return first, log.read(_LOG_BYTES), status


def end_group(process: subprocess.Popen[Any]) -> None:
    """Kill a process that began a session, and what it left in the background."""
    with suppress(OSError):  # nothing is left
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:  # Windows has no groups
            process.kill()
    process.wait()


def _least(limit: int | None, own: int, unit: int) -> str:
    """The lower of a limit and this process's own (negative: none), in units of `unit`."""
    # A shell computes with 64 bits: there, larger numbers would be small.
    limits = [value for value in (limit, own) if value is not None and 0 <= value <= sys.maxsize]
    return str(min(limits) // unit) if limits else "unlimited"


def how_ended(status: int) -> str:
    """How a process ended, by its exit status; -N is signal N."""
    if status >= 0:
        return f"ended with status {status}"
    names = {number.value: number.name for number in signal.Signals}
    return f"was stopped by {names.get(-status, f'signal {-status}')}"


def _describe(status: int, log: bytes) -> str:
    """How a run ended, and the last line it printed."""
    how = how_ended(status)
    lines = [line for line in map(plain_text, log.splitlines()) if line]
    return f"{how}: {lines[-1][-200:]}" if lines else how


def _read(path: Path, most: int) -> bytes:
    if not path.is_file():
        raise ToolFailed("wrote nothing")
    if path.stat().st_size > most:
        raise ToolFailed(f"wrote {counted(path.stat().st_size, 'byte')}, expected at most {most:,}")
    return path.read_bytes()

"""Compile all kernels that tests and documents use in advance, in several processes."""

from __future__ import annotations

import signal
from collections import defaultdict
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from gs_codec.errors import InvalidInput
from gs_codec.runtime.kernel_list import Entry, read_list
from gs_codec.runtime.threads import available_threads


@dataclass(frozen=True)
class WarmReport:
    """Result of `warm`.

    Attributes
    ----------
    kernels : int
        Number of listed kernels, counted once for each combination of types.
    compiled : int
        Number of kernels that had to be compiled.
    folder : Path
        Folder of the compiled kernels.
    """

    kernels: int
    compiled: int
    folder: Path


def warm(progress: Callable[[str, int, int], None]) -> WarmReport:
    """Compile kernels that are neither in the package nor in the cache.

    Raises InvalidInput if no folder can store them.
    """
    from gs_codec.runtime.kernel_cache import cache_folder, is_writable

    folder, entries = cache_folder(), read_list()
    if folder is None or not is_writable():
        raise InvalidInput(
            f"{folder or 'cache folder'}: cannot be written to, expected a folder for compiled "
            "kernels; set NUMBA_CACHE_DIR to another"
        )
    modules: dict[str, list[Entry]] = defaultdict(list)
    for entry in entries:
        modules[entry.module].append(entry)
    done = compiled = 0
    progress("compile", 0, len(entries))
    processes = min(available_threads(), len(modules))
    pool = ProcessPoolExecutor(processes, get_context("spawn"), _let_be)
    try:
        # Those with the most types first, because they take longest.
        ordered = sorted(modules.values(), key=lambda each: -sum(len(e.types) for e in each))
        for future in as_completed([pool.submit(_compile, each) for each in ordered]):
            done, compiled = done + future.result()[0], compiled + future.result()[1]
            progress("compile", done, len(entries))
    finally:
        pool.shutdown(cancel_futures=True)
    return WarmReport(len(entries), compiled, folder)


def _let_be() -> None:
    """Leave Ctrl-C to the parent process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _compile(entries: list[Entry]) -> tuple[int, int]:
    """Load or compile kernels; return their number, and how many were compiled."""
    from gs_codec.runtime import compiling

    before = compiling.count()
    for entry in entries:
        entry.kernel().compile(entry.signature())
    return len(entries), compiling.count() - before

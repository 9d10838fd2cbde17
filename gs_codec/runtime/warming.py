"""Compile in advance all kernels that tests and documents use, in several processes."""

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
    """What `warm` has done.

    Attributes
    ----------
    kernels : int
        Listed kernels, once for each combination of types.
    compiled : int
        How many were not there.
    folder : Path
        Where they are kept.
    """

    kernels: int
    compiled: int
    folder: Path


def warm(progress: Callable[[str, int, int], None]) -> WarmReport:
    """Compile kernels that neither came with the package nor are kept.

    Raises
    ------
    InvalidInput
        If no folder can keep them.
    """
    from gs_codec.runtime.kernel_cache import cache_folder, is_writable

    folder, entries = cache_folder(), read_list()
    if folder is None or not is_writable():
        raise InvalidInput(
            f"{folder or 'cache folder'}: cannot be written to, expected a folder for compiled "
            "kernels; NUMBA_CACHE_DIR names another"
        )
    modules: dict[str, list[Entry]] = defaultdict(list)
    for entry in entries:
        modules[entry.module].append(entry)
    done = compiled = 0
    progress("compile", 0, len(entries))
    processes = min(available_threads(), len(modules))
    pool = ProcessPoolExecutor(processes, get_context("spawn"), _let_be)
    try:
        # Those with most types first: they take longest.
        ordered = sorted(modules.values(), key=lambda each: -sum(len(e.types) for e in each))
        for future in as_completed([pool.submit(_compile, each) for each in ordered]):
            done, compiled = done + future.result()[0], compiled + future.result()[1]
            progress("compile", done, len(entries))
    finally:
        pool.shutdown(cancel_futures=True)
    return WarmReport(len(entries), compiled, folder)


def _let_be() -> None:
    """Leave Ctrl-C to the process that started this one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _compile(entries: list[Entry]) -> tuple[int, int]:
    """Load or compile kernels; their number, and how many this process had to compile."""
    from gs_codec.runtime import compiling

    before = compiling.count()
    for entry in entries:
        entry.kernel().compile(entry.signature())
    return len(entries), compiling.count() - before

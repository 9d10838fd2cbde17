"""Compile all listed kernels in advance: into the cache folder, or into the archives of a wheel.

Archives are written by ``python -m gs_codec.runtime.kernel_build``. A process compiles for one
processor, and names symbols by counting the functions that it compiles. So each tier has its own
process and its own range of numbers.
"""

from __future__ import annotations

import itertools
import os
import platform
import signal
import subprocess
import sys
import time
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
            "kernels; set NUMBA_CACHE_DIR to a writable one"
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


#: Kernels that are much faster with AVX-512; all others are compiled only for x86-64-v3.
_WIDE = {
    ("gs_codec.rendering.tiles_float32", "draw_float32"),
    ("gs_codec.rendering.tiles_float32", "sum_gradients"),
    ("gs_codec.rendering.traced_view", "_residual"),
    ("gs_codec.rendering.traced_view", "_trace"),
    ("gs_codec.guidance.sensitivity", "sum_moments"),
}

#: Start of the numbers, which no other process reaches.
_FIRST_NUMBER = 10**9


def build_all(folder: Path) -> None:
    """Write all archives into a folder, in parallel processes.

    Raises OSError if one could not be built, or this system is not supported.
    """
    from gs_codec.runtime.kernel_archive import TIERS, target_of

    if (sys.platform, platform.machine()) != ("linux", "x86_64"):
        raise OSError("kernels are compiled in advance for Linux on x86-64 alone")
    folder.mkdir(parents=True, exist_ok=True)
    started = []
    for tier in TIERS:
        name, features = target_of(tier)
        target = {"NUMBA_CPU_NAME": name, "NUMBA_CPU_FEATURES": features}
        command = [sys.executable, "-m", __spec__.name, tier, str(folder / f"{tier}.kernels")]
        started.append((tier, subprocess.Popen(command, env=os.environ | target)))
    for tier, process in started:
        if process.wait():
            raise OSError(f"kernels for {tier} could not be compiled")


def build(tier: str, path: Path) -> None:
    """Compile the kernels of a tier in this process, and write the archive."""
    from numba.core.bytecode import FunctionIdentity

    from gs_codec.runtime import kernel_archive, kernel_cache

    start, tiers = time.perf_counter(), list(kernel_archive.TIERS)
    kernel_cache.cache_folder = lambda: None  # type: ignore[assignment]
    kernel_archive.keep_runtime()
    first = _FIRST_NUMBER * (1 + tiers.index(tier))
    FunctionIdentity._unique_ids = itertools.count(first)
    kernels = []
    entries = [each for each in read_list() if tier == tiers[-1] or _is_wide(each)]
    for entry in entries:
        kernel, types = entry.kernel(), entry.signature()
        kernel.compile(types)
        kernels.append((kernel, types))
        if sys.stderr.isatty() or time.perf_counter() - start > 3:
            start = time.perf_counter()
            print(f"{tier}: {len(kernels)} of {len(entries)} kernels", file=sys.stderr)
    kernel_archive.write(path, kernels, runtime=tier == tiers[-1])


def _is_wide(entry: Entry) -> bool:
    return (entry.module, entry.name) in _WIDE


if __name__ == "__main__":
    if len(sys.argv) == 2:
        build_all(Path(sys.argv[1]))
    else:
        build(sys.argv[1], Path(sys.argv[2]))

"""Compile the listed kernels and write their archives: ``python -m gs_codec.runtime.kernel_build``.

A process compiles for one processor, and names symbols by counting the functions that it compiles.
So each tier has its own process and its own range of numbers.
"""

from __future__ import annotations

import itertools
import os
import platform
import subprocess
import sys
import time
from pathlib import Path

from gs_codec.runtime.kernel_list import Entry, read_list

#: Kernels that are much faster with AVX-512; all others are compiled only for x86-64-v3.
_WIDE = {
    ("gs_codec.rendering.traced_view", "_residual"),
    ("gs_codec.guidance.splat_moments", "sum_moments"),
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

"""Processor time of an encode and of a decode by compiled kernel, on one thread.

    python -m gs_codec.bench.kernel_times scene.ply --profile m --repeats 9

Least of several runs, in nanoseconds per Gaussian. A kernel includes those that it calls; the rest
is NumPy, other libraries and Python.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable
from time import thread_time
from typing import Any

from gs_codec.codecs.decode import decode_as
from gs_codec.config import Config
from gs_codec.encoding.order import encode
from gs_codec.encoding.request import Request
from gs_codec.formats.registry import read_with_overview
from gs_codec.runtime.kernels import Kernel


def times_of(run: Callable[[], object], repeats: int) -> tuple[float, dict[str, float]]:
    """Least seconds of a function that runs on the calling thread: in all, and by kernel."""
    call, seconds = Kernel.__call__, defaultdict[str, float](float)

    def timed(kernel: Kernel, *arguments: Any) -> Any:
        start = thread_time()
        result = call(kernel, *arguments)
        module = kernel.py_func.__module__.rpartition(".")[2]
        seconds[f"{module}.{kernel.py_func.__name__}"] += thread_time() - start
        return result

    def total() -> float:
        start = thread_time()
        run()
        return thread_time() - start

    run()  # loads the kernels
    whole = min(total() for _ in range(repeats))
    least: dict[str, float] = {}
    Kernel.__call__ = timed  # type: ignore[method-assign,assignment]
    try:
        for _ in range(repeats):
            seconds.clear()
            run()
            least = {name: min(taken, least.get(name, taken)) for name, taken in seconds.items()}
    finally:
        Kernel.__call__ = call  # type: ignore[method-assign]
    return whole, least


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("scene")
    parser.add_argument("--profile", default="m")
    parser.add_argument("--repeats", type=int, default=9)
    asked = parser.parse_args()
    scene, _ = read_with_overview(asked.scene)
    request = Request(Config(asked.profile, threads=1))
    data = b"".join(encode(scene, request)[0])
    for name, run in {
        "encode": lambda: encode(scene, request),
        "decode": lambda: decode_as(request.config, data),
    }.items():
        whole, kernels = times_of(run, asked.repeats)
        each = 1e9 / scene.count
        print(f"{name}: {whole * each:.0f} ns per Gaussian, {whole:.3f} s")
        for kernel, taken in sorted(kernels.items(), key=lambda item: -item[1]):
            if taken * each >= 1:
                print(f"  {taken * each:6.0f}  {kernel}")
        print(f"  {(whole - sum(kernels.values())) * each:6.0f}  the rest")


if __name__ == "__main__":
    main()

"""Threads for kernels that release the GIL; results never depend on their number."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def available_threads() -> int:
    """Processors this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_all(
    function: Callable[[Item], Result],
    items: Iterable[Item],
    threads: int | None = None,
    advance: Callable[[], None] | None = None,
) -> list[Result]:
    """Map `function` over `items` in threads, in order; `advance` is called after each.

    Threads see the caller's context variables.
    """
    results = []
    with ThreadPoolExecutor(threads or available_threads()) as pool:
        futures = [pool.submit(copy_context().run, function, item) for item in items]
        try:
            for future in futures:
                results.append(future.result())
                if advance is not None:
                    advance()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return results

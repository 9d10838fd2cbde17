"""Threads for kernels that release the GIL; results never depend on their number."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from threading import Semaphore
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

    An item is taken when a thread is free for it, so that what items are made of need not all
    be there at once. Threads see the caller's context variables.
    """
    number = threads or available_threads()
    results: list[Result] = []
    if number == 1:  # the caller's own: nothing to wait for
        for item in items:
            results.append(function(item))
            if advance is not None:
                advance()
        return results
    waiting: deque[Future[Result]] = deque()
    free = Semaphore(number)

    def work(item: Item) -> Result:
        try:
            return function(item)
        finally:
            free.release()

    def collect(future: Future[Result]) -> None:
        results.append(future.result())
        if advance is not None:
            advance()

    with ThreadPoolExecutor(number) as pool:
        try:
            for item in items:
                free.acquire()
                while waiting and waiting[0].done():
                    collect(waiting.popleft())
                waiting.append(pool.submit(copy_context().run, work, item))
            while waiting:
                collect(waiting.popleft())
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return results

"""Threads for kernels that release the GIL; results never depend on their number.

`using_threads` sets the number for everything that is called in its block.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from itertools import chain, islice
from threading import Semaphore
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

_SET: ContextVar[int | None] = ContextVar("threads", default=None)

#: Below this number of Gaussians or splats, one thread is faster than several.
_FEW = 1 << 12


@contextmanager
def using_threads(number: int | None, count: int = _FEW) -> Iterator[None]:
    """Use `number` threads in everything that the block calls, on `count` Gaussians or splats.

    None keeps the current number, except that few Gaussians use one thread.
    """
    token = _SET.set(number or _SET.get() or (1 if count < _FEW else None))
    try:
        yield
    finally:
        _SET.reset(token)


def available_threads() -> int:
    """Number of threads: the number set by `using_threads`, else one per processor."""
    return _SET.get() or processors()


def processors() -> int:
    """Number of processors that this process may use."""
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

    An item is taken when a thread is free, so a generator of items needs little memory. Threads see
    the caller's context variables. Nested calls of `run_all` use one thread, which is faster than
    several threads per item; if there are fewer items than threads, they share the threads.
    """
    number = threads or available_threads()
    results: list[Result] = []
    share = 1
    if number > 1:
        items = iter(items)
        first = list(islice(items, number))
        share = number // max(len(first), 1)
        items, number = chain(first, items), len(first)
    if number <= 1:  # run in the caller's thread
        for item in items:
            results.append(function(item))
            if advance is not None:
                advance()
        return results
    waiting: deque[Future[Result]] = deque()
    free = Semaphore(number)

    def work(item: Item) -> Result:
        try:
            with using_threads(share):
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


def work_behind(function: Callable[[int, Item], None], items: Iterable[Item]) -> None:
    """Call ``function(number, item)`` for each item, in order, in another thread.

    Meanwhile the next item is made. With a single thread, everything runs in the caller's.
    """
    if available_threads() == 1:
        for number, item in enumerate(items):
            function(number, item)
        return
    with ThreadPoolExecutor(1) as behind:
        working: Future[None] | None = None
        for number, item in enumerate(items):
            if working is not None:
                working.result()
            working = behind.submit(copy_context().run, function, number, item)
        if working is not None:
            working.result()

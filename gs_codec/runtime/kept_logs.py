"""Which records of some loggers are kept, in this thread."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager


@contextmanager
def keeping_logs(
    names: Iterable[str], keeps: Callable[[logging.LogRecord], bool]
) -> Iterator[None]:
    """Keep only some records of this thread's loggers within the block."""
    thread = threading.get_ident()

    def is_kept(record: logging.LogRecord) -> bool:
        return record.thread != thread or keeps(record)

    with ExitStack() as stack:
        for log in map(logging.getLogger, names):
            log.addFilter(is_kept)
            stack.callback(log.removeFilter, is_kept)
        yield


def keeping_new(
    names: Iterable[str],
    said: set[Hashable],
    key: Callable[[logging.LogRecord], Hashable] = logging.LogRecord.getMessage,
) -> AbstractContextManager[None]:
    """Like `keeping_logs`, keep only records whose key is not in `said`, which grows."""

    def is_new(record: logging.LogRecord) -> bool:
        found = (text := key(record)) not in said
        said.add(text)
        return found

    return keeping_logs(names, is_new)

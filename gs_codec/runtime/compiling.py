"""Messages while kernels are compiled, which takes seconds, so that users know why they wait."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from gs_codec.runtime import kernel_archive, kernel_cache

log = logging.getLogger(__name__)

#: Seconds of compiling before the first message, and between later ones.
_MOMENT = 0.5
_PAUSE = 2.5


class _Compiled:
    """What this process has compiled and is compiling; calls may be nested."""

    kernels = 0
    seconds = 0.0
    calls = 0
    begun: float | None = None
    logged_at: float | None = None
    done = threading.Event()


@contextmanager
def watched() -> Iterator[None]:
    """Load or compile a kernel in the block; only one thread does at a time."""
    _Compiled.calls += 1
    try:
        yield
    finally:
        _Compiled.calls -= 1
        if not _Compiled.calls and _Compiled.begun is not None:
            _Compiled.done.set()
            _Compiled.seconds += time.monotonic() - _Compiled.begun
            _Compiled.begun = None


def count() -> int:
    """Number of kernels that this process has compiled."""
    return _Compiled.kernels


def elapsed() -> float | None:
    """Seconds of the current compilation in this process; None if there is none."""
    begun = _Compiled.begun
    return None if begun is None else _Compiled.seconds + time.monotonic() - begun


def begin() -> None:
    """Note, in a `watched` block, that a kernel must be compiled."""
    _Compiled.kernels += 1
    if _Compiled.begun is None:
        _Compiled.begun, _Compiled.done = time.monotonic(), threading.Event()
        threading.Thread(target=_tell, args=(_Compiled.done,), daemon=True).start()


def _tell(done: threading.Event) -> None:
    """Log messages until compiling is done."""
    wait = _MOMENT - _Compiled.seconds
    if _Compiled.logged_at is not None:
        wait = _PAUSE - (time.monotonic() - _Compiled.logged_at)
    while not done.wait(max(wait, 0.0)):
        if _Compiled.logged_at is None:
            _tell_first()
        else:
            seconds = elapsed() or _Compiled.seconds  # compilation may have just ended
            log.info("compiling kernels: %d so far, %.0f s", _Compiled.kernels, seconds)
        _Compiled.logged_at, wait = time.monotonic(), _PAUSE


def _tell_first() -> None:
    why = kernel_archive.why_not()
    text = f"compiling kernels{f' ({why})' if why else ''}: 10 to 60 s"
    folder = kernel_cache.cache_folder()
    if kernel_cache.is_writable():
        log.info("%s, once; they are kept in %s", text, folder)
    else:
        log.warning(
            "%s, at every run, because %s cannot be written to; set NUMBA_CACHE_DIR to a folder "
            "that 'gs-codec warm' has filled",
            text, folder or "the cache folder",
        )  # fmt: skip

"""Large arrays, in memory or in temporary files, so that a process stays below a memory limit.

Code allocates arrays that grow with the scene with `empty`, and passes long-lived arrays to
`current().keep`; results do not depend on the storage. Within `bounded`, arrays are memory-mapped
temporary files without a name. A thread releases their pages before the process reaches the limit;
the system reads a page again from the file when it is used.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import tempfile
import threading
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from gs_codec.errors import InvalidInput, one_line
from gs_codec.runtime.wording import counted

#: Arrays below this size stay in memory, except those passed to `keep`.
_LARGE = 1 << 20

#: Kept arrays share files of this size.
_SEGMENT = 1 << 26

_ALIGNMENT = 64

#: Pages are released above this share of the limit.
_HIGH = 0.7

#: Seconds between checks.
_PERIOD = 0.004

#: glibc's option for the minimum size of mapped memory, which is returned to the system when freed.
_M_MMAP_THRESHOLD = -3

#: Value of that option in bytes: glibc's initial value, before it adapts.
_MAPPED = 1 << 17


def release_freed() -> None:
    """Return freed memory to the system, if the C library keeps it (glibc)."""
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def release_large_when_freed() -> None:
    """From now on, return the memory of large arrays to the system when they are freed (glibc)."""
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, _MAPPED)


class Memory:
    """Arrays in memory."""

    #: Memory limit of the process, bytes; None for no limit.
    limit: int | None = None

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """A new, uninitialised array."""
        return np.empty(shape, dtype)

    def keep(self, array: NDArray[Any]) -> NDArray[Any]:
        """Move an array to long-term storage."""
        return array

    def keep_bytes(self, data: bytes) -> bytes | memoryview:
        """Move bytes to long-term storage."""
        return data

    def watch(self, mapped: mmap.mmap) -> None:
        """Register a mapped file, shared or read-only, whose pages may be released."""

    def release(self) -> None:
        """Release all pages of mapped files; a page that is used again is read from its file."""


class Disk(Memory):
    """Arrays in temporary files; a file is deleted with its last array, or with the process.

    Parameters
    ----------
    limit : int, optional
        Memory limit in bytes, for code that chooses batch sizes. `bounded` enforces it.
    """

    def __init__(self, limit: int | None = None) -> None:
        self.limit = limit
        self.folder = folder_on_disk()
        self._lock = threading.Lock()
        self._maps: list[weakref.ref[mmap.mmap]] = []
        self._segment: mmap.mmap | None = None
        self._used = 0

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """See `Memory`."""
        size = np.dtype(dtype).itemsize * int(np.prod(shape, dtype=np.int64))
        if size < max(_LARGE, 1):
            return np.empty(shape, dtype)
        return np.frombuffer(self._file(size), dtype).reshape(shape)

    def keep(self, array: NDArray[Any]) -> NDArray[Any]:
        """See `Memory`."""
        if not array.size:
            return array
        mapped, offset = self._room(array.nbytes)
        kept = np.frombuffer(mapped, array.dtype, array.size, offset).reshape(array.shape)
        kept[:] = array
        return kept

    def keep_bytes(self, data: bytes) -> bytes | memoryview:
        """See `Memory`."""
        return self.keep(np.frombuffer(data, np.uint8)).data if data else data

    def watch(self, mapped: mmap.mmap) -> None:
        """See `Memory`."""
        with self._lock:
            self._maps = [known for known in self._maps if known() is not None]
            self._maps.append(weakref.ref(mapped))

    def release(self) -> None:
        """See `Memory`."""
        with self._lock:
            alive = [known() for known in self._maps]
        for mapped in alive:
            # A closed map has no pages.
            with suppress(ValueError):
                if mapped is not None and hasattr(mmap, "MADV_DONTNEED"):
                    mapped.madvise(mmap.MADV_DONTNEED)

    def _room(self, size: int) -> tuple[mmap.mmap, int]:
        """Map and offset of free space for an array, in a file shared with other arrays."""
        with self._lock:
            start = -(-self._used // _ALIGNMENT) * _ALIGNMENT
            if self._segment is not None and start + size <= len(self._segment):
                self._used = start + size
                return self._segment, start
        mapped = self._file(max(size, _SEGMENT))
        with self._lock:
            self._segment, self._used = mapped, size
        return mapped, 0

    def _file(self, size: int) -> mmap.mmap:
        """A memory-mapped file without a name, with its disk space allocated."""
        try:
            with tempfile.TemporaryFile(dir=self.folder) as file:
                # Without this, a full disk would kill the process when a page is written.
                if hasattr(os, "posix_fallocate"):
                    os.posix_fallocate(file.fileno(), 0, size)
                else:
                    file.truncate(size)
                mapped = mmap.mmap(file.fileno(), size)
        except OSError as error:
            raise InvalidInput(
                f"{self.folder}: {one_line(error)}: no temporary file of {counted(size, 'byte')}"
                " (set TMPDIR to use another folder)"
            ) from error
        self.watch(mapped)
        return mapped


def folder_on_disk() -> str:
    """``TMPDIR``, or a folder for large files: /tmp is in memory on many systems."""
    large = "/var/tmp" if os.access("/var/tmp", os.W_OK) else tempfile.gettempdir()
    return os.environ.get("TMPDIR") or large


def finite(name: str, numbers: Sequence[float], count: int) -> NDArray[np.float64]:
    """Convert to an array; raise `InvalidInput` unless there are `count` finite numbers."""
    with suppress(TypeError, ValueError):
        array = np.asarray(numbers, np.float64)
        if array.shape == (count,) and np.isfinite(array).all():
            return array
    raise InvalidInput(f"{name}: expected {count} finite numbers")


_CURRENT: ContextVar[Memory] = ContextVar("storage", default=Memory())  # noqa: B039


def current() -> Memory:
    """The `Memory` in use."""
    return _CURRENT.get()


def empty(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """A new, uninitialised array of the `Memory` in use."""
    return current().empty(shape, dtype)


@contextmanager
def using(storage: Memory) -> Iterator[None]:
    """Use another `Memory` within the block, and in threads that `run_all` starts there."""
    token = _CURRENT.set(storage)
    try:
        yield
    finally:
        _CURRENT.reset(token)


@contextmanager
def bounded(limit: int | None) -> Iterator[None]:
    """Keep the process below `limit` bytes within the block, by moving large arrays to disk.

    Only arrays allocated here can be moved; other memory is not reduced. None means no limit.
    """
    if limit is None:
        yield
        return
    disk, done = Disk(limit), threading.Event()
    guard = threading.Thread(target=_guard, args=(disk, limit, done), daemon=True)
    guard.start()
    try:
        with using(disk):
            yield
    finally:
        done.set()
        guard.join()


def _guard(disk: Disk, limit: int, done: threading.Event) -> None:
    while not done.wait(_PERIOD):
        if resident_bytes() > _HIGH * limit:
            disk.release()


def resident_bytes() -> int:
    """Resident memory of this process in bytes; 0 if the system does not report it."""
    with suppress(OSError), open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * mmap.PAGESIZE
    return 0

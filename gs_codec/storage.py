"""Where large arrays live: in memory, or in files that need none of it but what is in use.

Stages ask for the arrays that grow with the scene by `empty`, and hand what they keep to
`current().keep`; what they compute does not depend on where these are. Within `bounded`, arrays
are temporary files without a name, mapped into memory, and a thread gives their pages back to
the system, which has their content, before the process is larger than it may be.
"""

from __future__ import annotations

import mmap
import os
import tempfile
import threading
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from gs_codec.errors import InvalidInput, one_line

#: Smaller arrays are plain ones, but for those that are kept.
_LARGE = 1 << 20

#: Kept arrays share files of this size.
_SEGMENT = 1 << 26

_ALIGNMENT = 64

#: Share of the limit at which pages are given back, and how often it is looked, seconds.
_HIGH, _PERIOD = 0.7, 0.004


class Memory:
    """Plain arrays."""

    #: Most bytes the process may take, if there is a limit.
    limit: int | None = None

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """An array to be filled."""
        return np.empty(shape, dtype)

    def keep(self, array: NDArray[Any]) -> NDArray[Any]:
        """An array as it is to be kept for long."""
        return array

    def keep_bytes(self, data: bytes) -> bytes | memoryview:
        """Bytes as they are to be kept for long."""
        return data

    def watch(self, mapped: mmap.mmap) -> None:
        """Give back pages of a mapped file, too, that nobody writes to."""


class Disk(Memory):
    """Arrays in temporary files, each gone with the last array in it, or with the process.

    Parameters
    ----------
    limit : int, optional
        For those who plan what they do at once; `bounded` sees to it.
    """

    def __init__(self, limit: int | None = None) -> None:
        self.limit = limit
        self.folder = os.environ.get("TMPDIR") or _on_disk()
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
        """Give back all pages that are in memory; what is used again is mapped again."""
        with self._lock:
            alive = [known() for known in self._maps]
        for mapped in alive:
            # One that was closed has no pages.
            with suppress(ValueError):
                if mapped is not None and hasattr(mmap, "MADV_DONTNEED"):
                    mapped.madvise(mmap.MADV_DONTNEED)

    def _room(self, size: int) -> tuple[mmap.mmap, int]:
        """Room for an array in a file that it may share."""
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
        """A mapped file without a name, whose room on the disk is taken."""
        try:
            with tempfile.TemporaryFile(dir=self.folder) as file:
                # Without this, a full disk would show when a page is written: by a signal.
                if hasattr(os, "posix_fallocate"):
                    os.posix_fallocate(file.fileno(), 0, size)
                else:
                    file.truncate(size)
                mapped = mmap.mmap(file.fileno(), size)
        except OSError as error:
            raise InvalidInput(
                f"{self.folder}: {one_line(error)}: no temporary file of {size:,} bytes"
                " (TMPDIR names another folder)"
            ) from error
        self.watch(mapped)
        return mapped


def _on_disk() -> str:
    """A folder for large files: /tmp is in memory on many systems, /var/tmp is not."""
    return "/var/tmp" if os.access("/var/tmp", os.W_OK) else tempfile.gettempdir()


_CURRENT: ContextVar[Memory] = ContextVar("storage", default=Memory())  # noqa: B039


def current() -> Memory:
    """The storage in use."""
    return _CURRENT.get()


def empty(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """An array of the storage in use, to be filled."""
    return current().empty(shape, dtype)


@contextmanager
def using(storage: Memory) -> Iterator[None]:
    """Use a storage in the block, and in what `run_all` runs for it."""
    token = _CURRENT.set(storage)
    try:
        yield
    finally:
        _CURRENT.reset(token)


@contextmanager
def bounded(limit: int | None) -> Iterator[None]:
    """Keep the process below `limit` bytes in the block, as far as its arrays are what it holds.

    Without a limit nothing is different.
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
    """Bytes of this process that are in memory; 0 where the system does not tell."""
    with suppress(OSError), open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * mmap.PAGESIZE
    return 0

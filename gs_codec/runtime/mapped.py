"""Read parts of files, and put file names into errors."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from copy import copy
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import GsCodecError, InvalidInput
from gs_codec.runtime.wording import counted

#: Maximum bytes to read at once: macOS refuses 2 GiB, and Windows reads into a copy.
_MOST = 1 << 24

#: Held while the position of an open file is moved.
_MOVING = threading.Lock()


class FileBytes:
    """The bytes of an open file; each part is read on access into new memory.

    Input files are not memory-mapped: if another program truncates a mapped file, the next access
    ends the process.

    Parameters
    ----------
    path : str or Path
        Name in errors.
    number : int
        Descriptor of the open file.
    """

    def __init__(self, path: str | Path, number: int) -> None:
        self._path, self._number = path, number
        self._stamp = self._look()
        self._first, self._size = 0, self._stamp[0]

    def _look(self) -> tuple[int, int]:
        status = os.fstat(self._number)
        return status.st_size, status.st_mtime_ns

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, part: slice) -> memoryview:
        start, stop, _ = part.indices(len(self))
        data = np.empty(max(stop - start, 0), np.uint8)
        self.read_into(data, start)
        return data.data.toreadonly()

    def window(self, start: int, size: int) -> FileBytes:
        """A view of the same file, limited to `size` bytes from `start`."""
        window = copy(self)
        window._first, window._size = self._first + start, size
        return window

    def __bytes__(self) -> bytes:
        return bytes(self[:])

    def read_into(self, data: NDArray[np.uint8], start: int) -> None:
        """Fill `data` with the bytes from `start` on; `InvalidInput` if they are missing."""
        done, view = 0, data.data
        while done < len(view):
            try:
                some = view[done : done + _MOST]
                read = _read_at(self._number, some, self._first + start + done)
            except OSError as error:
                raise self._error(str(error.strerror)) from error
            if not read:
                size, expected = counted(self._look()[0], "byte"), self._stamp[0]
                raise self._error(f"truncated while it was read: {size}, expected {expected:,}")
            done += read

    def check_unchanged(self) -> None:
        """Raise `InvalidInput` if the file was modified since it was opened."""
        if self._look() != self._stamp:
            raise self._error("was changed while it was read")

    def _error(self, text: str) -> InvalidInput:
        error = InvalidInput(f"{self._path}: {text}")
        error.of_another_file = True  # already names its file
        return error


def _read_at(number: int, view: memoryview, start: int) -> int:
    """Fill a view from a position of an open file; the number of bytes, fewer at its end."""
    if hasattr(os, "preadv"):
        return os.preadv(number, [view], start)
    with _MOVING:  # Windows
        os.lseek(number, start, os.SEEK_SET)
        data = os.read(number, len(view))
    view[: len(data)] = data
    return len(data)


def total_bytes(paths: Iterable[Path]) -> int:
    """Total size of those of the files that exist."""
    return sum(path.stat().st_size for path in paths if path.is_file())


@contextmanager
def opened(path: str | Path) -> Iterator[FileBytes]:
    """Open a file and yield its bytes.

    Raises InvalidInput if it is missing, empty, a directory, a pipe, or not readable.
    """
    try:
        file = open(path, "rb", buffering=0)  # noqa: SIM115 (closed below)
    except IsADirectoryError:
        raise InvalidInput(f"{path}: a directory, expected a file") from None
    except OSError as error:
        raise InvalidInput(f"{path}: {error.strerror}") from error
    with file:
        data = FileBytes(path, file.fileno())
        if not len(data):
            kind = "empty file" if os.path.isfile(path) else "a pipe or device, expected a file"
            raise InvalidInput(f"{path}: {kind}")
        yield data


@contextmanager
def other_files() -> Iterator[None]:
    """Mark errors in the block as about other files, which they already name; see `located`."""
    try:
        yield
    except GsCodecError as error:
        error.of_another_file = True
        raise


@contextmanager
def located(path: str | Path) -> Iterator[None]:
    """Prefix errors in the block with the file's name, except errors about other files."""
    try:
        yield
    except GsCodecError as error:
        if error.of_another_file:
            raise
        raise type(error)(f"{path}: {error}") from error

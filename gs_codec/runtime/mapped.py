"""Map files into memory, and put their names into errors."""

from __future__ import annotations

import mmap
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from gs_codec.errors import GsCodecError, InvalidInput
from gs_codec.runtime.arrays import current


@contextmanager
def opened(path: str | Path) -> Iterator[memoryview]:
    """The bytes of a file, memory-mapped.

    Raises
    ------
    InvalidInput
        If it is missing, empty, a directory, or not readable.
    """
    try:
        with open(path, "rb") as file:
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except ValueError:
        raise InvalidInput(f"{path}: empty file") from None
    except IsADirectoryError:
        raise InvalidInput(f"{path}: a directory, expected a file") from None
    except OSError as error:
        raise InvalidInput(f"{path}: {error.strerror}") from error
    current().watch(mapped)
    view = memoryview(mapped)
    try:
        yield view
    finally:
        # An exception being raised may still hold parts of the view; they are freed with it.
        with suppress(BufferError):
            view.release()
            mapped.close()


@contextmanager
def other_files() -> Iterator[None]:
    """Mark errors about other files, which already name them, so that `located` skips them."""
    try:
        yield
    except GsCodecError as error:
        error.of_another_file = True
        raise


@contextmanager
def located(path: str | Path) -> Iterator[None]:
    """Put the name of the file before errors within the block, except errors about other files."""
    try:
        yield
    except GsCodecError as error:
        if error.of_another_file:
            raise
        raise type(error)(f"{path}: {error}") from error

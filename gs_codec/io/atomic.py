"""Outputs that appear whole or not at all."""

from __future__ import annotations

import os
import re
import secrets
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from gs_codec.errors import InvalidInput


def check_writable(path: str | Path) -> None:
    """Refuse a path that no file can be written to.

    Raises
    ------
    InvalidInput
        If it is a directory or device, or its directory is missing or not writable.
    """
    target = Path(path)
    if os.path.isdir(target):
        raise InvalidInput(f"{target}: a directory, expected a file name")
    if os.path.exists(target) and not target.is_file():
        raise InvalidInput(f"{target}: not a regular file")
    if not target.parent.is_dir():
        raise InvalidInput(f"{target}: no directory '{target.parent}'")
    if not os.access(target.parent, os.W_OK):
        raise InvalidInput(f"{target}: no permission to write in '{target.parent}'")


def temporary_name(name: str) -> str:
    """What a file is called, beside its place, until it is whole."""
    return f".{name[:100]}.{secrets.token_hex(4)}"


def leftovers(entries: Iterable[str], names: Iterable[str]) -> list[str]:
    """Those entries of a folder that are temporary names of these files."""
    begun = {name[:100] for name in names}
    found = [(entry, re.fullmatch(r"\.(.*)\.[0-9a-f]{8}", entry, re.DOTALL)) for entry in entries]
    return [entry for entry, match in found if match and match[1] in begun]


@contextmanager
def atomic_writer(path: str | Path) -> Iterator[BinaryIO]:
    """Open a temporary file beside `path` that replaces it, fsynced, if the block succeeds.

    Raises
    ------
    InvalidInput
        If the file cannot be written; nothing is left behind then.
    """
    check_writable(path)
    target = Path(path)
    temporary = target.with_name(temporary_name(target.name))
    try:
        with open(temporary, "xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, target)
    except BaseException as error:
        with suppress(OSError):
            os.unlink(temporary)
        if isinstance(error, OSError):
            raise InvalidInput(f"{target}: {error.strerror or error}") from error
        raise

"""Limits on the decoded size of a file; conversion of library exceptions to one error."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from gs_codec.errors import InvalidInput, one_line
from gs_codec.runtime.wording import counted
from gs_codec.scene import float_bytes

#: Maximum decoded bytes of a file, or `EXPANSION` times its size if that is more.
DECODED_BYTES = 1 << 30
EXPANSION = 1000

#: Exceptions of libraries that cannot read data.
FAILURES: tuple[type[Exception], ...] = (
    ArithmeticError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,  # nested too deeply, or not implemented
    SyntaxError,  # Pillow's, for damaged images
    TypeError,
    ValueError,  # includes text that is not UTF-8
    struct.error,
    zlib.error,
)


def most_bytes(file_bytes: int, max_bytes: int | None) -> int:
    """Maximum bytes of floats and extra properties that a file of this size may decode to."""
    return max(DECODED_BYTES, EXPANSION * file_bytes) if max_bytes is None else max_bytes


def check_count(count: int, sh_degree: int, file_bytes: int, max_bytes: int | None = None) -> None:
    """Reject more Gaussians than a file of this size may contain, before allocating memory."""
    check_bytes(float_bytes(count, sh_degree), count, file_bytes, max_bytes)


def check_bytes(wanted: int, count: int, file_bytes: int, max_bytes: int | None) -> None:
    """Reject Gaussians whose data exceeds the maximum for a file of this size."""
    limit = most_bytes(file_bytes, max_bytes)
    if wanted > limit:
        raise InvalidInput(
            f"{counted(count, 'Gaussian')} of {counted(wanted, 'byte')}; at most "
            f"{limit:,} are read from a file of {file_bytes:,} (max-bytes)"
        )


def is_file_name(name: Any) -> bool:
    """Whether a value from a file is the name of a file in the same folder.

    Paths to other folders, and alternate streams of a file on Windows, are not.
    """
    plain = isinstance(name, str) and name.isprintable() and not set(name) & set("/\\:")
    return plain and name.strip(".") != "" and len(name) <= 255


@contextmanager
def refusing(what: str, *more: type[Exception]) -> Iterator[None]:
    """Convert the exceptions of libraries that cannot read data, and `more`, to one error."""
    failures: tuple[type[Exception], ...] = (*FAILURES, *more)
    try:
        yield
    except failures as error:
        reason = one_line(error)[:200] or type(error).__name__
        raise InvalidInput(f"{what}: {reason!a}") from error

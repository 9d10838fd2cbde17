"""What a file may unfold to, and the one error of all that can go wrong inside a library."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager

from gs_codec.errors import InvalidInput, one_line
from gs_codec.scene import SH_COEFFICIENTS

#: A scene may be as large as this, and as this many times its file.
_SCENE_BYTES, _EXPANSION = 1 << 30, 1000

#: What libraries raise at data that they cannot read.
FAILURES: tuple[type[Exception], ...] = (
    ArithmeticError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,  # nested too deep, or not implemented
    SyntaxError,  # Pillow's for broken images
    TypeError,
    ValueError,  # text that is no UTF-8, too
    struct.error,
    zlib.error,
)


def check_count(count: int, sh_degree: int, file_bytes: int) -> None:
    """Refuse more Gaussians than a file of this size can honestly say, before memory is taken.

    Raises
    ------
    InvalidInput
    """
    wanted = 4 * count * (14 + 3 * SH_COEFFICIENTS[sh_degree])
    limit = max(_SCENE_BYTES, _EXPANSION * file_bytes)
    if wanted > limit:
        raise InvalidInput(
            f"{count} Gaussians, which take {wanted} bytes; at most {limit} are read from a file "
            f"of {file_bytes}"
        )


@contextmanager
def refusing(what: str, *more: type[Exception]) -> Iterator[None]:
    """Turn what libraries raise at data that they cannot read, and `more`, into one error.

    Raises
    ------
    InvalidInput
    """
    failures: tuple[type[Exception], ...] = (*FAILURES, *more)
    try:
        yield
    except failures as error:
        reason = one_line(error)[:200] or type(error).__name__
        raise InvalidInput(f"{what}: {reason!a}") from error

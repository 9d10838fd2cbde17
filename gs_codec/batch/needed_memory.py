"""Estimated memory for encoding a scene."""

from __future__ import annotations

from gs_codec.format_table import format_of_file

#: Bytes for Python, its packages, and compiled kernels.
_FIXED = 400 << 20

#: Peak bytes per byte of raw floats: 2.6 measured (bench/LAB_NOTEBOOK.md).
_ENCODING = 4

#: The same when rendering views: 7.5 measured. Bytes per pixel of the views: 30 measured, 60 with a
#: maximum loss.
_DRAWING = 10
_PIXEL = 60

#: Bytes per pixel of images as a function of SH (90 measured), and their maximum.
_FUNCTION = 100
_LARGEST_FUNCTION = 1 << 30

#: Assumed ratio of a file's floats to those that its size suggests, if its header was not read.
_MARGIN = 4

#: Minimum memory for floats, bytes.
_LEAST = 64 << 20


def needed_bytes(floats: int, pixels: int = 0) -> int:
    """Estimated peak memory for encoding `floats` bytes and rendering `pixels` of a scene."""
    if not pixels:
        return _FIXED + _ENCODING * floats
    function = min(_FUNCTION * pixels, _LARGEST_FUNCTION)
    return _FIXED + _DRAWING * floats + _PIXEL * pixels + function


def expected_floats(size: int, name: str) -> int:
    """Estimated bytes of raw floats in a file of `size` bytes; a size below 0 counts as 0."""
    known = format_of_file(name)
    return max(size, 0) * (1 if known is None else known.floats_per_byte)


def most_floats(size: int, name: str) -> int:
    """Maximum bytes of floats to accept from a file, if only its size is known."""
    return max(_MARGIN * expected_floats(size, name), _LEAST)

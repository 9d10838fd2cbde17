"""The ``tool`` section: what the program that coded the points said it was."""

from __future__ import annotations

from gs_codec.errors import CorruptStream

#: Most characters of a version line.
MAX_LENGTH = 200


def write_tool(version: str) -> bytes:
    """Serialise a version line of 1-200 printable ASCII characters."""
    return version.encode("ascii")


def read_tool(data: memoryview) -> str:
    """The inverse of `write_tool`.

    Raises
    ------
    CorruptStream
        If it is not such a line.
    """
    text = bytes(data[: MAX_LENGTH + 1])
    if not 1 <= len(text) <= MAX_LENGTH or any(not 32 <= byte < 127 for byte in text):
        raise CorruptStream(
            f"section 'tool': {len(data)} bytes, expected 1-{MAX_LENGTH} of printable ASCII"
        )
    return text.decode("ascii")

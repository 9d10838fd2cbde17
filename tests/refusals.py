"""Rejected files: the error is one line that begins with the file name."""

from __future__ import annotations

from pathlib import Path

import pytest

from gs_codec.errors import InvalidInput
from gs_codec.files.scenes import read_scene


def assert_one_line(error: BaseException, path: Path | str) -> None:
    """The message is one line that begins with the file name and is short."""
    assert str(error).startswith(f"{path}: ")
    assert len(str(error).splitlines()) == 1
    assert len(str(error)) - len(str(path)) < 400


def assert_refused(path: Path, message: str) -> None:
    """Reading a scene fails with one line that `message` matches."""
    with pytest.raises(InvalidInput, match=message) as caught:
        read_scene(path)
    assert_one_line(caught.value, path)

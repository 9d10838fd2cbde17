"""What a codec is to the bench, and what several of them need."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gs_codec.config import Extra
from gs_codec.formats.ply.file import read_ply
from gs_codec.scene import Scene


@dataclass(frozen=True)
class Peer:
    """A codec, ours or another, and how it is called.

    Attributes
    ----------
    name : str
    version : str
        Of the program, and of its file format or level where that has one.
    encode : callable
        From the path of a PLY to the bytes of the file. One that fails, or does not finish in
        its time, raises `ToolFailed`; so do the others.
    decode : callable
        From these bytes to floats, as the codec lays them out.
    scene : callable
        From what `decode` returned to a `Scene`, which is not timed.
    once : bool
        Whether it is too slow to be timed more than once.
    own_process : bool
        Whether it is a program that is started each time, which is timed with it.
    """

    name: str
    version: str
    encode: Callable[[Path], bytes]
    decode: Callable[[bytes], Any]
    scene: Callable[[Any], Scene]
    once: bool = False
    own_process: bool = False


@dataclass(frozen=True)
class AbsentPeer:
    """A codec that cannot be called: its name, why, and what would help."""

    name: str
    absent: str


def scene_of_ply(data: bytes, extra: Extra) -> Scene:
    """The scene that the bytes of a PLY file hold."""
    with tempfile.TemporaryDirectory(prefix="gs_codec-") as folder:
        path = Path(folder, "decoded.ply")
        path.write_bytes(data)
        return read_ply(path, extra)

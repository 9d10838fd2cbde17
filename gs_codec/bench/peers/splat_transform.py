"""PlayCanvas' splat-transform: compressed PLY, SPZ and SOG, by its own program on Node.

What is timed is the program from its start to its end, from file to file: a third of a second is
Node's own. What it decodes to is a PLY, whose reading is not timed.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from gs_codec.bench.peers.peer import AbsentPeer, Peer, scene_of_ply
from gs_codec.errors import InvalidInput, MissingTool, ToolFailed, one_line
from gs_codec.runtime.programs import Limits, first_line, run_on_files
from gs_codec.scene import Scene

#: The environment variable that names the program.
VARIABLE = "GS_CODEC_SPLAT_TRANSFORM"

_NAME = "splat-transform"

#: Where `make peers` puts it.
_FOLDER = "peers/node_modules/.bin"

_HOW = f"'make peers', or npm install -g @playcanvas/splat-transform@3; found by {VARIABLE} or PATH"

#: Its formats, by the ends of their names. SOG clusters SH, which takes minutes on a CPU.
_SUFFIXES = {"compressed.ply": ".compressed.ply", "spz": ".spz", "SOG": ".sog"}
_SLOW = "SOG"

#: How long it may take, by the clock.
SECONDS = 120.0

_MOST_BYTES = 1 << 36


def find_program() -> tuple[str, str]:
    """Path and version of what the environment variable names, PATH or this environment has.

    Raises
    ------
    MissingTool
        If there is no such program, or it is another one.
    """
    given = os.environ.get(VARIABLE)
    found = shutil.which(given or _NAME)
    if found is None and not given:
        found = shutil.which(_NAME, path=os.path.join(sys.prefix, _FOLDER))
    if found is None:
        which = f"{_NAME}: not installed" if not given else f"{given}: no such program"
        raise MissingTool(f"{which} ({_HOW})")
    found = os.path.abspath(found)
    try:
        line = first_line([found, "--version"], _limits())
    except (OSError, ToolFailed) as error:
        raise MissingTool(f"{found}: cannot be run, {one_line(error)} ({_HOW})") from error
    if not line.startswith(_NAME):
        raise MissingTool(f"{found}: not {_NAME}, it says '{line[:80]}' ({_HOW})")
    return found, line.removeprefix(_NAME).strip()


def splat_transform_peers(threads: int | None = None) -> list[Peer | AbsentPeer]:
    """Each format that the program writes, or why there is none."""
    try:
        path, version = find_program()
    except MissingTool as error:
        return [AbsentPeer(_NAME, str(error))]
    command = [path, "--quiet", "--gpu", "cpu"]
    if threads is not None:
        command += ["--max-workers", str(threads)]
    return [_peer(command, version, label, f"coded{end}") for label, end in _SUFFIXES.items()]


def _peer(command: list[str], version: str, label: str, coded: str) -> Peer:
    def convert(source: str, inputs: Mapping[str, bytes], target: str) -> bytes:
        return run_on_files([*command, source, target], inputs, target, _limits(), _MOST_BYTES)

    def encode(ply: Path) -> bytes:
        return convert(str(ply.absolute()), {}, coded)

    def decode(data: bytes) -> bytes:
        return convert(coded, {coded: data}, "decoded.ply")

    name, slow = f"{_NAME}, {label}", label == _SLOW
    return Peer(name, version, encode, decode, _read, once=slow, own_process=True)


def _limits() -> Limits:
    return Limits(SECONDS, 3600, None)


def _read(ply: bytes) -> Scene:
    """The scene of a PLY; infinite logits, as alphas of 0 and 255 decode to, are cut."""
    try:
        scene = scene_of_ply(ply, "error")
    except InvalidInput as error:
        raise ToolFailed(f"wrote a PLY that cannot be read: {error}") from error
    return replace(scene, opacity=np.clip(scene.opacity, -30, 30))

"""PlayCanvas' splat-transform: compressed PLY, SPZ and SOG, by its own program on Node.

What is timed is the program from its start to its end, from file to file: a third of a second is
Node's own. What it decodes to is a PLY, whose reading is not timed.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
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

_HOW = f"'make peers', or npm install -g @playcanvas/splat-transform@2; found by {VARIABLE} or PATH"

#: Its formats, by the ends of their names. SOG clusters SH, which takes minutes on a CPU.
_SUFFIXES = {"compressed.ply": ".compressed.ply", "spz": ".spz", "SOG": ".sog"}
_SLOW = "SOG"

#: How long it may take, by the clock.
SECONDS = 120.0

_MOST_BYTES = 1 << 36


@dataclass(frozen=True)
class SplatTransform:
    """A program that was found, and its version line.

    Parameters
    ----------
    path : str
    version : str
    threads : int or None
        Of its workers; as many as it likes if None.
    limits : Limits
    """

    path: str
    version: str
    threads: int | None = None
    limits: Limits = field(default_factory=lambda: Limits(SECONDS, 3600, None))

    @classmethod
    def find(cls, threads: int | None = None) -> SplatTransform:
        """The program that the environment variable names, of PATH, or of this environment.

        Raises
        ------
        MissingTool
            If there is none, or it is another program.
        """
        given = os.environ.get(VARIABLE)
        found = shutil.which(given or _NAME)
        if found is None and not given:
            found = shutil.which(_NAME, path=os.path.join(sys.prefix, _FOLDER))
        if found is None:
            which = f"{_NAME}: not installed" if not given else f"{given}: no such program"
            raise MissingTool(f"{which} ({_HOW})")
        found = os.path.abspath(found)
        program = cls(found, "", threads)
        try:
            line = first_line([found, "--version"], program.limits)
        except (OSError, ToolFailed) as error:
            raise MissingTool(f"{found}: cannot be run, {one_line(error)} ({_HOW})") from error
        if not line.startswith(_NAME):
            raise MissingTool(f"{found}: not {_NAME}, it says '{line[:80]}' ({_HOW})")
        return replace(program, version=line.removeprefix(_NAME).strip())

    def convert(self, source: str, inputs: Mapping[str, bytes], target: str) -> bytes:
        """The bytes of the file that it makes of another, which is one of `inputs` or a path.

        Raises
        ------
        ToolFailed
            If it fails, or does not end in its time.
        """
        command = [self.path, "--quiet", "--gpu", "cpu"]
        if self.threads is not None:
            command += ["--max-workers", str(self.threads)]
        return run_on_files([*command, source, target], inputs, target, self.limits, _MOST_BYTES)


def splat_transform_peers(threads: int | None = None) -> list[Peer | AbsentPeer]:
    """Each format that the program writes, or why there is none."""
    try:
        program = SplatTransform.find(threads)
    except MissingTool as error:
        return [AbsentPeer(_NAME, str(error))]
    return [_peer(program, label, suffix) for label, suffix in _SUFFIXES.items()]


def _peer(program: SplatTransform, label: str, suffix: str) -> Peer:
    def encode(ply: Path) -> bytes:
        return program.convert(str(ply.absolute()), {}, f"coded{suffix}")

    def decode(data: bytes) -> bytes:
        return program.convert(f"coded{suffix}", {f"coded{suffix}": data}, "decoded.ply")

    slow = label == _SLOW
    name = f"{_NAME}, {label}"
    return Peer(name, program.version, encode, decode, _read, once=slow, own_process=True)


def _read(ply: bytes) -> Scene:
    """The scene of a PLY; infinite logits, as alphas of 0 and 255 decode to, are cut."""
    try:
        scene = scene_of_ply(ply, "error")
    except InvalidInput as error:
        raise ToolFailed(f"wrote a PLY that cannot be read: {error}") from error
    return replace(scene, opacity=np.clip(scene.opacity, -30, 30))

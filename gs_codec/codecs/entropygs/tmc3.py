"""Run MPEG's G-PCC reference software, `tmc3`, as an untrusted program.

It aborts, crashes or hangs on some inputs; every failure becomes a `ToolFailed`.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from gs_codec.errors import MissingTool, ToolFailed
from gs_codec.runtime.programs import Limits, first_line, run_on_files

#: Environment variable with the path of the program.
VARIABLE = "GS_CODEC_TMC3"

_MISSING = (
    "tmc3 is MPEG's reference software for G-PCC, https://github.com/MPEGGroup/mpeg-pcc-tmc13, "
    f"found by tmc3, {VARIABLE} or PATH; geometry 'octree' needs no program"
)


@dataclass(frozen=True)
class Tmc3:
    """A program that was found; ``version`` is 1-200 printable ASCII characters from its help."""

    path: str
    version: str
    limits: Limits = field(default_factory=Limits)

    @classmethod
    def find(cls, path: str | Path | None = None) -> Tmc3:
        """Find the program at `path`, or through the environment variable or PATH.

        Raises
        ------
        MissingTool
            If there is none, or it is a different program.
        """
        given = str(path) if path is not None else os.environ.get(VARIABLE)
        found = shutil.which(given or "tmc3")
        if found is None:
            which = f"{given}: no such program" if given else "tmc3: not found"
            raise MissingTool(f"{which}; {_MISSING}")
        found = os.path.abspath(found)
        try:
            line = first_line([found, "--help"], Limits())
        except (OSError, ToolFailed) as error:
            raise MissingTool(f"{found}: cannot be run ({error}); {_MISSING}") from error
        if "tmc3" not in line.lower():
            raise MissingTool(f"{found}: not tmc3, its help begins '{line[:80]}'; {_MISSING}")
        return cls(found, line[:200])

    def run(
        self,
        arguments: Sequence[str],
        inputs: Mapping[str, bytes | memoryview],
        output: str,
        most: int,
    ) -> bytes:
        """Run the program in a folder with the files `inputs`; return the bytes of file `output`.

        Raises
        ------
        ToolFailed
            If it fails, exceeds its limits, or writes more than `most` bytes.
        """
        return run_on_files([self.path, *arguments], inputs, output, self.limits, most)

"""How long commands take of a scene so small that to start is most of what they do."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gs_codec.bench.apart import run_apart
from gs_codec.bench.measure import spread
from gs_codec.io.ply import write_ply
from gs_codec.scene import Scene

#: Gaussians of the scene.
_COUNT = 1000


def measure_start(scene: Scene, name: str, repeats: int = 5) -> Iterator[dict[str, Any]]:
    """A line for each command: seconds from its start to its end, and of processors.

    Each runs once before it counts: the first run compiles kernels.

    Parameters
    ----------
    scene : Scene
        The first 1000 of its Gaussians are the scene.
    name : str
        What it is called in the lines.
    repeats : int
        Timed runs of each command, 1 and up.
    """
    small = replace(scene.take(np.arange(min(scene.count, _COUNT))), comments=(), extra={})
    with tempfile.TemporaryDirectory() as folder:
        ply, egs, out = (str(Path(folder) / file) for file in ("in.ply", "in.egs", "out"))
        write_ply(ply, small)
        for arguments in (
            ["--help"],
            ["encode", ply, egs, "--overwrite"],
            ["decode", egs, f"{out}.ply", "--overwrite"],
            ["verify", egs],
            ["inspect", egs],
            ["convert", ply, f"{out}.splat", "--overwrite"],
            ["compare", ply, egs],
        ):
            wall, cpu = zip(*(_run(arguments) for _ in range(repeats + 1)), strict=True)
            yield {
                "kind": "start",
                "scene": name,
                "command": arguments[0],
                "gaussians": small.count,
                "seconds": spread(list(wall[1:])),
                "cpu_seconds": spread(list(cpu[1:])),
            }


def _run(arguments: list[str]) -> tuple[float, float]:
    """Seconds of a process, by the clock and of processors."""
    start = time.perf_counter()
    used = run_apart(arguments)
    return time.perf_counter() - start, used.cpu_seconds

"""How time and memory grow with the scene: each measurement is a process of its own."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from gs_codec.bench.apart import run_apart
from gs_codec.bench.sources import tile_scene
from gs_codec.formats.ply import write_ply
from gs_codec.scene import Scene


def measure_scaling(
    scene: Scene, name: str, sizes: Sequence[int], profiles: Sequence[str], threads: int | None
) -> Iterator[dict[str, Any]]:
    """A line for each profile and size, to which the scene is tiled."""
    options = [] if threads is None else ["--threads", str(threads)]
    with tempfile.TemporaryDirectory() as folder:
        ply, stream, back = (Path(folder, file) for file in ("a.ply", "a.egs", "b.ply"))
        for number, size in enumerate(sizes):
            tiled = tile_scene(scene, size)
            write_ply(ply, tiled)
            for profile in profiles:
                encode = ["encode", str(ply), str(stream), "-p", profile, *options, "--overwrite"]
                decode = ["decode", str(stream), str(back), *options, "--overwrite"]
                if not number:  # compiles, and is not counted
                    run_apart(encode)
                    run_apart(decode)
                line = {"kind": "scaling", "scene": name, "profile": profile, "gaussians": size}
                line |= {"encode": asdict(run_apart(encode)), "decode": asdict(run_apart(decode))}
                file_bytes = stream.stat().st_size
                yield line | {"float_bytes": tiled.float_bytes, "file_bytes": file_bytes}

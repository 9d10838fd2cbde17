"""Measurements in separate processes: peak memory, and scaling with the size of a scene.

A small process starts the measured one and reads its usage, because the peak of a process includes
that of the parent it was forked from.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from gs_codec.bench.measured_scenes import tile_scene
from gs_codec.errors import GsCodecError
from gs_codec.formats.ply.writer import write_ply
from gs_codec.runtime.programs import end_group
from gs_codec.scene import Scene

_RUN_AND_TELL = """
import json, resource, subprocess, sys, time
start = time.perf_counter()
status = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode
seconds = time.perf_counter() - start
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([seconds, used.ru_utime + used.ru_stime, 1024 * used.ru_maxrss]))
sys.exit(status != 0)
"""


@dataclass(frozen=True)
class Usage:
    """Usage of a process, including its start: wall and processor seconds.

    `peak_bytes` is its peak resident size (Linux), including mapped files.
    """

    seconds: float
    cpu_seconds: float
    peak_bytes: int


def run_in_process(arguments: list[str]) -> Usage:
    """Run ``gs-codec ARGUMENTS``.

    Raises GsCodecError if it fails, with the command's own message.
    """
    between = [sys.executable, "-I", "-S", "-c", _RUN_AND_TELL]
    command = [*between, sys.executable, "-m", "gs_codec", *arguments]
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command, stdout=pipe, stderr=pipe, text=True, start_new_session=True
    ) as process:
        try:
            out, err = process.communicate()
        finally:
            end_group(process)
    if process.returncode:
        lines = err.strip().splitlines() or [f"status {process.returncode}"]
        raise GsCodecError(lines[-1].removeprefix("gs-codec: error: "))
    return Usage(*json.loads(out))


def measure_scaling(
    scene: Scene, name: str, sizes: Sequence[int], profiles: Sequence[str], threads: int | None
) -> Iterator[dict[str, Any]]:
    """A line for each profile and each size that the scene is tiled to."""
    options = [] if threads is None else ["--threads", str(threads)]
    with tempfile.TemporaryDirectory() as folder:
        ply, stream, back = (Path(folder, file) for file in ("a.ply", "a.egs", "b.ply"))
        for number, size in enumerate(sizes):
            tiled = tile_scene(scene, size)
            write_ply(ply, tiled)
            for profile in profiles:
                encode = ["encode", str(ply), str(stream), "-p", profile, *options, "--overwrite"]
                decode = ["decode", str(stream), str(back), *options, "--overwrite"]
                if not number:  # the first compiles and does not count
                    run_in_process(encode)
                    run_in_process(decode)
                line = {"kind": "scaling", "scene": name, "profile": profile, "gaussians": size}
                line |= {
                    "encode": asdict(run_in_process(encode)),
                    "decode": asdict(run_in_process(decode)),
                }
                file_bytes = stream.stat().st_size
                yield line | {"float_bytes": tiled.float_bytes, "output_bytes": file_bytes}

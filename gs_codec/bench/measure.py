"""Time, entropy, error and memory of encoding and decoding one scene."""

from __future__ import annotations

import os
import platform
import statistics
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from gs_codec import __version__
from gs_codec.analysis.tables import entropy_by_group
from gs_codec.bench import host
from gs_codec.bench.apart import run_apart
from gs_codec.codec import decode_scene, encode_scene
from gs_codec.config import Config
from gs_codec.files import compare_files, decode_file, encode_file
from gs_codec.io.ply import read_ply, vertex_rows, write_ply
from gs_codec.scene import Scene
from gs_codec.workers import available_threads


def machine() -> dict[str, Any]:
    """What the numbers were measured on and with."""
    import numba
    import numpy

    return {
        "kind": "machine",
        "gs_codec": __version__,
        "python": platform.python_version(),
        "numpy": numpy.__version__,
        "numba": numba.__version__,
        "processor": host.processor_name(),
        "cores": os.cpu_count(),
        "threads": available_threads(),
        "memory_bytes": host.memory_bytes(),
        "system": platform.platform(),
        "commit": host.commit(),
        "packages": host.package_versions(),
    }


def measure_scene(
    scene: Scene, name: str, config: Config, repeats: int
) -> Iterator[dict[str, Any]]:
    """Result lines of one scene under one configuration.

    The scene is written as PLY to a temporary folder first; encoding is timed from that
    (cached) file to the stream in memory, decoding from the stream to the rows of a PLY.
    """
    with tempfile.TemporaryDirectory() as folder:
        ply = Path(folder) / "scene.ply"
        write_ply(ply, scene)
        identity = {"scene": name, "profile": config.profile, "gaussians": scene.count}
        yield {"kind": "codec", **identity, **_codec(ply, config, repeats)}
        yield {"kind": "error", **identity, **_error(ply, config)}
        yield {"kind": "memory", **identity, **_memory(ply, config, scene.float_bytes)}


def _codec(ply: Path, config: Config, repeats: int) -> dict[str, Any]:
    encode_seconds, decode_seconds, stages = [], [], []
    for _ in range(repeats + 1):  # the first run compiles and fills caches
        start = time.perf_counter()
        scene = read_ply(ply, config.extra)
        read = time.perf_counter()
        data, report = encode_scene(scene, config)
        encoded = time.perf_counter()
        decoded = decode_scene(data, config.threads)
        arranged = time.perf_counter()
        vertex_rows(decoded)
        end = time.perf_counter()
        encode_seconds.append(encoded - start)
        decode_seconds.append(end - encoded)
        decoding = {"decode": arranged - encoded, "rows": end - arranged}
        stages.append({"read": read - start, **report.seconds, **decoding})
    return {
        "ply_bytes": ply.stat().st_size,
        "file_bytes": len(data),
        "ratio": ply.stat().st_size / len(data),
        "bits_per_gaussian": 8 * len(data) / max(scene.count, 1),
        "encode_seconds": spread(encode_seconds[1:]),
        "decode_seconds": spread(decode_seconds[1:]),
        "stages": {name: spread([s[name] for s in stages[1:]])["median"] for name in stages[0]},
        "section_bytes": report.section_bytes,
        "rectified": report.rectified,
        "entropy": entropy_by_group(report),
    }


def spread(values: list[float]) -> dict[str, float]:
    """Median, least and largest value."""
    return {"median": statistics.median(values), "min": min(values), "max": max(values)}


def _error(ply: Path, config: Config) -> dict[str, Any]:
    stream, back = ply.with_suffix(".egs"), ply.with_name("back.ply")
    encode_file(ply, stream, config)
    decode_file(stream, back, config.threads)
    return asdict(compare_files(ply, back))


def _memory(ply: Path, config: Config, float_bytes: int) -> dict[str, Any]:
    """Peak resident memory of whole processes; 0 where the system does not tell."""
    stream, back = ply.with_suffix(".egs"), ply.with_name("back.ply")
    depths = [arg for g, bits in config.depths.items() for arg in ("--depth", f"{g}={bits}")]
    command = ["encode", str(ply), str(stream), "-p", config.profile, *depths, "--overwrite"]
    encode = run_apart(command).peak_bytes
    decode = run_apart(["decode", str(stream), str(back), "--overwrite"]).peak_bytes
    return {
        "encode_peak_bytes": encode,
        "decode_peak_bytes": decode,
        "float_bytes": float_bytes,
        "encode_ratio": encode / max(float_bytes, 1),
        "decode_ratio": decode / max(float_bytes, 1),
    }

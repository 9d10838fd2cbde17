"""Time, entropy, error and memory of encoding and decoding one scene."""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from gs_codec.analysis.entropy import entropy_by_group
from gs_codec.bench.apart import run_apart
from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.config import Config
from gs_codec.files.scenes import compare_files
from gs_codec.formats.ply import read_ply, vertex_rows, write_ply
from gs_codec.scene import Scene


def measure_scene(
    scene: Scene, name: str, config: Config, repeats: int
) -> Iterator[dict[str, Any]]:
    """Result lines of one scene under one configuration: codec, error, memory.

    The scene is written as PLY to a temporary folder first; encoding is timed from that
    (cached) file to the stream in memory, decoding from the stream to the rows of a PLY.
    """
    with tempfile.TemporaryDirectory() as folder:
        ply, back = Path(folder) / "scene.ply", Path(folder) / "back.ply"
        write_ply(ply, scene)
        identity = {"scene": name, "profile": config.profile, "gaussians": scene.count}
        yield {"kind": "codec", **identity, **_codec(ply, config, repeats)}
        memory = measure_memory(scene, name, config, ply, back)
        yield {"kind": "error", **identity, **asdict(compare_files(ply, back))}
        yield memory


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
        **sizes(scene, data, ply.stat().st_size),
        "encode_seconds": spread(encode_seconds[1:]),
        "decode_seconds": spread(decode_seconds[1:]),
        "stages": {name: spread([s[name] for s in stages[1:]])["median"] for name in stages[0]},
        "section_bytes": report.section_bytes,
        "rectified": report.rectified,
        "entropy": entropy_by_group(report),
    }


def sizes(scene: Scene, data: bytes, ply_bytes: int) -> dict[str, Any]:
    """Sizes of a scene and of its encoding; bits for each Gaussian of the input."""
    return {
        "gaussians": scene.count,
        "ply_bytes": ply_bytes,
        "file_bytes": len(data),
        "ratio": ply_bytes / len(data),
        "bits_per_gaussian": 8 * len(data) / max(scene.count, 1),
    }


def spread(values: list[float]) -> dict[str, float]:
    """Median, least and largest value."""
    return {"median": statistics.median(values), "min": min(values), "max": max(values)}


def measure_memory(
    scene: Scene, name: str, config: Config, ply: Path, back: Path
) -> dict[str, Any]:
    """The result line of the largest resident memory of whole processes, from `ply` to `back`."""
    depths = [arg for g, bits in config.depths.items() for arg in ("--set", f"depth.{g}={bits}")]
    threads = [] if config.threads is None else ["--threads", str(config.threads)]
    options = ["-p", config.profile, "--extra", config.extra, *depths, *threads]
    stream = str(back.with_suffix(".egs"))
    encode = run_apart(["encode", str(ply), stream, *options, "--overwrite"]).peak_bytes
    decode = run_apart(["decode", stream, str(back), *threads, "--overwrite"]).peak_bytes
    return {
        "kind": "memory",
        "scene": name,
        "profile": config.profile,
        "gaussians": scene.count,
        "encode_peak_bytes": encode,
        "decode_peak_bytes": decode,
        "float_bytes": scene.float_bytes,
        "encode_ratio": encode / max(scene.float_bytes, 1),
        "decode_ratio": decode / max(scene.float_bytes, 1),
    }

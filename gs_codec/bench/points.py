"""What codes geometry and SH-DC: our octree beside G-PCC, and profile `m` beside both."""

from __future__ import annotations

import os
import shlex
import struct
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from gs_codec.bench import child_peak
from gs_codec.bench.apart import run_apart
from gs_codec.bench.measure import spread
from gs_codec.codec import decode_part, encode_scene
from gs_codec.codec.part import Part
from gs_codec.config import Config
from gs_codec.container.file import SectionId, read_file
from gs_codec.errors import MissingTool
from gs_codec.geometry.tmc3 import Tmc3
from gs_codec.io.ply import write_ply
from gs_codec.scene import Scene

Result = TypeVar("Result")

_GEOMETRY = (SectionId.GEOMETRY, SectionId.LOW_BITS)

#: Units of a G-PCC bitstream that are of an attribute: parameters, data, constant data.
_COLOUR_UNITS = (3, 4, 7)


def measure_points(
    scene: Scene, name: str, config: Config, repeats: int
) -> Iterator[dict[str, Any]]:
    """A result line for each coder of a paper profile's points, and one for profile `m`.

    Times are of processors, the program's included, for whole encodings and decodings; what
    G-PCC has coded is not decoded to verify it.
    """
    octree = replace(config, geometry="octree", tmc3=None, verify=True)
    yield from _measure(scene, name, "octree", octree, repeats)
    try:
        tool = Tmc3.find(config.tmc3)
    except MissingTool as error:
        yield {"kind": "points", "scene": name, "coder": "gpcc", "absent": str(error)}
    else:
        gpcc = replace(config, geometry="gpcc", tmc3=tool.path, verify=False)
        yield from _measure(scene, name, "gpcc", gpcc, repeats)
    yield from _measure(scene, name, "m", replace(octree, profile="m", depths={}), repeats)


def _measure(
    scene: Scene, name: str, coder: str, config: Config, repeats: int
) -> Iterator[dict[str, Any]]:
    encode_seconds, decode_seconds = [], []
    for _ in range(repeats + 1):  # the first run compiles and fills caches
        data, seconds = _timed(lambda: encode_scene(scene, config)[0])
        encode_seconds.append(seconds)
        decode_seconds.append(_timed(lambda: _decode(data, config))[1])  # noqa: B023
    geometry, colour = _split(data)
    count = max(scene.count, 1)
    yield {
        "kind": "points",
        "scene": name,
        "coder": coder,
        "profile": config.profile,
        "gaussians": scene.count,
        "geometry_bits_per_gaussian": 8 * geometry / count,
        "colour_bits_per_gaussian": 8 * colour / count,
        "encode_cpu_seconds": spread(encode_seconds[1:]),
        "decode_cpu_seconds": spread(decode_seconds[1:]),
        **_memory(scene, config),
    }


def _decode(data: bytes, config: Config) -> Scene:
    return decode_part(data, Part(), config.threads, tmc3=config.tmc3)[0]


def _timed(call: Callable[[], Result]) -> tuple[Result, float]:
    """A result, and the processor time that it took here and in programs that were started."""
    before = os.times()
    result = call()
    return result, sum(os.times()[:4]) - sum(before[:4])


def _split(data: bytes) -> tuple[int, int]:
    """Bytes of geometry and of SH-DC in a stream."""
    geometry = colour = 0
    for (section_id, _), content in read_file(data).sections.items():
        if section_id in _GEOMETRY:
            geometry += len(content)
        elif section_id == SectionId.SH_DC:
            colour += len(content)
        elif section_id == SectionId.GPCC:
            of_colour = colour_bytes(content[4:])
            geometry, colour = geometry + len(content) - of_colour, colour + of_colour
    return geometry, colour


def colour_bytes(stream: memoryview) -> int:
    """Bytes of a G-PCC bitstream's units that are of colour."""
    found = start = 0
    while start < len(stream):
        unit, size = struct.unpack_from(">BI", stream, start)
        start += 5 + size
        found += (5 + size) * (unit in _COLOUR_UNITS)
    return found


def _memory(scene: Scene, config: Config) -> dict[str, int]:
    """Peak resident memory of whole processes, and of the program, of which each thread has one."""
    with tempfile.TemporaryDirectory() as folder:
        ply, stream, peaks = (Path(folder, name) for name in ("a.ply", "a.egs", "peaks"))
        write_ply(ply, scene)
        encode = ["encode", str(ply), str(stream), "-p", config.profile, "--extra", config.extra]
        encode += [arg for g, bits in config.depths.items() for arg in ("--depth", f"{g}={bits}")]
        decode = ["decode", str(stream), str(ply.with_suffix(".back.ply"))]
        if config.tmc3 is not None:
            wrapped = Path(folder, "tmc3")
            command = [sys.executable, "-I", "-S", child_peak.__file__, str(peaks), config.tmc3]
            wrapped.write_text(f'#!/bin/sh\nexec {shlex.join(command)} "$@"\n')
            wrapped.chmod(0o755)
            encode += ["--geometry", "gpcc", "--no-verify", "--tmc3", str(wrapped)]
            decode += ["--tmc3", str(wrapped)]
        found = {"encode_peak_bytes": run_apart(encode).peak_bytes}
        found["decode_peak_bytes"] = run_apart(decode).peak_bytes
        if config.tmc3 is not None:
            found["tool_peak_bytes"] = max(map(int, peaks.read_text().split()))
    return found

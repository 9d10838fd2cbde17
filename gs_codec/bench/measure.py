"""``bench run`` and ``bench peers``: result lines of scenes, profile by profile."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from gs_codec.analysis.entropy import entropy_by_group
from gs_codec.bench.host import machine
from gs_codec.bench.measured_scenes import MeasuredScene, open_scene
from gs_codec.bench.peers import Peer, find_peers
from gs_codec.bench.processes import run_in_process
from gs_codec.bench.side_by_side import measure_alternating, our_codecs
from gs_codec.config import Config, changed_options
from gs_codec.encoding.order import encode
from gs_codec.encoding.request import Request
from gs_codec.files.scenes import compare_files
from gs_codec.formats.ply.writer import write_ply


def measure_scenes(
    paths: Sequence[Path],
    configs: Sequence[Config],
    tile: int | None,
    repeats: int,
    cameras: str | None,
    truth: Path | None,
    width: int | None,
    peers: bool,
    own: Sequence[Peer] = (),
) -> Iterator[dict[str, Any]]:
    """Result lines of profiles, compared with other codecs or with details of each.

    Views come from `open_scene`. With cameras, `l`, `m` and `s` are also measured camera-guided.
    The codecs `own` are measured too.
    """
    yield machine()
    extra, threads = configs[0].chosen_extra(), configs[0].threads
    for path in paths:
        measured = open_scene(path, cameras, truth, width, extra, tile)
        ours = our_codecs(configs, measured.plan if cameras else None)
        others = find_peers(extra, threads) if peers else []
        yield from measure_alternating(measured, [*ours, *others, *own], repeats)
        if not peers:
            for config in configs:
                yield from _details(measured, config)


def _details(measured: MeasuredScene, config: Config) -> Iterator[dict[str, Any]]:
    """Bits of a profile by attribute, its errors, and its memory."""
    scene = measured.scene
    with tempfile.TemporaryDirectory() as folder:
        ply, back = Path(folder) / "scene.ply", Path(folder) / "back.ply"
        write_ply(ply, scene)
        report = encode(scene, Request(config))[1]
        identity = {"scene": measured.name, "profile": config.profile, "gaussians": scene.count}
        yield {
            "kind": "codec",
            **identity,
            "stages": report.seconds,
            "section_bytes": report.section_bytes,
            "rectified": report.rectified,
            "entropy": entropy_by_group(report),
        }
        memory = measure_memory(measured, config, ply, back)
        yield {"kind": "error", **identity, **asdict(compare_files(ply, back))}
        yield memory


def measure_memory(
    measured: MeasuredScene, config: Config, ply: Path, back: Path
) -> dict[str, Any]:
    """The result line of the peak resident memory of whole processes, from `ply` to `back`."""
    changed = changed_options(replace(config, depths={}))
    typed = [(name.replace("_", "-"), value) for name, value in changed.items()]
    typed += [("depth", f"{group}={bits}") for group, bits in config.depths.items()]
    options = [text for name, value in typed for text in (f"--{name}", str(value))]
    threads = [] if config.threads is None else ["--threads", str(config.threads)]
    stream = str(back.with_suffix(".egs"))
    encode = run_in_process(["encode", str(ply), stream, *options, "--overwrite"]).peak_bytes
    decode = run_in_process(["decode", stream, str(back), *threads, "--overwrite"]).peak_bytes
    return {
        "kind": "memory",
        "scene": measured.name,
        "profile": config.profile,
        "gaussians": measured.scene.count,
        "encode_peak_bytes": encode,
        "decode_peak_bytes": decode,
        "float_bytes": measured.scene.float_bytes,
    }

"""Codecs beside each other: sizes, times taken in turn, and rendered views."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from gs_codec import __version__
from gs_codec.bench.measure import sizes, spread
from gs_codec.bench.peers import AbsentPeer, Peer
from gs_codec.bench.rendered import rendered_quality
from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.config import ADAPTIVE_PROFILES, PROFILE_CHOICES, Config
from gs_codec.errors import ToolFailed
from gs_codec.formats.ply import read_ply, vertex_rows, write_ply
from gs_codec.guidance.planned import encode_planned
from gs_codec.preparation.pipeline import prepare_scene
from gs_codec.preparation.steps import Plan, Steps
from gs_codec.rendering.camera import Camera
from gs_codec.scene import Scene

#: Follows the profile's name if it is camera-guided.
GUIDED = ", camera-guided"

#: Most views to prune and to encode by.
_PRUNING_VIEWS = 128


def our_codecs(
    configs: Sequence[Config], plan: Plan | None = None, pruned: Sequence[float] = ()
) -> list[Peer]:
    """Our profiles; with a plan's views, `l`, `m`, `s` camera-guided too, and `m` pruned.

    `pruned` are percentages of Gaussians removed by leave-one-out error.
    """
    codecs = [_camera_free(config) for config in configs]
    if plan is not None:
        guided = [config for config in configs if config.profile in ADAPTIVE_PROFILES]
        codecs += [_guided(config, plan, 0.0) for config in guided]
        codecs += [
            _guided(c, plan, percent) for c in guided if c.profile == "m" for percent in pruned
        ]
    return codecs


def is_ours(codec: str) -> bool:
    """Whether a result line's codec is one of `our_codecs`."""
    return codec.partition(",")[0] in PROFILE_CHOICES


def measure_beside(
    scene: Scene,
    name: str,
    codecs: Sequence[Peer | AbsentPeer],
    repeats: int,
    cameras: Sequence[Camera] = (),
    truth: Path | None = None,
) -> Iterator[dict[str, Any]]:
    """A result line for each codec.

    All start from the same (cached) PLY, read by the same reader, and end with its floats in
    memory. In each of the `repeats` after the first, which compiles, every codec has its turn; slow
    ones have one. A codec that is absent, fails or exceeds its time has a line with the reason.
    """
    present = [codec for codec in codecs if isinstance(codec, Peer)]
    with tempfile.TemporaryDirectory() as folder:
        ply = Path(folder) / "scene.ply"
        _compile(scene, ply, present)
        write_ply(ply, scene)
        ply_bytes = ply.stat().st_size
        for codec, turns in zip(present, _take_turns(ply, present, repeats), strict=True):
            try:
                yield _line(scene, name, codec, turns, ply_bytes) | (
                    _quality(scene, codec, turns.data, cameras, truth) if cameras else {}
                )
            except ToolFailed as error:
                yield _absent(name, codec.name, f"{codec.name} of {name}: {error}")
    for other in codecs:
        if isinstance(other, AbsentPeer):
            yield _absent(name, other.name, other.absent)


@dataclass
class _Turns:
    """Encoding of a scene by a codec, and the seconds of each of its turns."""

    data: bytes = b""
    encode: list[float] = field(default_factory=list)
    decode: list[float] = field(default_factory=list)
    failed: ToolFailed | None = None


def _camera_free(config: Config) -> Peer:
    def encode(ply: Path) -> bytes:
        return encode_scene(read_ply(ply, config.extra), config)[0]

    def decode(data: bytes) -> Scene:
        scene = decode_scene(data, config.threads)
        vertex_rows(scene)
        return scene

    return Peer(config.profile, __version__, encode, decode, lambda scene: scene)


def _guided(config: Config, plan: Plan, percent: float) -> Peer:
    """A profile that uses the views of a plan, after so many percent were pruned."""

    def encode(ply: Path) -> bytes:
        scene, chosen, targets = read_ply(ply, config.extra), plan, None
        if percent:
            chosen = replace(plan, steps=Steps(prune=percent), views=_PRUNING_VIEWS)
            scene, report = prepare_scene(scene, chosen)
            targets = report.views.renders
        return encode_planned(scene, config, chosen, references=targets)[0]

    how = f", {percent:g} % pruned" if percent else GUIDED
    return replace(_camera_free(config), name=config.profile + how, encode=encode, once=True)


def _compile(scene: Scene, ply: Path, codecs: Sequence[Peer]) -> None:
    """Encode a thousand Gaussians with those codecs of ours whose only turn counts."""
    few = np.linspace(0, scene.count - 1, min(scene.count, 1000)).astype(np.int64)
    write_ply(ply, scene.take(few))
    for codec in codecs:
        if codec.once and not codec.own_process:
            codec.encode(ply)


def _take_turns(ply: Path, codecs: Sequence[Peer], repeats: int) -> list[_Turns]:
    all_turns = [_Turns() for _ in codecs]
    for turn in range(repeats + 1):
        for codec, turns in zip(codecs, all_turns, strict=True):
            if turns.failed or (codec.once and turn != 1):
                continue
            start = time.perf_counter()
            try:
                turns.data = codec.encode(ply)
                encoded = time.perf_counter()
                codec.decode(turns.data)
            except ToolFailed as error:
                turns.failed = error
                continue
            end = time.perf_counter()
            if turn:
                turns.encode.append(encoded - start)
                turns.decode.append(end - encoded)
    return all_turns


def _line(scene: Scene, name: str, codec: Peer, turns: _Turns, ply_bytes: int) -> dict[str, Any]:
    if turns.failed:
        raise turns.failed
    return {
        "kind": "beside",
        "scene": name,
        "codec": codec.name,
        "version": codec.version,
        "own_process": codec.own_process,
        **sizes(scene, turns.data, ply_bytes),
        "encode_seconds": spread(turns.encode),
        "decode_seconds": spread(turns.decode),
    }


def _quality(
    scene: Scene, codec: Peer, data: bytes, cameras: Sequence[Camera], truth: Path | None
) -> dict[str, Any]:
    return rendered_quality(scene, codec.scene(codec.decode(data)), cameras, truth)


def _absent(scene: str, codec: str, why: str) -> dict[str, Any]:
    return {"kind": "beside", "scene": scene, "codec": codec, "absent": why}

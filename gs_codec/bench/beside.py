"""Codecs beside each other: sizes, times taken in turn, and rendered views."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gs_codec import __version__
from gs_codec.bench.measure import spread
from gs_codec.bench.peers import AbsentPeer, Peer, find_peers
from gs_codec.bench.rendered import rendered_quality
from gs_codec.codec import decode_scene, encode_scene
from gs_codec.config import LATTICE_PROFILES, PROFILE_CHOICES, Config
from gs_codec.errors import ToolFailed
from gs_codec.io.ply import read_ply, vertex_rows, write_ply
from gs_codec.planned import guide_of
from gs_codec.preparation.pipeline import Plan
from gs_codec.rendering.camera import Camera
from gs_codec.scene import Scene

#: What follows the profile's name where a codec goes by views.
_BY_VIEWS = ", by views"


def measure_beside(
    scene: Scene,
    name: str,
    configs: Sequence[Config],
    repeats: int,
    cameras: Sequence[Camera] = (),
    truth: Path | None = None,
    plan: Plan | None = None,
    others: Sequence[Peer | AbsentPeer] | None = None,
) -> Iterator[dict[str, Any]]:
    """A result line for each of our configurations and each peer: `others`, or all there are.

    All begin with the same (cached) PLY, read by the same reader, and end with its floats in
    memory. In each of the `repeats` after the first, which compiles, every codec has its turn;
    with a `plan`, profiles that can go by its views do that too, once, and before that on a few
    Gaussians, which compiles. A peer that fails, or does not end in its time, has a line that says
    so, as one has that is absent.
    """
    present = [our_codec(config) for config in configs]
    if plan is not None:
        by_views = [config for config in configs if config.profile in LATTICE_PROFILES]
        present += [_by_views(config, plan) for config in by_views]
        for config in by_views[:1]:
            few = few_of(scene)
            encode_scene(few, config, guide=guide_of(few, plan, config))
    with tempfile.TemporaryDirectory() as folder:
        ply = Path(folder) / "scene.ply"
        write_ply(ply, scene)
        if others is None:
            others = find_peers(configs[0].extra, configs[0].threads)
        present += [peer for peer in others if isinstance(peer, Peer)]
        for peer, turns in zip(present, _take_turns(ply, present, repeats), strict=True):
            try:
                line = result_line(scene, name, peer, turns, ply.stat().st_size)
                if cameras:
                    decoded = peer.scene(peer.decode(turns.data))
                    line |= rendered_quality(scene, decoded, cameras, truth)
            except ToolFailed as error:
                line = _absent(name, peer.name, f"{peer.name} of {name}: {error}")
            yield line
    for other in others:
        if isinstance(other, AbsentPeer):
            yield _absent(name, other.name, other.absent)


def is_ours(codec: str) -> bool:
    """Whether a result line's codec is one of our profiles."""
    return codec.removesuffix(_BY_VIEWS) in PROFILE_CHOICES


@dataclass
class Turns:
    """What a codec made of a scene, and the seconds of each of its turns."""

    data: bytes = b""
    encode: list[float] = field(default_factory=list)
    decode: list[float] = field(default_factory=list)
    failed: ToolFailed | None = None


def few_of(scene: Scene) -> Scene:
    """A thousand of the Gaussians, evenly spaced: enough to compile what a scene needs."""
    return scene.take(np.linspace(0, scene.count - 1, min(scene.count, 1000)).astype(np.int64))


def our_codec(config: Config) -> Peer:
    """One of our profiles, called as the others are."""

    def encode(ply: Path) -> bytes:
        return encode_scene(read_ply(ply, config.extra), config)[0]

    def decode(data: bytes) -> Scene:
        scene = decode_scene(data, config.threads)
        vertex_rows(scene)
        return scene

    return Peer(config.profile, __version__, encode, decode, lambda scene: scene)


def _by_views(config: Config, plan: Plan) -> Peer:
    """One of our profiles that goes by the views of a plan."""

    def encode(ply: Path) -> bytes:
        scene = read_ply(ply, config.extra)
        return encode_scene(scene, config, guide=guide_of(scene, plan, config))[0]

    blind = our_codec(config)
    name = f"{config.profile}{_BY_VIEWS}"
    return Peer(name, __version__, encode, blind.decode, blind.scene, once=True)


def _take_turns(ply: Path, peers: Sequence[Peer], repeats: int) -> list[Turns]:
    all_turns = [Turns() for _ in peers]
    for turn in range(repeats + 1):
        for peer, turns in zip(peers, all_turns, strict=True):
            if turns.failed or (peer.once and turn != 1):
                continue
            start = time.perf_counter()
            try:
                turns.data = peer.encode(ply)
                encoded = time.perf_counter()
                peer.decode(turns.data)
            except ToolFailed as error:
                turns.failed = error
                continue
            end = time.perf_counter()
            if turn:
                turns.encode.append(encoded - start)
                turns.decode.append(end - encoded)
    return all_turns


def result_line(
    scene: Scene, name: str, peer: Peer, turns: Turns, ply_bytes: int
) -> dict[str, Any]:
    """Size and seconds of a codec; bits are those of a Gaussian of the input."""
    if turns.failed:
        raise turns.failed
    size = len(turns.data)
    return {
        "kind": "beside",
        "scene": name,
        "codec": peer.name,
        "version": peer.version,
        "own_process": peer.own_process,
        "gaussians": scene.count,
        "ply_bytes": ply_bytes,
        "file_bytes": size,
        "ratio": ply_bytes / size,
        "bits_per_gaussian": 8 * size / max(scene.count, 1),
        "encode_seconds": spread(turns.encode),
        "decode_seconds": spread(turns.decode),
    }


def _absent(scene: str, codec: str, why: str) -> dict[str, Any]:
    return {"kind": "beside", "scene": scene, "codec": codec, "absent": why}

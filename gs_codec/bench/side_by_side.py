"""Compare codecs: sizes, interleaved timings, and rendered views."""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gs_codec import __version__
from gs_codec.bench.measured_scenes import MeasuredScene
from gs_codec.bench.peers import AbsentPeer, Peer
from gs_codec.codecs.decode import decode_as
from gs_codec.config import ADAPTIVE_PROFILES, EGS, PROFILE_CHOICES, Config, RateTarget
from gs_codec.encoding.order import encode, encode_prepared
from gs_codec.encoding.request import Request
from gs_codec.errors import InvalidInput, ToolFailed
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import vertex_rows, write_ply
from gs_codec.metrics.image_quality import LPIPS_VARIABLE
from gs_codec.metrics.views import compare_views
from gs_codec.plan import Plan, Steps
from gs_codec.preparation.pipeline import prepare_scene
from gs_codec.scene import Scene

#: Suffix of the profile's name if it is camera-guided.
GUIDED = ", camera-guided"

#: Suffix of the profile's name with estimated cameras.
ESTIMATED = ", estimated cameras"

#: Suffix of a compression ratio: refined to photographs.
REFINED = "x refined"

#: Suffix of a compression ratio: refined to the scene's own renders.
BY_RENDERS = "x refined, renders"

#: Prefix of the format, if it is not our own, and the profile.
OURS_AS = "ours as "

#: Iterations of refinement.
_ITERATIONS = 2000

#: Maximum number of views for pruning and encoding.
_PRUNING_VIEWS = 128


def our_codecs(
    configs: Sequence[Config],
    plan: Plan | None = None,
    pruned: Sequence[float] = (),
    refined: Sequence[tuple[Plan, float]] = (),
) -> list[Peer]:
    """Our profiles; with a plan, also `l`, `m`, `s` camera-guided, and `m` pruned or refined.

    Names in other formats than `.egs` begin with the format, next to those of other programs.

    `pruned` are percentages of Gaussians removed by leave-one-out error; `refined` are plans with
    the views to refine to, and compression ratios.
    """
    codecs = [camera_free(config) for config in configs]
    if plan is not None:
        adaptive = [config for config in configs if config.profile in ADAPTIVE_PROFILES]
        codecs += [guided(config, plan) for config in adaptive]
        of_m = [config for config in adaptive if config.profile == "m" and config.format == EGS]
        codecs += [pruned_by(config, plan, percent) for config in of_m for percent in pruned]
        codecs += [refined_to(config, *how) for config in of_m for how in refined]
    return codecs


def is_ours(codec: str) -> bool:
    """Whether a result line's codec is one of `our_codecs`, in our own format."""
    return codec.partition(",")[0] in PROFILE_CHOICES


def camera_free(config: Config) -> Peer:
    """A profile without cameras."""
    request = Request(config)

    def decode(data: bytes) -> Scene:
        scene = decode_as(config, data)
        vertex_rows(scene)
        return scene

    encode_ply = partial(_encode, request)
    return Peer(_name_of(config), __version__, encode_ply, decode, lambda scene: scene)


def _encode(request: Request, ply: Path) -> bytes:
    scene = read_ply(ply, request.config.chosen_extra())
    return b"".join(encode(scene, request, ply_bytes=ply.stat().st_size)[0])


def _name_of(config: Config) -> str:
    """A profile's name; for other formats, with a prefix."""
    if config.format == EGS:
        return config.profile
    version = f" v{config.spz_version}" if config.format == "spz" else ""
    return f"{OURS_AS}{config.format}{version}, {config.profile}"


def guided(config: Config, plan: Plan, how: str = GUIDED) -> Peer:
    """A profile that uses the views of a plan."""
    by_views = partial(_encode, Request(config, plan))
    return replace(camera_free(config), name=_name_of(config) + how, encode=by_views, once=True)


def pruned_by(config: Config, plan: Plan, percent: float) -> Peer:
    """A profile guided by the views of a plan, after pruning this percentage by them."""
    chosen = replace(plan, steps=Steps(prune=percent), views=_PRUNING_VIEWS)

    def encode_pruned(ply: Path) -> bytes:
        scene, report = prepare_scene(read_ply(ply, config.chosen_extra()), chosen)
        request = Request(config, chosen)
        return b"".join(encode_prepared(scene, request, references=report.views.renders)[0])

    name = f"{_name_of(config)}, {percent:g} % pruned"
    return replace(camera_free(config), name=name, encode=encode_pruned, once=True)


def refined_to(config: Config, plan: Plan, ratio: float) -> Peer:
    """A profile after refinement to the views of a plan, at this compression ratio to the PLY."""
    chosen, target = replace(plan, steps=Steps(refine=_ITERATIONS)), RateTarget(ratio=ratio)
    request = Request(config, chosen, target)

    def encode_refined(ply: Path) -> bytes:
        try:
            return _encode(request, ply)
        except InvalidInput as error:
            raise ToolFailed(str(error)) from error

    how = BY_RENDERS if plan.gt_images is None else REFINED
    name = f"{config.profile}, {ratio:g}{how}"
    return replace(camera_free(config), name=name, encode=encode_refined, once=True)


def measure_alternating(
    measured: MeasuredScene, codecs: Sequence[Peer | AbsentPeer], repeats: int
) -> Iterator[dict[str, Any]]:
    """A result line for each codec.

    All start from the same (cached) PLY, read by the same reader, and end with its floats in
    memory. Codecs alternate in each of the `repeats`, after a first run that compiles; slow ones
    run once. A codec that is absent, fails or exceeds its time has a line with the reason.
    """
    name, scene = measured.name, measured.scene
    present = [codec for codec in codecs if isinstance(codec, Peer)]
    with tempfile.TemporaryDirectory() as folder:
        ply = Path(folder) / "scene.ply"
        _compile(scene, ply, present)
        write_ply(ply, scene)
        ply_bytes = ply.stat().st_size
        for codec, turns in zip(present, _take_turns(ply, present, repeats), strict=True):
            try:
                yield _line(measured, codec, turns, ply_bytes)
            except ToolFailed as error:
                yield _absent(name, codec.name, f"{codec.name} of {name}: {error}")
    for other in codecs:
        if isinstance(other, AbsentPeer):
            yield _absent(name, other.name, other.absent)


@dataclass
class _Turns:
    """Encodes and decodes a scene with a codec, and records the seconds of each turn."""

    data: bytes = b""
    encode: list[float] = field(default_factory=list)
    decode: list[float] = field(default_factory=list)
    failed: ToolFailed | None = None


def _compile(scene: Scene, ply: Path, codecs: Sequence[Peer]) -> None:
    """Encode a thousand Gaussians with those of our codecs that run only once.

    Not with refinement, which takes minutes anyway.
    """
    few = np.linspace(0, scene.count - 1, min(scene.count, 1000)).astype(np.int64)
    write_ply(ply, scene.take(few))
    for codec in codecs:
        if codec.once and not codec.own_process and REFINED not in codec.name:
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


def _line(measured: MeasuredScene, codec: Peer, turns: _Turns, ply_bytes: int) -> dict[str, Any]:
    """Sizes and times; bits per Gaussian of the input; with cameras, the quality of views."""
    if turns.failed:
        raise turns.failed
    count, size = measured.scene.count, len(turns.data)
    line = {
        "kind": "beside",
        "scene": measured.name,
        "codec": codec.name,
        "version": codec.version,
        "own_process": codec.own_process,
        "gaussians": count,
        "input_bytes": ply_bytes,
        "output_bytes": size,
        "ratio": ply_bytes / size,
        "bits_per_gaussian": 8 * size / max(count, 1),
        "encode_seconds": _spread(turns.encode),
        "decode_seconds": _spread(turns.decode),
    }
    if measured.cameras:
        line |= _quality(measured, codec.scene(codec.decode(turns.data)))
    return line


def _quality(measured: MeasuredScene, decoded: Scene) -> dict[str, Any]:
    """Quality of the decoded scene's views; PSNR of equal views is None."""
    comparison = compare_views(
        measured.scene, decoded, measured.cameras, measured.truth, device="cpu",
        lpips=os.environ.get(LPIPS_VARIABLE) or None, masks=measured.masks,
    )  # fmt: skip
    mean = comparison.mean
    result: dict[str, Any] = {
        "decoded_gaussians": decoded.count,
        "views": len(comparison.views),
        "masked": measured.masks is not None,
        "mean": mean.between.as_dict(),
        "worst_psnr": comparison.worst.between.as_dict()["psnr"],
    }
    if mean.first and mean.delta:
        result |= {"truth": mean.first.as_dict(), "delta": mean.delta.as_dict()}
    return result


def _spread(values: list[float]) -> dict[str, float]:
    return {"median": statistics.median(values), "min": min(values), "max": max(values)}


def _absent(scene: str, codec: str, why: str) -> dict[str, Any]:
    return {"kind": "beside", "scene": scene, "codec": codec, "absent": why}

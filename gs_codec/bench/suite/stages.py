"""What is measured of each scene, part by part; lines are those of the single measurements."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gs_codec.bench.ablated import measure_ablation
from gs_codec.bench.beside import measure_beside
from gs_codec.bench.coders import measure_coders
from gs_codec.bench.equal import compare_at_equal_quality
from gs_codec.bench.gains import measure_gains
from gs_codec.bench.measure import measure_scene
from gs_codec.bench.parts import measure_parts
from gs_codec.bench.peers import AbsentPeer, Peer, find_peers
from gs_codec.bench.points import measure_points
from gs_codec.bench.pruned import measure_pruned
from gs_codec.bench.scaling import measure_scaling
from gs_codec.bench.start import measure_start
from gs_codec.bench.suite.options import Options
from gs_codec.bench.suite.scenes import MeasuredScene
from gs_codec.bench.tile import tile_scene
from gs_codec.config import PROFILE_CHOICES, Config
from gs_codec.io.ply import write_ply

Lines = Iterator[dict[str, Any]]

#: Gaussians of the tiled scenes that costs grow over.
SIZES = (100_000, 300_000, 1_000_000, 3_000_000)


@dataclass(frozen=True)
class Stage:
    """A part of the suite.

    Attributes
    ----------
    title : str
        What it measures, for people who wait.
    groups : tuple of str
        Leaving out any of these leaves it out.
    measure : callable
        From a scene, options, and the lines there are by now, to its own.
    photographs : bool
        Whether it is for scenes that have them.
    """

    title: str
    groups: tuple[str, ...]
    measure: Callable[[MeasuredScene, Options, Sequence[dict[str, Any]]], Lines]
    photographs: bool = False


def _profiles(measured: MeasuredScene, options: Options, _: Sequence[dict[str, Any]]) -> Lines:
    for profile in PROFILE_CHOICES:
        config = _config(profile, options)
        yield from measure_scene(measured.scene, measured.name, config, options.repeats)


def _beside(measured: MeasuredScene, options: Options, found: Sequence[dict[str, Any]]) -> Lines:
    return measure_beside(
        measured.scene,
        measured.name,
        [_config(profile, options) for profile in PROFILE_CHOICES],
        options.repeats,
        measured.cameras,
        measured.truth,
        measured.plan if options.wants("views") else None,
        _others(options, found),
    )


def _others(options: Options, found: Sequence[dict[str, Any]]) -> list[Peer | AbsentPeer]:
    """Other codecs; those so slow that they run once not after they failed on a smaller scene."""
    if not options.wants("peers"):
        return []
    failed = {
        line["codec"]: f"{line['absent']}; not tried on larger scenes"
        for line in reversed(found)
        if line["kind"] == "beside" and "absent" in line
    }
    return [
        AbsentPeer(peer.name, failed[peer.name])
        if isinstance(peer, Peer) and peer.once and peer.name in failed
        else peer
        for peer in find_peers("error", options.threads)
    ]


def _curves(measured: MeasuredScene, options: Options, found: Sequence[dict[str, Any]]) -> Lines:
    lines = [line for line in found if line["scene"] == measured.name]
    plan = measured.plan if options.wants("views") else None
    views = (measured.cameras, measured.truth)
    config = _config("m", options)
    points = []
    for line in measure_gains(measured.scene, measured.name, *views, config, plan, lines):
        points.append(line)
        yield line
    yield from compare_at_equal_quality([*lines, *points])


def _pruned(measured: MeasuredScene, options: Options, _: Sequence[dict[str, Any]]) -> Lines:
    config, plan = _config("m", options), measured.plan
    views = (measured.cameras, measured.truth)
    return measure_pruned(measured.scene, measured.name, config, plan, *views)


def _parts(measured: MeasuredScene, options: Options, _: Sequence[dict[str, Any]]) -> Lines:
    config = _config("m", options)
    return measure_parts(measured.scene, measured.name, measured.cameras, config)


def _points(measured: MeasuredScene, options: Options, _: Sequence[dict[str, Any]]) -> Lines:
    return measure_points(measured.scene, measured.name, _config("paper-m", options), 1)


def _ablation(measured: MeasuredScene, options: Options, _: Sequence[dict[str, Any]]) -> Lines:
    config = _config("paper-m", options)
    return measure_ablation(measured.scene, measured.name, config, measured.plan, measured.truth)


def _coders(measured: MeasuredScene, options: Options, _: Sequence[dict[str, Any]]) -> Lines:
    config = _config("paper-m", options)
    return measure_coders(measured.scene, measured.name, config, options.repeats)


def _scaling(measured: MeasuredScene, options: Options, _: Sequence[dict[str, Any]]) -> Lines:
    threads = [] if options.threads is None else ["--threads", str(options.threads)]
    with tempfile.TemporaryDirectory() as name:
        folder, paths = Path(name), []
        for size in SIZES:
            paths.append(folder / f"{size}.ply")
            write_ply(paths[-1], tile_scene(measured.scene, size, options.seed))
        for line in measure_scaling(paths, ["m", "paper-m"], threads, folder):
            yield line | {"scene": measured.name}


def _start(measured: MeasuredScene, options: Options, _: Sequence[dict[str, Any]]) -> Lines:
    return measure_start(measured.scene, measured.name, options.repeats)


def _config(profile: str, options: Options) -> Config:
    return Config(profile, threads=options.threads)


#: Of every scene.
STAGES = (
    Stage("profiles", (), _profiles),
    Stage("codecs beside each other", (), _beside),
    Stage("rate-distortion curves", ("curves",), _curves),
    Stage("pruned scenes", ("pruned", "views"), _pruned, photographs=True),
    Stage("parts of profile m", ("parts",), _parts),
    Stage("coders of geometry and SH-DC", ("points",), _points),
    Stage("the paper's ablation", ("ablation",), _ablation),
)

#: Of the largest.
STAGES_OF_LARGEST = (
    Stage("entropy coders", ("coders",), _coders),
    Stage("growing scenes", ("scaling",), _scaling),
    Stage("start of commands", ("scaling",), _start),
)

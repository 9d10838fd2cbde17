"""``gs-codec bench``."""

from __future__ import annotations

import json as json_module
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gs_codec.cli import bench_scaling
from gs_codec.cli.bench_tables import (
    COLUMNS,
    GAIN_COLUMNS,
    PART_COLUMNS,
    PEER_COLUMNS,
    POINT_COLUMNS,
    PREPARATION_COLUMNS,
    STRESS_COLUMNS,
    TARGET_COLUMNS,
    add_to_rows,
    gain_row,
    part_row,
    peer_row,
    point_row,
    preparation_row,
    stress_row,
    target_row,
)
from gs_codec.cli.coding import parse_depths
from gs_codec.cli.output import print_status, print_table, print_text
from gs_codec.cli.resources import MaxMemory, Threads
from gs_codec.cli.views import CAMERAS, Width
from gs_codec.config import LATTICE_PROFILES, LOSSLESS, PROFILE_CHOICES, PROFILES, Config
from gs_codec.errors import InvalidInput

if TYPE_CHECKING:
    from gs_codec.preparation.pipeline import Plan
    from gs_codec.rendering.camera import Camera
    from gs_codec.scene import Scene

#: Modes that --plot has something of.
_PLOTTED = ("prepare", "targets", "scaling")


def command(
    scenes: Annotated[
        list[Path] | None,
        typer.Argument(metavar="SCENE...", help="3DGS .ply files.", show_default=False),
    ] = None,
    profile: Annotated[
        list[str] | None, typer.Option("--profile", "-p", help="Profiles; all when not given.")
    ] = None,
    depth: Annotated[
        list[str] | None, typer.Option(metavar="GROUP=BITS", help="As for encode.")
    ] = None,
    tile: Annotated[
        int | None,
        typer.Option(help="Tile each scene, jittered, to this many Gaussians.", min=1),
    ] = None,
    repeats: Annotated[int, typer.Option(help="Timed runs; medians are reported.", min=1)] = 5,
    threads: Threads = None,
    cameras: Annotated[
        str | None, typer.Option(metavar="C", help=f"Measure rendered quality too: {CAMERAS}")
    ] = None,
    against_gt: Annotated[
        Path | None,
        typer.Option(metavar="IMAGES", help="Ground-truth images of these cameras."),
    ] = None,
    width: Width = None,
    coders: Annotated[
        bool, typer.Option("--coders", help="Compare torchac and constriction too (a minute).")
    ] = False,
    peers: Annotated[
        bool,
        typer.Option("--peers", help="Measure spz, splat-transform, pcodec, zstd beside instead."),
    ] = False,
    gains: Annotated[
        bool,
        typer.Option("--gains", help="Measure l, m, s over paper-* at equal quality instead."),
    ] = False,
    parts: Annotated[
        bool, typer.Option("--parts", help="Measure what each part of l, m, s saves instead.")
    ] = False,
    targets: Annotated[
        bool,
        typer.Option(
            "--targets", help="Measure wanted sizes and qualities beside l, m, s instead."
        ),
    ] = False,
    points: Annotated[
        bool,
        typer.Option("--points", help="Measure octree and G-PCC on geometry and SH-DC instead."),
    ] = False,
    prepare: Annotated[
        bool, typer.Option("--prepare", help="Measure preparation instead (ten minutes or so).")
    ] = False,
    stress: Annotated[
        bool, typer.Option("--stress", help="Measure scenes that try the numbers instead.")
    ] = False,
    scaling: Annotated[
        bool,
        typer.Option("--scaling", help="Measure how time and memory grow with scenes instead."),
    ] = False,
    max_memory: MaxMemory = None,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="PNG", help="With --prepare, --targets or --scaling: plot it."),
    ] = None,
    extra: Annotated[str, typer.Option(help="As for encode.")] = "error",
) -> None:
    """Measure time, size, error, memory and rendered quality; JSON lines on stdout."""
    if (against_gt or width) and not cameras:
        raise InvalidInput("--against-gt and --width need --cameras")
    mode = _mode_of(
        prepare=prepare, gains=gains, targets=targets, parts=parts, points=points, peers=peers,
        scaling=scaling, stress=stress,
    )  # fmt: skip
    scenes = scenes or []
    _check_scenes(mode, bool(scenes))
    _check_options(mode, bool(cameras), profile, bool(depth), plot is not None)
    bench_scaling.check_options(mode == "scaling", max_memory, tile or extra != "error")
    configs = [
        Config(name, parse_depths(depth or []), "error", extra, threads)  # type: ignore[arg-type]
        for name in profile or PROFILE_CHOICES
    ]
    views = (cameras, against_gt, width)

    def chosen(name: str) -> list[Config]:
        """The profiles that were given, or this one."""
        return configs if profile else [replace(configs[0], profile=name)]

    runs: dict[str, Callable[[], None]] = {
        "": lambda: _measure_all(scenes, configs, tile, repeats, coders, threads, views),
        "prepare": lambda: _measure_preparation(scenes, configs, tile, views, plot),
        "gains": lambda: _measure_gains(scenes, configs[0], tile, views),
        "targets": lambda: _measure_targets(scenes, configs[0], tile, views, plot),
        "parts": lambda: _measure_parts(scenes, chosen("m"), tile, views),
        "points": lambda: _measure_points(scenes, chosen("paper-m"), tile, repeats),
        "peers": lambda: _measure_peers(scenes, configs, tile, repeats, views),
        "stress": lambda: _measure_stress(profile or list(PROFILE_CHOICES), threads),
        "scaling": lambda: bench_scaling.measure(
            scenes, profile or ["m"], threads, max_memory, plot
        ),
    }
    runs[mode]()


def _mode_of(**asked: bool) -> str:
    """What is measured instead of profiles one by one; empty if it is these."""
    modes = [name for name, wanted in asked.items() if wanted]
    if len(modes) > 1:
        raise InvalidInput(f"--{modes[0]} and --{modes[1]}: one at a time")
    return modes[0] if modes else ""


def _check_options(
    mode: str, cameras: bool, profiles: list[str] | None, depths: bool, plot: bool
) -> None:
    """Refuse what a mode has no use for, or cannot do without."""
    if plot and mode not in _PLOTTED:
        raise InvalidInput(f"--plot needs --{', --'.join(_PLOTTED[:-1])} or --{_PLOTTED[-1]}")
    if mode == "prepare" and not cameras:
        raise InvalidInput("--prepare needs --cameras")
    if mode in ("gains", "targets") and (not cameras or profiles or depths):
        raise InvalidInput(f"--{mode} needs --cameras, and takes no --profile and no --depth")
    if mode == "parts" and not (cameras and set(profiles or ["m"]) <= set(LATTICE_PROFILES)):
        raise InvalidInput("--parts needs --cameras, and profiles l, m or s; m when none is given")
    if mode in ("scaling", "stress") and (cameras or depths):
        raise InvalidInput(f"--{mode} takes no --cameras and no --depth")


def _measure_all(
    scenes: list[Path],
    configs: list[Config],
    tile: int | None,
    repeats: int,
    coders: bool,
    threads: int | None,
    views: tuple[str | None, Path | None, int | None],
) -> None:
    rows: dict[str, list[str]] = {}
    for line in _measure(scenes, configs, tile, repeats, coders, threads, views):
        print_text(json_module.dumps(line))
        add_to_rows(rows, line)
    print_table(COLUMNS, list(rows.values()), sys.stderr)


def _check_scenes(mode: str, given: bool) -> None:
    """Refuse scenes beside those that --stress has, or none at all."""
    if mode == "stress" and given:
        raise InvalidInput("--stress takes no scenes: it has its own")
    if mode != "stress" and not given:
        raise InvalidInput("no scenes given, expected SCENE... or --stress")


def _measure_stress(profiles: list[str], threads: int | None) -> None:
    from gs_codec.bench.measure import machine
    from gs_codec.bench.stress import measure_stress

    print_text(json_module.dumps(machine()))
    lines = _printed(measure_stress(profiles, threads=threads))
    print_table(STRESS_COLUMNS, [stress_row(line) for line in lines], sys.stderr)


def _measure(
    scenes: list[Path],
    configs: list[Config],
    tile: int | None,
    repeats: int,
    coders: bool,
    threads: int | None,
    views: tuple[str | None, Path | None, int | None],
) -> Iterator[dict[str, Any]]:
    from gs_codec import paper
    from gs_codec.bench.coders import measure_coders
    from gs_codec.bench.measure import machine, measure_scene
    from gs_codec.bench.rendered import measure_quality, measure_speed
    from gs_codec.preparation.pipeline import Plan
    from gs_codec.preparation.steps import Steps
    from gs_codec.rendering.cameras import find_cameras

    yield machine()
    source, truth, width = views
    for path in scenes:
        name, scene = _load(path, configs[0], tile)
        cameras = find_cameras(source, scene, "held-out", width) if source else []
        for config in configs:
            yield from measure_scene(scene, name, config, repeats)
            if coders and config.profile != LOSSLESS:
                yield from measure_coders(scene, name, config, repeats)
            if cameras:
                yield measure_quality(scene, name, cameras, truth, config)
            if source and config.profile in LATTICE_PROFILES:
                plan = Plan(Steps(), source, width=width)
                yield measure_quality(scene, name, cameras, truth, config, plan)
        if cameras:
            yield measure_speed(scene, name, cameras, threads, repeats)
    for device, seconds in paper.SECONDS.items():
        yield {"kind": "paper", "gaussians": 1_120_000, "device": device, **seconds}


def _load(path: Path, config: Config, tile: int | None) -> tuple[str, Scene]:
    """A scene, tiled if asked, and what to call it."""
    from gs_codec.bench.tile import tile_scene
    from gs_codec.io.ply import read_ply

    scene = read_ply(path, config.extra)
    name = path.stem if path.stem != "point_cloud" else path.parent.name
    return name, tile_scene(scene, tile) if tile else scene


def _measure_peers(
    scenes: list[Path],
    configs: list[Config],
    tile: int | None,
    repeats: int,
    views: tuple[str | None, Path | None, int | None],
) -> None:
    from gs_codec.bench.beside import measure_beside
    from gs_codec.bench.held_out import held_out_views
    from gs_codec.bench.measure import machine

    print_text(json_module.dumps(machine()))
    source, truth, width = views
    lines = []
    for path in scenes:
        name, scene = _load(path, configs[0], tile)
        cameras, plan = held_out_views(source, scene, width) if source else ([], None)
        for line in measure_beside(scene, name, configs, repeats, cameras, truth, plan):
            print_text(json_module.dumps(line))
            lines.append(line)
    rows = [peer_row(line) for line in lines if "absent" not in line]
    print_table(PEER_COLUMNS, rows, sys.stderr)
    for reason in sorted({line["absent"] for line in lines if "absent" in line}):
        print_status(reason)


def _measure_gains(
    scenes: list[Path],
    config: Config,
    tile: int | None,
    views: tuple[str | None, Path | None, int | None],
) -> None:
    from gs_codec.bench.gains import measure_gains

    rows = []
    for name, scene, cameras, plan in _held_out(scenes, config, tile, views):
        for line in _printed(measure_gains(scene, name, cameras, views[1], config, plan)):
            if line["kind"] != "point":
                rows.append(gain_row(line))
    print_table(GAIN_COLUMNS, rows, sys.stderr)


def _measure_targets(
    scenes: list[Path],
    config: Config,
    tile: int | None,
    views: tuple[str | None, Path | None, int | None],
    plot: Path | None,
) -> None:
    from gs_codec.bench.rate_plot import plot_targets
    from gs_codec.bench.targets import measure_targets

    lines: list[dict[str, Any]] = []
    for name, scene, cameras, plan in _held_out(scenes, config, tile, views):
        lines += _printed(measure_targets(scene, name, cameras, views[1], config, plan))
    if plot is not None:
        plot_targets(lines, plot)
    print_table(TARGET_COLUMNS, [target_row(line) for line in lines], sys.stderr)


def _measure_parts(
    scenes: list[Path],
    configs: list[Config],
    tile: int | None,
    views: tuple[str | None, Path | None, int | None],
) -> None:
    from gs_codec.bench.parts import measure_parts

    rows = []
    for name, scene, cameras, plan in _held_out(scenes, configs[0], tile, views):
        for config in configs:
            for used in (None, plan):
                lines = _printed(measure_parts(scene, name, cameras, config, used))
                rows += [part_row(line) for line in lines]
    print_table(PART_COLUMNS, rows, sys.stderr)


def _measure_points(
    scenes: list[Path], configs: list[Config], tile: int | None, repeats: int
) -> None:
    if not {config.profile for config in configs} <= set(PROFILES):
        raise InvalidInput(f"--points: profiles {', '.join(PROFILES)}; paper-m when none is given")
    from gs_codec.bench.measure import machine
    from gs_codec.bench.points import measure_points

    print_text(json_module.dumps(machine()))
    rows = []
    for path in scenes:
        name, scene = _load(path, configs[0], tile)
        for config in configs:
            for line in _printed(measure_points(scene, name, config, repeats)):
                if "absent" in line:
                    print_status(line["absent"])
                else:
                    rows.append(point_row(line))
    print_table(POINT_COLUMNS, rows, sys.stderr)


def _held_out(
    scenes: list[Path],
    config: Config,
    tile: int | None,
    views: tuple[str | None, Path | None, int | None],
) -> Iterator[tuple[str, Scene, list[Camera], Plan]]:
    """Name and scene of each file, cameras to measure in, and a plan that goes by others."""
    from gs_codec.bench.held_out import held_out_views
    from gs_codec.bench.measure import machine

    print_text(json_module.dumps(machine()))
    source, _, width = views
    for path in scenes:
        name, scene = _load(path, config, tile)
        yield name, scene, *held_out_views(source or "auto", scene, width)


def _printed(lines: Iterable[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Result lines, each printed as soon as it is there."""
    for line in lines:
        print_text(json_module.dumps(line))
        yield line


def _measure_preparation(
    scenes: list[Path],
    configs: list[Config],
    tile: int | None,
    views: tuple[str | None, Path | None, int | None],
    plot: Path | None,
) -> None:
    source, truth, width = views
    if not source:
        raise InvalidInput("--prepare needs --cameras")
    from gs_codec.bench.frontier_plot import plot_frontier
    from gs_codec.bench.measure import machine
    from gs_codec.bench.prepared import measure_frontier, measure_pruning
    from gs_codec.preparation.pipeline import Plan
    from gs_codec.preparation.steps import Steps

    print_text(json_module.dumps(machine()))
    lines: list[dict[str, Any]] = []
    for path in scenes:
        name, scene = _load(path, configs[0], tile)
        plan = Plan(Steps(), source, truth, width)
        results = [measure_pruning(scene, name, plan)]
        results += [measure_frontier(scene, name, plan, config) for config in configs]
        lines += _printed(chain(*results))
    if plot is not None:
        plot_frontier([line for line in lines if line["kind"] == "frontier"], plot)
    print_table(PREPARATION_COLUMNS, [preparation_row(line) for line in lines], sys.stderr)

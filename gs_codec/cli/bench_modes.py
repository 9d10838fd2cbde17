"""Modes of ``gs-codec bench``: lines on stdout as they come, a readable table on stderr.

Each measures scenes that may be tiled. Views are where cameras come from, the folder of their
photographs, and their width.
"""

from __future__ import annotations

import json as json_module
import sys
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gs_codec.cli.bench_tables import (
    COLUMNS,
    GAIN_COLUMNS,
    PART_COLUMNS,
    PEER_COLUMNS,
    POINT_COLUMNS,
    PREPARATION_COLUMNS,
    START_COLUMNS,
    STRESS_COLUMNS,
    TARGET_COLUMNS,
    add_to_rows,
    gain_row,
    part_row,
    peer_row,
    point_row,
    preparation_row,
    print_absent,
    start_row,
    stress_row,
    target_row,
)
from gs_codec.cli.output import print_status, print_table, print_text
from gs_codec.config import LATTICE_PROFILES, LOSSLESS, PROFILES, Config
from gs_codec.errors import InvalidInput

if TYPE_CHECKING:
    from gs_codec.preparation.pipeline import Plan
    from gs_codec.rendering.camera import Camera
    from gs_codec.scene import Scene

Views = tuple[str | None, Path | None, int | None]


def run_profiles(
    scenes: list[Path],
    configs: list[Config],
    tile: int | None,
    repeats: int,
    coders: bool,
    threads: int | None,
    views: Views,
) -> None:
    """Measure profiles one by one, each way that `bench` has."""
    rows: dict[str, list[str]] = {}
    for line in _measure(scenes, configs, tile, repeats, coders, threads, views):
        print_text(json_module.dumps(line))
        add_to_rows(rows, line)
    print_table(COLUMNS, list(rows.values()), sys.stderr)


def run_stress(profiles: list[str], threads: int | None) -> None:
    """Measure scenes that try the numbers."""
    from gs_codec.bench.measure import machine
    from gs_codec.bench.stress import measure_stress

    print_text(json_module.dumps(machine()))
    lines = _printed(measure_stress(profiles, threads=threads))
    print_table(STRESS_COLUMNS, [stress_row(line) for line in lines], sys.stderr)


def run_start(scenes: list[Path], config: Config, repeats: int) -> None:
    """Measure how long commands take to start."""
    from gs_codec.bench.start import measure_start

    rows = []
    for name, scene in _loaded(scenes, config, None):
        rows += [start_row(line) for line in _printed(measure_start(scene, name, repeats))]
    print_table(START_COLUMNS, rows, sys.stderr)


def _measure(
    scenes: list[Path],
    configs: list[Config],
    tile: int | None,
    repeats: int,
    coders: bool,
    threads: int | None,
    views: Views,
) -> Iterator[dict[str, Any]]:
    from gs_codec import paper
    from gs_codec.bench.coders import measure_coders
    from gs_codec.bench.measure import machine, measure_scene
    from gs_codec.bench.rendered import measure_quality, measure_speed
    from gs_codec.bench.sources import load_scene
    from gs_codec.preparation.pipeline import Plan
    from gs_codec.preparation.steps import Steps
    from gs_codec.rendering.cameras import find_cameras

    yield machine()
    source, truth, width = views
    for path in scenes:
        name, scene = load_scene(path, configs[0].extra, tile)
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
        yield {"kind": "paper", "gaussians": paper.MEAN_GAUSSIANS, "device": device, **seconds}


def run_peers(
    scenes: list[Path],
    configs: list[Config],
    tile: int | None,
    repeats: int,
    views: Views,
) -> None:
    """Measure profiles and other codecs beside each other."""
    from gs_codec.bench.beside import measure_beside
    from gs_codec.bench.held_out import held_out_views

    source, truth, width = views
    lines: list[dict[str, Any]] = []
    for name, scene in _loaded(scenes, configs[0], tile):
        cameras, plan = held_out_views(source, scene, width) if source else ([], None)
        lines += _printed(measure_beside(scene, name, configs, repeats, cameras, truth, plan))
    rows = [peer_row(line) for line in lines if "absent" not in line]
    print_table(PEER_COLUMNS, rows, sys.stderr)
    print_absent(lines)


def run_gains(
    scenes: list[Path],
    config: Config,
    tile: int | None,
    views: Views,
) -> None:
    """Measure l, m, s over the paper's profiles at equal quality."""
    from gs_codec.bench.gains import measure_gains

    rows = []
    for name, scene, cameras, plan in _held_out(scenes, config, tile, views):
        for line in _printed(measure_gains(scene, name, cameras, views[1], config, plan)):
            if line["kind"] != "point":
                rows.append(gain_row(line))
    print_table(GAIN_COLUMNS, rows, sys.stderr)


def run_targets(
    scenes: list[Path],
    config: Config,
    tile: int | None,
    views: Views,
    plot: Path | None,
) -> None:
    """Measure wanted sizes and qualities; plot them if asked."""
    from gs_codec.bench.rate_plot import plot_targets
    from gs_codec.bench.targets import measure_targets

    lines: list[dict[str, Any]] = []
    for name, scene, cameras, plan in _held_out(scenes, config, tile, views):
        lines += _printed(measure_targets(scene, name, cameras, views[1], config, plan))
    if plot is not None:
        plot_targets(lines, plot)
    print_table(TARGET_COLUMNS, [target_row(line) for line in lines], sys.stderr)


def run_parts(
    scenes: list[Path],
    configs: list[Config],
    tile: int | None,
    views: Views,
) -> None:
    """Measure what each part of l, m, s saves."""
    from gs_codec.bench.parts import measure_parts

    rows = []
    for name, scene, cameras, plan in _held_out(scenes, configs[0], tile, views):
        for config in configs:
            for used in (None, plan):
                lines = _printed(measure_parts(scene, name, cameras, config, used))
                rows += [part_row(line) for line in lines]
    print_table(PART_COLUMNS, rows, sys.stderr)


def run_points(scenes: list[Path], configs: list[Config], tile: int | None, repeats: int) -> None:
    """Measure what codes geometry and SH-DC."""
    if not {config.profile for config in configs} <= set(PROFILES):
        raise InvalidInput(f"--points: profiles {', '.join(PROFILES)}; paper-m when none is given")
    from gs_codec.bench.points import measure_points

    rows = []
    for name, scene in _loaded(scenes, configs[0], tile):
        for config in configs:
            for line in _printed(measure_points(scene, name, config, repeats)):
                if "absent" in line:
                    print_status(line["absent"])
                else:
                    rows.append(point_row(line))
    print_table(POINT_COLUMNS, rows, sys.stderr)


def _loaded(scenes: list[Path], config: Config, tile: int | None) -> Iterator[tuple[str, Scene]]:
    """Name and scene of each file, after the line of the machine."""
    from gs_codec.bench.measure import machine
    from gs_codec.bench.sources import load_scene

    print_text(json_module.dumps(machine()))
    for path in scenes:
        yield load_scene(path, config.extra, tile)


def _held_out(
    scenes: list[Path],
    config: Config,
    tile: int | None,
    views: Views,
) -> Iterator[tuple[str, Scene, list[Camera], Plan]]:
    """Name and scene of each file, cameras to measure in, and a plan that goes by others."""
    from gs_codec.bench.held_out import held_out_views

    source, _, width = views
    for name, scene in _loaded(scenes, config, tile):
        yield name, scene, *held_out_views(source or "auto", scene, width)


def _printed(lines: Iterable[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Result lines, each printed as soon as it is there."""
    for line in lines:
        print_text(json_module.dumps(line))
        yield line


def run_preparation(
    scenes: list[Path],
    configs: list[Config],
    tile: int | None,
    views: Views,
    plot: Path | None,
) -> None:
    """Measure pruning and preparation; plot the frontier if asked."""
    source, truth, width = views
    if not source:
        raise InvalidInput("--prepare needs --cameras")
    from gs_codec.bench.frontier_plot import plot_frontier
    from gs_codec.bench.prepared import measure_frontier, measure_pruning
    from gs_codec.preparation.pipeline import Plan
    from gs_codec.preparation.steps import Steps

    lines: list[dict[str, Any]] = []
    for name, scene in _loaded(scenes, configs[0], tile):
        plan = Plan(Steps(), source, truth, width)
        results = [measure_pruning(scene, name, plan)]
        results += [measure_frontier(scene, name, plan, config) for config in configs]
        lines += _printed(chain(*results))
    if plot is not None:
        plot_frontier([line for line in lines if line["kind"] == "frontier"], plot)
    print_table(PREPARATION_COLUMNS, [preparation_row(line) for line in lines], sys.stderr)

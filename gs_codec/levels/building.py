"""The coarser levels of a scene: the tree of blocks, and the error of each. FORMAT.md, "Levels"."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.egs.header import FANOUT
from gs_codec.levels.block_errors import FOOTPRINT, Run, error_of
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene, join_scenes


@dataclass(frozen=True)
class Level:
    """A level: Gaussians, block by block, and the error of each block in scene units."""

    scene: Scene
    errors: NDArray[np.float32]


def build_levels(scene: Scene, block_size: int, progress: Progress | None = None) -> list[Level]:
    """All levels above the scene's own; its Gaussians are in stream order; none for one block."""
    levels: list[Level] = []
    current = Level(scene, np.zeros(-(-scene.count // block_size), np.float32))
    counts = []
    count = scene.count
    while count > block_size:
        count = -(-count // FANOUT)
        counts.append(-(-count // block_size))
    advance = step_counter(progress, "levels", sum(counts))
    while len(current.errors) > 1:
        current = coarser(current, block_size, scene.antialiased, advance)
        levels.append(current)
    return levels


def coarser(
    level: Level, block_size: int, antialiased: bool, advance: Callable[[], None] | None = None
) -> Level:
    """The next coarser level, or the part of it that replaces the given blocks."""
    size = FANOUT * block_size

    def work(start: int) -> tuple[Scene, float]:
        group = level.scene.between(start, min(start + size, level.scene.count))
        below = level.errors[start // block_size :][:FANOUT]
        return coarsen(group, antialiased, float(below.max()))

    found = run_all(work, range(0, level.scene.count, size), advance=advance)
    scenes, errors = zip(*found, strict=True)
    return Level(join_scenes(scenes), np.array(errors, np.float32))


def coarsen(group: Scene, antialiased: bool, least: float = 0.0) -> tuple[Scene, float]:
    """A quarter of a group's Gaussians, and their error, which is at least `least`."""
    error = max(error_of(group, antialiased), least)
    return Run(group).merged(0.0 if antialiased else FOOTPRINT * error), error

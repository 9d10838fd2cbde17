"""The coarser levels of a scene: the tree of blocks, and the error of each. FORMAT.md, "Levels".

The error of a block is the pixel size at which merging becomes hardly visible.

Runs of its Gaussians are rendered from three sides before and after merging, with opacity
compensation and increasing pixel size, until they look alike. Rendering without compensation adds a
difference that does not fade with distance; but its share of a picture shrinks, like the block
itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.egs.header import FANOUT
from gs_codec.levels.quarter import Clusters, merge_group, spacing
from gs_codec.merging.pairs import blobs_of
from gs_codec.rendering.frame import make_frame
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene, join_scenes

#: Maximum mean squared error of a block's covered pixels: 35 dB. Chosen on bonsai, flowers and the
#: showroom (LAB_NOTEBOOK.md, "Levels of detail").
_ALIKE = 10.0**-3.5

#: The same for scenes without antialiasing: 32.5 dB. Their renders differ more from the scene with
#: larger pixels anyway.
_MIXED = 10.0**-3.25

#: Pixel size for which opacities (and clusters, up to `_TOGETHER`) are computed, relative to the
#: error of their block. Because rasterisers widen splats, many small splats hide more than one
#: merged splat of the same mass.
FOOTPRINT = 0.7

#: Maximum pixel size for clusters, in distances of neighbours. With larger ones, distant Gaussians
#: would merge and look like fog from nearby.
_TOGETHER = 2.0

#: Maximum number of runs of a group that are measured.
_RUNS = 4

#: Number of Gaussians in a run.
_RUN = 1024

#: Side of the renders, in pixels.
_SIDE = 128

#: Smallest pixel size tried, in octaves of the distance between neighbours.
_LEAST = -5

#: Largest pixel size tried, in octaves of the distance between neighbours.
_MOST = 8

#: Lower bound of the error, relative to the target, so that its logarithm is finite.
_NONE = 1e-9

#: Errors are rounded up to multiples of 1/4 octave, so that they do not depend on the last bits of
#: renders.
_PARTS = 4

#: Camera distance, in sizes of a run: nearly parallel projection.
_FAR = 50.0

_SIDES = tuple(np.roll(np.eye(3), axis, axis=0) for axis in range(3))


@dataclass(frozen=True)
class Run:
    """Some neighbouring Gaussians."""

    scene: Scene

    @cached_property
    def distance(self) -> float:
        """Distance between neighbours; see `spacing`."""
        return spacing(blobs_of(self.scene))

    def merged(self, footprint: float) -> Scene:
        """A quarter of them, merged for pixels of this size; see `Clusters.merged`."""
        number = -(-self.scene.count // FANOUT)
        together = min(footprint, _TOGETHER * self.distance) if footprint else 0.0
        into = merge_group(self.scene, number, together)
        return Clusters(self.scene, into, number).merged(footprint)

    def difference(self, other: Scene, pixel: float, antialiased: bool) -> NDArray[np.float64]:
        """Sums of squared differences from their replacement, and of covered pixels' channels."""
        sums = np.zeros(2)
        for camera in self._cameras(pixel):
            before, left = _picture(self.scene, camera, antialiased)
            after, _ = _picture(other, camera, antialiased)
            sums += np.sum((before - after) ** 2, dtype=np.float64), 3 * np.sum(1 - left)
        return sums

    def _cameras(self, pixel: float) -> list[Camera]:
        low, high = self.scene.positions.min(axis=1), self.scene.positions.max(axis=1)
        middle, size = 0.5 * (np.float64(low) + high), float(np.max(np.float64(high) - low))
        away = _FAR * size + 1
        side = min(_SIDE, math.ceil(size / pixel)) or 1
        focal, half = away / pixel, side / 2
        return [
            Camera("run", side, side, focal, focal, half, half, turn, middle - away * turn[2])
            for turn in _SIDES
        ]


def _picture(scene: Scene, camera: Camera, antialiased: bool) -> tuple[NDArray, NDArray]:
    """Colour ``(H, W, 3)``, clamped to 1, and transmittance of all pixels."""
    colour, (left, _, _) = make_frame(scene, camera, antialiased).draw_float32((0.0, 0.0, 0.0))
    return np.fmin(colour, 1), np.abs(left, dtype=np.float64)


def error_of(group: Scene, antialiased: bool) -> float:
    """Pixel size, in scene units, at which a quarter of a group looks like the whole group."""
    runs = _runs(group)
    distance = float(np.mean([run.distance for run in runs]))
    if not 0 < distance < np.inf:
        return 0.0
    wanted = _ALIKE if antialiased else _MIXED
    with np.errstate(all="ignore"):
        exact = [run.merged(0.0) for run in runs]
        pixel = _where_alike(lambda size: _mean(runs, exact, size, True) / wanted, distance)
        if not antialiased:
            plain = [run.merged(FOOTPRINT * pixel) for run in runs]
            # The block's share of a picture decreases with the square of the distance.
            pixel *= math.sqrt(max(1.0, _mean(runs, plain, pixel, False) / wanted))
    return float(np.float32(2.0 ** (math.ceil(_PARTS * math.log2(pixel)) / _PARTS)))


def _runs(group: Scene) -> list[Run]:
    """Some runs of a group, evenly spaced; the whole group if it is small."""
    number = min(_RUNS, -(-group.count // _RUN))
    size = min(_RUN, group.count)
    starts = [(group.count - size) * (2 * k + 1) // (2 * number) for k in range(number)]
    return [Run(group.between(start, start + size)) for start in starts]


def _mean(runs: list[Run], others: list[Scene], pixel: float, antialiased: bool) -> float:
    """Mean squared error of covered pixels."""
    found = [
        run.difference(other, pixel, antialiased) for run, other in zip(runs, others, strict=True)
    ]
    squares, covered = np.sum(found, axis=0).tolist()
    return squares / covered if covered > 0 else 0.0


def _where_alike(error: Callable[[float], float], distance: float) -> float:
    """The pixel size at which an error is 1, interpolated between octaves of `distance`."""
    octave, found = 0, max(error(distance), _NONE)
    step = 1 if found > 1 else -1
    while _LEAST < octave < _MOST:
        before, octave = found, octave + step
        found = max(error(distance * 2.0**octave), _NONE)
        if (found > 1) != (step > 0):
            part = math.log(before) / math.log(before / found)
            return distance * 2.0 ** (octave - step + step * part)
    return distance * 2.0**octave


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

"""A scene and its coarser levels as streamed SOG; see `formats.streamed_sog`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.step_conversion import camera_free_steps, wanted_steps
from gs_codec.codecs.matching import without_order
from gs_codec.codecs.memory_limit import check_encoding
from gs_codec.coding.clean import clean_scene
from gs_codec.coding.extent import block_extent
from gs_codec.coding.far import bring_nearer
from gs_codec.coding.morton import spatial_order
from gs_codec.config import Config
from gs_codec.egs.header import FANOUT
from gs_codec.errors import InvalidInput
from gs_codec.format_table import STREAMED, UNBUNDLED
from gs_codec.formats.attribute_steps import AttributeSteps
from gs_codec.formats.coordinates import turn_axes
from gs_codec.formats.sog.streamed import Leaf, Run, describe_levels
from gs_codec.formats.sog.writer import REACH, numbers, sog_files_of
from gs_codec.guidance.calibrate import calibrated
from gs_codec.levels.adding import config_of_levels
from gs_codec.levels.building import coarsen
from gs_codec.runtime.arrays import current
from gs_codec.runtime.threads import run_all, using_threads
from gs_codec.runtime.wording import counted
from gs_codec.scene import ANTIALIASED, Scene, join_scenes

#: Leaves in a file of the finest level. More leaves in a file take fewer bytes in all; with fewer,
#: viewers load less that they do not draw.
_LEAVES = 16

#: The boxes of leaves contain ellipsoids of one standard deviation, as in other writers: distances
#: to larger boxes would be 0 in too many places. `block_extent` uses three.
_SMALLER = np.float32(np.log(3))


def stream_levels(
    scene: Scene, config: Config, most: int | None = None, finest: bool = False
) -> tuple[dict[str, bytes | memoryview], tuple[str, ...]]:
    """The files of a scene as streamed SOG, and sentences on what they cannot represent.

    Every leaf has all levels, made only from its own Gaussians, so that viewers can choose a level
    for each leaf without drawing anything twice. Raises InvalidInput if there are no Gaussians, or
    if values are not finite and ``config.nonfinite`` is not ``drop``, or a memory limit is too low,
    or if leaves are too small for so many levels.

    Parameters
    ----------
    scene : Scene
    config : Config
        With profile ``l``, ``m`` or ``s``; `block_size` limits the Gaussians of a leaf.
    most : int, optional
        Maximum Gaussians of a file, unless a single leaf has more. Default: those of 16 leaves.
    finest : bool
        Whether to write the first level as finely as possible, whatever the profile.

    Returns
    -------
    files : dict of str to bytes or memoryview
        Files by name, which may include a folder; `lod-meta.json` comes last.
    lost : tuple of str
    """
    most = most or _LEAVES * config.block_size
    check_encoding(scene.count, config, most)
    with using_threads(config.threads, scene.count):
        scene, order, moved = prepared(scene, config, STREAMED)
        leaves = _leaves(scene.take(order), config)
        files: dict[str, bytes | memoryview] = {}
        runs: list[list[Run]] = []
        losses: list[str] = [*moved]
        names: list[str] = []
        levels = [*zip(*leaves, strict=True)]
        coded = steps_of_levels(map(join_scenes, levels), config)
        for level, (parts, (whole, steps)) in enumerate(zip(levels, coded, strict=True)):
            runs.append(_runs([part.count for part in parts], most, len(names)))
            for number, (start, stop) in enumerate(_extents(runs[-1])):
                part = whole.between(start, stop)
                own = steps.between(slice(start, stop))
                if finest and not level:
                    own = AttributeSteps.least(part)
                contents, lost = sog_files_of(part, own, config.effort)
                files |= {
                    f"{level}_{number}/{name}": current().keep_bytes(data)
                    for name, data in contents.items()
                }
                names.append(f"{level}_{number}/{UNBUNDLED}")
                losses += lost
        boxes = run_all(_box, leaves)
    described = [
        Leaf(*box, of_levels) for box, of_levels in zip(boxes, zip(*runs, strict=True), strict=True)
    ]
    return files | {STREAMED: describe_levels(described, names)}, tuple(dict.fromkeys(losses))


def prepared(
    scene: Scene, config: Config, name: str
) -> tuple[Scene, NDArray[np.int64], tuple[str, ...]]:
    """A scene to divide: cleaned, in ``RDF``, far Gaussians nearer; its Morton order; what moved.

    Raises InvalidInput if it is empty or not finite; `name` is the file's.
    """
    scene = turn_axes(without_order(clean_scene(scene, config)[0]))
    if not scene.count:
        raise InvalidInput(f"no Gaussians, {name} needs at least one")
    nearer, moved = bring_nearer(scene, REACH)
    return nearer, spatial_order(scene.positions, scene.log_scale), moved


def steps_of_levels(
    levels: Iterable[Scene], config: Config
) -> Iterator[tuple[Scene, AttributeSteps]]:
    """Levels, the finest first, with their step sizes, chosen as for the levels of an .egs."""
    chosen = config
    for level, scene in enumerate(levels):
        if level < 2:
            chosen = calibrated(scene, config)
            chosen = config_of_levels(chosen) if level else chosen
        yield scene, wanted_steps(scene, camera_free_steps(scene, chosen.adaptive_profile()))


def _leaves(scene: Scene, config: Config) -> list[list[Scene]]:
    """Split a scene in Morton order into leaves of equal size; each has all levels, finest first.

    A level has a quarter of the Gaussians of the one before, by default until all would fit into
    one leaf.
    """
    number = -(-scene.count // config.block_size)
    wanted, smallest = config.lod_levels, scene.count // number
    depth = len(_quarters(scene.count, config.block_size)) if wanted is None else wanted - 1
    if wanted is not None and depth > (possible := len(_quarters(smallest))):
        leaves = f"{counted(number, 'part')} of {counted(smallest, 'Gaussian')}"
        raise InvalidInput(f"lod_levels {wanted}: at most {1 + possible} for {leaves}")
    comments = (ANTIALIASED,) if scene.antialiased else ()

    def levels(index: int) -> list[Scene]:
        ends = (scene.count * i // number for i in (index, index + 1))
        found = [scene.between(*ends)]
        for _ in range(depth):
            merged, _ = coarsen(found[-1], scene.antialiased)
            merged = merged.take(spatial_order(merged.positions, merged.log_scale))
            found.append(replace(merged, comments=comments))
        return found

    return run_all(levels, range(number))


def _quarters(count: int, most: int = 1) -> list[int]:
    """Numbers of Gaussians of coarser levels, each a quarter of the one before, down to `most`."""
    found = []
    while count > most:
        count = -(-count // FANOUT)
        found.append(count)
    return found


def _runs(counts: Sequence[int], most: int, first: int) -> list[Run]:
    """Location of the Gaussians of each leaf, in consecutive files numbered from `first`."""
    runs, offset = [], 0
    for count in counts:
        if offset and offset + count > most:
            first, offset = first + 1, 0
        runs.append(Run(first, offset, count))
        offset += count
    return runs


def _extents(runs: Sequence[Run]) -> list[tuple[int, int]]:
    """First and last index, within a level, of the Gaussians of each file."""
    begins = [run.offset == 0 for run in runs]
    ends = np.cumsum([run.count for run in runs]).tolist()
    starts = [end - run.count for end, run, begin in zip(ends, runs, begins, strict=True) if begin]
    return list(pairwise([*starts, ends[-1]]))


def box_of(scene: Scene) -> NDArray[np.float32]:
    """The box around the ellipsoids of a scene: lowest x, y, z, then the highest."""
    return block_extent(scene.positions, scene.log_scale - _SMALLER, scene.rot)[6:]


def _box(levels: Sequence[Scene]) -> tuple[list[float], list[float]]:
    """The box of all levels of a leaf."""
    corners = list(map(box_of, levels))
    low, high = np.min(corners, axis=0)[:3], np.max(corners, axis=0)[3:]
    return numbers(low), numbers(high)

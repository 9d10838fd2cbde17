"""Read, inspect and compare scenes in any format."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs import decode_part, matching
from gs_codec.codecs.adaptive.costs import gaussian_classes
from gs_codec.codecs.gaussian_costs import CodedGaussian, describe_gaussian, gaussian_bits
from gs_codec.codecs.inspection import Info, describe, inspect_bytes
from gs_codec.codecs.part import Part
from gs_codec.coding.clean import with_finite_ends
from gs_codec.config import Extra
from gs_codec.edit.actions import Action
from gs_codec.egs.frame_sections import read_described
from gs_codec.egs.index import errors_of, levels_of
from gs_codec.errors import InvalidInput
from gs_codec.formats.coordinates import (
    CONVENTION,
    state_system,
    system_of,
    turn_axes,
    turn_shift,
)
from gs_codec.formats.extra_properties import scene_without
from gs_codec.formats.ply.dialects import with_filter
from gs_codec.formats.registry import SceneFile, open_scene
from gs_codec.metrics.attributes import compare_scenes
from gs_codec.metrics.comparison import Comparison
from gs_codec.report import Progress
from gs_codec.runtime.arrays import current
from gs_codec.runtime.mapped import located, opened
from gs_codec.scene import Scene, Shift, coordinates_of, float_bytes

if TYPE_CHECKING:
    from gs_codec.levels.tiling import Blocks


def read_scene(
    path: str | Path,
    extra: Extra = "keep",
    progress: Progress | None = None,
    coordinates: str | None = CONVENTION,
    max_bytes: int | None = None,
    exact: bool = False,
    shift: Shift | None = None,
    level: int = 0,
) -> Scene:
    """Read a scene in any format; see `gs_codec.read` for the options.

    It is converted to the system `coordinates`; None keeps the file's. If `exact`, floats are as in
    the file, including infinite opacities. For `shift` and `level`, see `SceneFile`.
    """
    with open_scene(path, shift, level) as file:
        return scene_in(file, extra, progress, coordinates, max_bytes, exact)


def scene_in(
    file: SceneFile,
    extra: Extra,
    progress: Progress | None,
    coordinates: str | None,
    max_bytes: int | None,
    exact: bool = False,
) -> Scene:
    """The scene of an opened file; see `read_scene`."""
    if file.format == "egs":
        with located(file.path):
            part = Part(level=file.level)
            scene, read = decode_part(file.data, part, max_bytes=max_bytes, progress=progress)
            scene = matching.with_order(scene, matching.order_of_file(describe(read)))
            scene = scene_without(file.path, with_filter(file.path, scene), extra)
        scene = scene if exact else with_finite_ends(scene, file.path)
    elif current().limit is not None and not file.is_read_in_parts:
        raise InvalidInput(
            f"{file.path}: max-memory: only .egs and binary PLY of floats are read in parts"
        )
    else:
        scene = file.scene(extra, max_bytes, exact)
    with located(file.path):
        return scene if coordinates is None else turn_scene(scene, coordinates)


def turn_scene(scene: Scene, coordinates: str) -> Scene:
    """Like `turn_axes`, but remove a comment on an order by positions if they change."""
    if system_of(scene) == coordinates:
        return scene
    return turn_axes(matching.without_order(scene), coordinates)


def blocks_in(path: str | Path, scene: Scene) -> Blocks | None:
    """The coarser levels of an `.egs` file of a scene, in its system; None if it has none."""
    from gs_codec.levels.building import Level
    from gs_codec.levels.tiling import Blocks

    with open_scene(path) as file, located(path):
        if file.format != "egs":
            return None
        whole = read_described(file.data)
        found = [decode_part(file.data, Part(level=level)) for level in levels_of(whole)]
    header = whole.header
    if not found or header.count != scene.count:
        return None
    stated, system = header.coordinates or CONVENTION, system_of(scene)
    levels = [
        Level(turn_axes(state_system(coarser, stated), system), errors_of(own))
        for coarser, own in found
    ]
    return Blocks(levels, header.block_size)


def stated_bytes(path: str | Path) -> int:
    """Bytes of floats stated in the header of a scene's file."""
    with open_scene(path) as file:
        if file.format != "egs":
            return file.stated_bytes()
        with located(path):
            info = inspect_bytes(file.data)
        return float_bytes(info.count, info.sh_degree)


def is_egs(path: str | Path) -> bool:
    """Whether a file is an `.egs` file, valid or not."""
    with open_scene(path) as file:
        return file.format == "egs"


def inspect_file(path: str | Path) -> Info:
    """Like `inspect_bytes`, for a file; blocks are not read."""
    with opened(path) as data, located(path):
        return inspect_bytes(data)


def gaussian_bits_of_file(path: str | Path) -> NDArray[np.float64]:
    """Like `gaussian_bits`, for a file."""
    with opened(path) as data, located(path):
        return gaussian_bits(read_described(data, None))


def gaussian_classes_of_file(path: str | Path) -> NDArray[np.uint8]:
    """Like `gaussian_classes`, for a file of profile `l`, `m` or `s`."""
    with opened(path) as data, located(path):
        return gaussian_classes(read_described(data, None))


def describe_gaussian_of_file(path: str | Path, index: int) -> CodedGaussian:
    """Like `describe_gaussian`, for a file."""
    with opened(path) as data, located(path):
        return describe_gaussian(read_described(data), index)


def compare_files(
    first: str | Path, second: str | Path, max_bytes: int | None = None
) -> Comparison:
    """Compare two scenes, with Gaussians matched by `put_side_by_side`.

    If coordinate systems differ, one scene is converted.
    """
    scenes, orders = [], []
    for path in (first, second):
        scenes.append(read_scene(path, "drop", coordinates=None, max_bytes=max_bytes))
        with located(path):
            orders.append(matching.order_of(scenes[-1]))
    systems = system_of(scenes[0]), system_of(scenes[1])
    # An order refers to stored positions, so its scene is not converted.
    kept = 0 if orders[1] is None else 1
    scenes[1 - kept] = turn_axes(scenes[1 - kept], systems[kept])
    first_scene, second_scene = scenes
    compared = compare_scenes(*matching.put_side_by_side(first_scene, second_scene))
    return replace(compared, systems=systems)


def early_shifts(
    sources: Sequence[str | Path], actions: Sequence[Action], stated: str = ""
) -> list[Shift] | None:
    """The translation in the first action, if all sources have float64 centres.

    It is given in the axes of each source, which `stated` may override.
    """
    if not actions or actions[0].name != "translate":
        return None
    shifts = []
    for source in sources:
        with open_scene(source) as file:
            if not file.has_doubles:
                return None
            system = stated.upper() or coordinates_of(file.ply.header.comments) or CONVENTION
            with located(source):
                shifts.append(turn_shift(actions[0].arguments, CONVENTION, system))
    return shifts

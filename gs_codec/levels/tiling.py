"""A scene and its coarser levels as 3D Tiles; see `formats.tiles`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.config import Config, Effort
from gs_codec.egs.header import FANOUT
from gs_codec.errors import InvalidInput
from gs_codec.format_table import TILES, TILESET
from gs_codec.formats.attribute_steps import AttributeSteps
from gs_codec.formats.coordinates import turn_axes
from gs_codec.formats.extra_properties import left_out_of
from gs_codec.formats.gltf.compressed import pack_gltf_spz
from gs_codec.formats.packed_values import Clipped
from gs_codec.formats.tiles.earth import Place, check_place
from gs_codec.formats.tiles.tileset import Tile, describe_tiles
from gs_codec.levels.building import Level, build_levels
from gs_codec.levels.streaming import box_of, prepared, steps_of_levels
from gs_codec.runtime.threads import run_all, using_threads
from gs_codec.scene import Scene, stated_comments

#: Maximum number of Gaussians in a tile: 4.3 MB before compression.
TILE = 1 << 16


class Blocks(NamedTuple):
    """The coarser levels of a scene, the finest first, in blocks of at most `size` Gaussians.

    A block has the Gaussians that replace four blocks of the level before.
    """

    coarser: Sequence[Level]
    size: int


def tile_levels(
    scene: Scene,
    config: Config,
    at: Place | None = None,
    *,
    finest: bool = False,
    blocks: Blocks | None = None,
    most: int = TILE,
) -> tuple[dict[str, bytes | memoryview], tuple[str, ...]]:
    """The files of a scene as 3D Tiles, and sentences on what they cannot represent.

    Raises InvalidInput if there are no Gaussians, or if values are not finite and
    ``config.nonfinite`` is not ``drop``.

    Parameters
    ----------
    scene : Scene
    config : Config
        With profile ``l``, ``m`` or ``s``.
    at : tuple of three float, optional
        Longitude and latitude, degrees, and height, metres, of the origin. Default: none.
    finest : bool
        Whether to write the first level as finely as possible, whatever the profile.
    blocks : Blocks, optional
        Levels that the scene has, whose Gaussians are in their order. Default: they are made.
    most : int
        Maximum Gaussians of a tile, unless a block has more.

    Returns
    -------
    files : dict of str to bytes or memoryview
        Files by name, which may include a folder; `tileset.json` comes last.
    lost : tuple of str
    """
    if config.spz_version != Config.spz_version:
        raise InvalidInput(f"spz_version: {TILESET} has version {Config.spz_version}")
    place = None if at is None else check_place(at)
    with using_threads(config.threads, scene.count):
        clean, order, moved = prepared(scene, config, TILESET)
        lost = [TILES.rounding, *moved, *left_out_of(clean, TILES)]
        if not finest:
            lost[0] += f", or to the steps of profile {config.profile}"
        bare = replace(clean, extra={}, has_normals=False)
        if blocks is None or moved or clean.count != scene.count:
            bare, size = bare.take(order), min(config.block_size, most)
            blocks = Blocks(build_levels(bare, size), size)
        size = blocks.size
        levels = [Level(bare, np.zeros(-(-bare.count // size), np.float32)), *blocks.coarser]
        while FANOUT * size <= most:
            size *= FANOUT
        comments = stated_comments(None, clean.antialiased)
        del clean, order
        files: dict[str, bytes | memoryview] = {}
        tiles: list[list[Tile]] = []
        clipped: list[Clipped] = []
        coded = steps_of_levels((level.scene for level in levels), config)
        for number, (level, (whole, steps)) in enumerate(zip(levels, coded, strict=True)):
            wanted = AttributeSteps.least(whole) if finest and not number else steps
            packed = _packed(replace(whole, comments=comments), wanted, size, config.effort)
            names = [f"tiles/{number}/{k}.glb" for k in range(len(packed))]
            errors = np.maximum.reduceat(
                level.errors, range(0, len(level.errors), size // blocks.size)
            )
            tiles.append([])
            for name, error, (data, box, own) in zip(names, errors.tolist(), packed, strict=True):
                files[name] = data
                clipped.append(own)
                tiles[-1].append(Tile(name, box[:3], box[3:], error))
    lost += Clipped.sum(clipped).sentences()
    return files | {TILESET: describe_tiles(tiles, place)}, tuple(lost)


def _packed(
    scene: Scene, steps: AttributeSteps, size: int, effort: Effort
) -> list[tuple[bytes, NDArray[np.float64], Clipped]]:
    """Bytes, box in `TILES.system`, and numbers of clipped Gaussians of each tile of a level."""

    def pack(start: int) -> tuple[bytes, NDArray[np.float64], Clipped]:
        some, clipped = np.arange(start, min(start + size, scene.count)), Clipped()
        part = turn_axes(scene.take(some), TILES.system)
        middle = (part.positions.min(axis=1) + part.positions.max(axis=1)) / 2
        place = (TILES.system, middle.tolist())
        data, _ = pack_gltf_spz(part, steps.take(some), effort, clipped=clipped, place=place)
        return data, box_of(part).astype(np.float64), clipped

    return run_all(pack, range(0, scene.count, size))

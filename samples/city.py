"""A city of any size: tiles of scenes on a grid, written tile by tile.

    python samples/city.py city.ply --gaussians 100000000 bonsai.ply mouse.ply

Tiles alternate between the scenes, which must have the same SH degree. A tile is the middle of its
scene, without the outermost tenth, scaled to a common size. Its Gaussians are shuffled, and moved
by a thousandth of the size. Opacity changes too, so that no two tiles are equal.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from gs_codec.errors import InvalidInput
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import ply_header, vertex_rows
from gs_codec.runtime.atomic import atomic_writer
from gs_codec.scene import Scene

#: Share of a scene's Gaussians in a tile.
_MIDDLE = 0.9

#: Standard deviation of the shift of a Gaussian, relative to the size.
_MOVED = 1e-3

#: Standard deviation of the change of a Gaussian's opacity logit.
_FADED = 0.05


def middle_of(scene: Scene) -> Scene:
    """The middle of a scene, scaled to -1 to 1 on each axis."""
    centre = np.median(scene.positions, axis=1, keepdims=True)
    away = np.abs(scene.positions - centre).max(axis=0)
    reach = np.quantile(away, _MIDDLE)
    part = scene.take(away < reach)
    positions = ((part.positions - centre) / reach).astype(np.float32)
    log_scale = (part.log_scale - math.log(reach)).astype(np.float32)
    plain = replace(part, comments=(), extra={}, has_normals=False)
    return replace(plain, positions=positions, log_scale=log_scale)


def tiles(scenes: list[Scene], count: int) -> Iterator[Scene]:
    """Tiles with `count` Gaussians in total, row by row in a square."""
    rng = np.random.default_rng(0)
    mean = sum(scene.count for scene in scenes) / len(scenes)
    side = math.ceil(math.sqrt(count / mean))
    number = 0
    while count:
        scene = scenes[number % len(scenes)]
        scene = scene.take(rng.permutation(scene.count)[:count])
        place = np.array([[2.0 * (number % side)], [0.0], [2.0 * (number // side)]])
        moved = place + rng.normal(0, _MOVED, scene.positions.shape)
        faded = rng.normal(0, _FADED, scene.opacity.shape)
        yield replace(
            scene,
            positions=(scene.positions + moved).astype(np.float32),
            opacity=(scene.opacity + faded).astype(np.float32),
        )
        count -= scene.count
        number += 1


def main() -> None:
    """Write a city."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("target", type=Path, metavar="OUT", help="PLY to write")
    parser.add_argument("scenes", type=Path, nargs="+", metavar="SCENE", help="PLY of a tile")
    parser.add_argument("--gaussians", type=int, default=5_000_000, metavar="N")
    asked = parser.parse_args()
    if asked.target.exists():
        parser.error(f"{asked.target}: already exists; choose another name")
    try:
        scenes = [middle_of(read_ply(path, "drop")) for path in asked.scenes]
    except InvalidInput as error:
        parser.error(str(error))
    if len({scene.sh_degree for scene in scenes}) > 1:
        parser.error("scenes of several SH degrees, expected one")
    with atomic_writer(asked.target) as file:
        file.write(ply_header(scenes[0].between(0, 0), asked.gaussians))
        for tile in tiles(scenes, asked.gaussians):
            file.write(vertex_rows(tile).data)


if __name__ == "__main__":
    main()

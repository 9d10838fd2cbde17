"""Files with levels of detail, and damage to a level."""

from __future__ import annotations

import struct
from dataclasses import replace
from functools import cache

import numpy as np
from damage import with_section
from scenes import SmallBlocks, random_scene

from gs_codec.cameras.camera import Camera, facing
from gs_codec.codecs import encode_parts
from gs_codec.egs.egs_file import SectionId
from gs_codec.levels.adding import add_levels
from gs_codec.scene import GROUPS, Scene
from samples.generate import generate

#: Gaussians of a block, fewer than options allow.
BLOCK = 8


def encoded(scene: Scene, profile: str = "m", block: int = BLOCK, lod: bool = True) -> bytes:
    """A file with levels and small blocks."""
    config = SmallBlocks(profile, lod=lod, block_size=block)
    return b"".join(add_levels(*encode_parts(scene, config), config)[0])


@cache
def sample(count: int = 300, degree: int = 1, profile: str = "m") -> bytes:
    """A file of three levels."""
    return encoded(random_scene(count, degree, seed=330), profile)


def camera(place: tuple[float, ...], focal: float = 100.0, name: str = "seen") -> Camera:
    """A camera of 64 x 48 pixels that looks at the centre of the scenes."""
    position = np.array(place, np.float64)
    turn = facing(-position, np.array([0.0, -1.0, 0.2]))
    return Camera(name, 64, 48, focal, focal, 32.0, 24.0, turn, position)


#: Cameras that need fewer and fewer levels.
FAR, NEAR, AWAY = camera((9.0, 1.0, -4.0)), camera((1.5, 0.2, -1.0)), camera((0.1, 0.0, -300.0))


def in_level(data: bytes, change, level: int = 1) -> bytes:
    """The file with the bytes of a level changed, and its section's checksum corrected."""
    return with_section(data, SectionId.LEVEL, change, level)


def errors_changed(value: float):
    """A change of the first error of a level."""

    def change(level: bytes) -> bytes:
        return with_section(
            level, SectionId.ERRORS, lambda content: struct.pack("<f", value) + content[4:]
        )

    return change


#: Changes to a level of the sample that make it invalid.
NO_LEVELS = (
    lambda level: level[:-4],
    lambda level: level + bytes(4),
    lambda level: level[:50],
    lambda level: b"",
    lambda level: with_section(level, SectionId.ERRORS, lambda _: None),
    lambda level: with_section(level, SectionId.ERRORS, lambda content: content[4:]),
    lambda level: with_section(level, SectionId.COMMENTS, lambda _: b"a line"),
    lambda level: with_section(level, SectionId.LEVEL, lambda _: level, 1),
    lambda level: sample(299),
    lambda level: encoded(random_scene(300, 1, seed=330), lod=False),
)


@cache
def city(side: int = 3) -> bytes:
    """A file of `side` x `side` generated scenes side by side, in small blocks."""
    one = generate(3000, 1, 12)
    span = np.ptp(one.positions, axis=1)
    tiles = []
    for x in range(side):
        for z in range(side):
            moved = one.positions + np.array([[x * span[0]], [0], [z * span[2]]], np.float32)
            tiles.append(replace(one, positions=moved.astype(np.float32)))
    planes = {g: np.concatenate([getattr(tile, g) for tile in tiles], axis=1) for g in GROUPS}
    return encoded(Scene(**planes), "m", 512)

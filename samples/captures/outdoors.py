"""Outdoor places: a garden, a pasture, and a village seen from the air."""

from __future__ import annotations

import numpy as np

from samples.captures.place import Light, Place
from samples.shapes import blob, box, cylinder, join, knot, relief, roof, sphere
from samples.surfaces import Surface
from samples.textures import (
    Array,
    bricks,
    checker,
    leaves,
    marble,
    mix,
    mottled,
    rainbow,
    waves,
    wood,
)

_DAYLIGHT = (0.62, 0.72, 0.88)

#: Half the length of the village's land, in metres.
_LAND = 420.0

#: Half the length of the part with houses, in metres.
_BUILT = 110.0


def garden() -> Place:
    """A sculpture on a lawn, between a house, a shed, a hedge and trees; hills behind."""
    return _outside([*_furniture(), *_plants(), *surroundings(ground=0.0, hills=60.0)])


def pasture() -> Place:
    """The sculpture in the open: mountains at a hundred times its distance, the sky at 400."""
    rng = np.random.default_rng(5)
    mountains = []
    for seed, angle in enumerate(np.linspace(0, 2 * np.pi, 20)):
        away, high = rng.uniform(350, 1000), rng.uniform(60, 220)
        middle = (away * np.cos(angle), away * np.sin(angle), 0.0)
        mountains.append(blob(middle, (0.3 * away, 0.3 * away, high), 0.3, seed))
    rock = mottled((0.46, 0.48, 0.56), 0.012, 0.35)
    return _outside([Surface("mountains", join(mountains), rock), *surroundings(0.0, 330.0)])


def _outside(around: list[Surface]) -> Place:
    stone = mottled((0.66, 0.64, 0.60), 7.0, 0.16)
    veins = marble((0.86, 0.85, 0.82), (0.20, 0.34, 0.36))
    sculpture = knot() * 1.9 + np.array([[0.0], [0.0], [0.85]])
    surfaces = [
        Surface("plinth", box((0, 0, 0.42), (0.66, 0.66, 0.84), 0.3), stone, gloss=0.3),
        Surface("step", box((0, 0, 0.06), (1.3, 1.3, 0.12), 0.3), stone, gloss=0.3),
        Surface("sculpture", sculpture, rainbow, gloss=2.2),
        Surface("ball", sphere(0.24, (-0.95, -0.35, 0.24)), veins, gloss=2.0),
        *around,
    ]
    return Place(tuple(surfaces), (Light((40.0, -50.0, 70.0), 2.0, 1.0),), _DAYLIGHT)


def _furniture() -> list[Surface]:
    planks = wood((0.40, 0.28, 0.18), (0.60, 0.46, 0.30))
    wall = bricks(0.5, 0.22, (0.58, 0.27, 0.20), (0.72, 0.66, 0.60))
    bench = [
        box((2.1, 1.6, 0.45), (1.5, 0.45, 0.07)),
        box((2.1, 1.82, 0.8), (1.5, 0.06, 0.5)),
        *(box((x, 1.6, 0.21), (0.08, 0.4, 0.42)) for x in (1.5, 2.7)),
    ]
    panes = [box((-6.98, y, 1.7), (0.06, 1.1, 1.3)) for y in (0.0, 2.4, 5.0)]
    glass = marble((0.22, 0.36, 0.55), (0.82, 0.78, 0.66))
    return [
        Surface("bench", join(bench), planks, gloss=0.5),
        Surface("house", box((-9, 3, 2.2), (4, 9, 4.4)), wall, gloss=0.2),
        Surface("panes", join(panes), glass, gloss=3.0),
        Surface("shed", box((7.8, 2.5, 1.1), (2.4, 3, 2.2), 0.3), planks, gloss=0.2),
    ]


def _plants() -> list[Surface]:
    bark = wood((0.30, 0.22, 0.16), (0.46, 0.36, 0.26))
    clay = mottled((0.62, 0.32, 0.20), 8.0, 0.12)
    # Position, height of the crown's centre, and radius of each tree.
    trees = [
        (-5.5, 8.5, 2.9, 1.7),
        (3.9, 7.6, 2.6, 1.5),
        (8.5, 10.5, 3.4, 2.1),
        (-1.2, 12.0, 3.2, 1.9),
    ]
    crowns = [blob((x, y, z), (r, r, 0.9 * r), 0.35, i) for i, (x, y, z, r) in enumerate(trees)]
    trunks = [cylinder(0.16, z, (x, y, z / 2)) for x, y, z, _ in trees]
    bush = blob((-1.5, 0.8, 0.8), (0.42, 0.42, 0.45), 0.35, 7)
    return [
        Surface("pot", cylinder(0.28, 0.5, (-1.5, 0.8, 0.25)), clay),
        Surface("bush", bush, leaves((0.50, 0.25, 0.32)), gloss=0.3),
        Surface("hedge", box((0, 6.2, 0.7), (18, 0.8, 1.4)), leaves((0.17, 0.29, 0.11)), gloss=0.2),
        Surface("trunks", join(trunks), bark, gloss=0.1),
        Surface("crowns", join(crowns), leaves((0.23, 0.34, 0.13)), gloss=0.3),
    ]


def surroundings(ground: float, hills: float) -> list[Surface]:
    """A lawn at z = `ground`, a ring of distant hills, and the sky."""
    ring = cylinder(hills, 12.0, (0, 0, ground + 2), 96)
    side = np.ptp(ring[:, 2], axis=0) > 1
    land = box((0, 0, ground - 0.05), (2.2 * hills, 2.2 * hills, 0.1))
    return [
        Surface("lawn", land, _lawn, gloss=0.1),
        Surface("hills", ring[:, :, side], leaves((0.20, 0.29, 0.22), 0.35), gloss=0.1),
        Surface("sky", sphere(4 * hills, (0, 0, 0), 24), _sky, shines=True),
    ]


def _lawn(p: Array) -> Array:
    """Grass with worn patches, and a path of slabs."""
    tone = 1 + 0.22 * waves(p, 1.1) + 0.25 * waves(p, 9.0)
    slabs = checker(0.5, (0.62, 0.60, 0.55), (0.52, 0.50, 0.47))(p)
    path = (np.abs(p[0] - 0.8 * np.sin(0.5 * p[1]) + 1.6) < 0.5) & (np.abs(p[1]) < 12)
    return np.where(path, slabs, np.multiply.outer((0.32, 0.41, 0.18), tone))


def _sky(p: Array) -> Array:
    """Blue, paler at the horizon, with clouds."""
    direction = p / np.sqrt((p**2).sum(axis=0))
    rgb = mix((0.80, 0.86, 0.92), (0.34, 0.54, 0.84), np.clip(1.5 * direction[2], 0, 1))
    cloud = np.clip(1.4 * waves(direction * [[1], [1], [2.2]], 3.3) - 0.15, 0, 0.8)
    return rgb * (1 - cloud) + 0.95 * cloud


def village() -> Place:
    """Rolling fields with a road, houses and trees."""
    rng = np.random.default_rng(11)
    walls, roofs = _houses(rng)
    at = np.linspace(-_LAND, _LAND, 169)
    land = relief(_height(at[:, None], at[None, :]), _LAND)
    plaster = bricks(3.1, 2.6, (0.80, 0.76, 0.68), (0.42, 0.44, 0.50))
    tiles = bricks(1.1, 0.9, (0.52, 0.29, 0.21), (0.42, 0.24, 0.18))
    slate = bricks(1.3, 1.0, (0.40, 0.41, 0.45), (0.31, 0.32, 0.36))
    surfaces = [
        Surface("land", land, _fields, gloss=0.1),
        Surface("walls", join(walls), plaster, gloss=0.4),
        Surface("red roofs", join(roofs[::2]), tiles, gloss=0.7),
        Surface("grey roofs", join(roofs[1::2]), slate, gloss=1.5),
        Surface("trees", join(_trees(rng)), leaves((0.20, 0.28, 0.13), 1.6), gloss=0.2),
        Surface("sky", sphere(900.0, (0, 0, 0), 24), _sky, shines=True),
    ]
    return Place(tuple(surfaces), (Light((250.0, -300.0, 420.0), 4.0, 1.0),), _DAYLIGHT)


def _houses(rng: np.random.Generator) -> tuple[list[Array], list[Array]]:
    walls, roofs = [], []
    for _ in range(80):
        x, y = rng.uniform(-_BUILT, _BUILT, 2)
        length, width, high = rng.uniform((8, 6, 4), (18, 10, 9))
        # Parallel to the road near it, otherwise perpendicular.
        turn = rng.normal(0.3, 0.1) + (np.pi / 2 if abs(y - _road(x)) > 30 else 0)
        if abs(y - _road(x)) > 11:
            base = float(_height(x, y)) - 1
            walls.append(box((x, y, base + high / 2), (length, width, high), turn))
            roofs.append(roof((x, y, base + high), length, width, turn))
    return walls, roofs


def _trees(rng: np.random.Generator) -> list[Array]:
    trees = []
    for seed in range(170):
        x, y = rng.uniform(-1.4 * _BUILT, 1.4 * _BUILT, 2)
        r = rng.uniform(1.5, 4.0)
        if abs(y - _road(x)) > 5:
            middle = (x, y, float(_height(x, y)) + 1.1 * r)
            trees.append(blob(middle, (r, r, 1.3 * r), 0.3, seed, 10))
    return trees


def _road(x: Array | float) -> Array:
    """Northing of the road at an easting."""
    return 18 * np.sin(np.asarray(x) / 45)


def _height(x: Array | float, y: Array | float) -> Array:
    """Height of the terrain."""
    x, y = np.asarray(x), np.asarray(y)
    return 5 * np.sin(x / 37 + 0.4) * np.cos(y / 51) + 3 * np.sin((x + y) / 23)


def _fields(p: Array) -> Array:
    """Crops of different colours, ploughed in lines, with hedges and a road between."""
    u, v = (p[0] + 0.3 * p[1]) / 38, (p[1] - 0.2 * p[0]) / 29
    kind = np.sin(12.9 * np.floor(u) + 78.2 * np.floor(v)) * 43758.5 % 1
    line = np.where(kind > 0.5, np.sin(1.6 * p[0]), np.sin(1.1 * p[1] + 0.5 * p[0]))
    tone = 1 + 0.07 * line + 0.14 * waves(p[[1, 0, 2]], 0.13) + 0.12 * waves(p, 0.9)
    rgb = mix((0.33, 0.38, 0.22), (0.62, 0.55, 0.38), kind) * tone
    rgb[:, np.minimum(u % 1, v % 1) < 0.03] *= 0.55
    apart = np.abs(p[1] - _road(p[0]))
    asphalt = np.where(apart < 0.25, 0.85, 0.42) * (1 + 0.06 * waves(p, 1.0))
    return np.where(apart < 3.2, asphalt, rgb)

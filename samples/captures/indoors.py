"""Indoor places: the table of the still life, a bench in front of a window, and a flat."""

from __future__ import annotations

import numpy as np

from samples.captures.outdoors import surroundings
from samples.captures.place import Light, Place
from samples.shapes import blob, box, cylinder, join, sphere, torus
from samples.surfaces import Surface, still_life
from samples.textures import (
    Array,
    checker,
    leaves,
    marble,
    mix,
    mottled,
    rainbow,
    stripes,
    waves,
    wood,
)

_OAK = wood((0.46, 0.30, 0.17), (0.66, 0.48, 0.30))
_BLUE = marble((0.22, 0.36, 0.55), (0.82, 0.78, 0.66))
_WHITE = marble((0.86, 0.85, 0.82), (0.20, 0.34, 0.36))
_FERN = leaves((0.16, 0.33, 0.13))
_CLAY = mottled((0.62, 0.30, 0.18), 9.0, 0.10)


def table_room() -> Place:
    """The still life, in its room with a ceiling, pictures, a window, a shelf and a chair."""
    plaster = mottled((0.80, 0.78, 0.74), 1.3, 0.06)
    cloth = mottled((0.35, 0.15, 0.12), 9.0, 0.2)
    surfaces = [
        *still_life().surfaces,
        Surface("ceiling", box((0, 0, 2.04), (9, 9, 0.08)), plaster, gloss=0.1),
        Surface("picture", box((-4.45, 1.0, 0.9), (0.06, 1.8, 1.2)), rainbow),
        Surface("picture", box((1.2, 4.45, 0.8), (2.2, 0.06, 1.1)), _BLUE),
        Surface("window", box((4.46, -0.5, 0.9), (0.04, 2.0, 1.3)), _window, shines=True),
        Surface("shelf", box((-1.8, -4.2, -0.1), (2.4, 0.5, 1.8)), _books, gloss=0.3),
        Surface("chair", box((-2.9, -2.2, -0.6), (0.7, 0.7, 0.8), 0.4), cloth, gloss=0.3),
        Surface("plant", blob((3.2, 2.9, 0.0), (0.5, 0.5, 0.7), 0.25, 1), _FERN, gloss=0.5),
    ]
    return Place(tuple(surfaces), (Light((1.6, -1.2, 1.8), reach=4.0),))


def window_bench() -> Place:
    """The objects of the still life on a bench in front of a window, with trees outside."""
    left = {"floor", "walls", "table", "legs"}
    objects = [surface for surface in still_life().surfaces if surface.name not in left]
    planks = wood((0.42, 0.26, 0.14), (0.62, 0.42, 0.25))
    pots = [cylinder(0.17, 0.25, (-1.55, 0.75, 0.1)), cylinder(0.15, 0.2, (1.75, 0.9, 0.1))]
    ferns = [
        blob((-1.55, 0.75, 0.42), (0.30, 0.30, 0.34), 0.35, 5),
        blob((1.75, 0.90, 0.50), (0.26, 0.26, 0.44), 0.40, 9),
    ]
    trees = [
        blob((-1.0, 9.0, 1.6), (1.6, 1.4, 1.7), 0.3, 2),
        blob((3.6, 14.0, 2.4), (2.0, 2.0, 2.6), 0.3, 3),
    ]
    surfaces = [
        *objects,
        *_window_room(),
        Surface("bench", box((0, 0.3, -0.06), (4.4, 2.2, 0.12)), planks, gloss=0.8),
        Surface("picture", box((-1.35, 1.58, 0.95), (0.9, 0.05, 0.7)), rainbow),
        Surface("pots", join(pots), _CLAY, gloss=0.4),
        Surface("ferns", join(ferns), _FERN, gloss=0.5),
        Surface("trees", join(trees), leaves((0.20, 0.32, 0.12)), gloss=0.3),
        *surroundings(ground=-1.2, hills=30.0),
    ]
    lamp, sun = Light((-1.4, -1.9, 2.2), reach=6.0), Light((-20.0, -30.0, 45.0), 1.0, 1.0)
    return Place(tuple(surfaces), (lamp, sun))


def _window_room() -> list[Surface]:
    """Walls; the window is from x = -0.4 to 1.3 and from z = 0.35 to 1.5, at y = 1.7."""
    paper = stripes(lambda p: p[0] + 0.1 * p[2], 0.45, (0.66, 0.60, 0.50), (0.72, 0.67, 0.58))
    wall = [
        box((-2.2, 1.7, 0.7), (3.6, 0.2, 3.6)),
        box((2.8, 1.7, 0.7), (3.0, 0.2, 3.6)),
        box((0.45, 1.7, -0.375), (1.7, 0.2, 1.45)),
        box((0.45, 1.7, 2.0), (1.7, 0.2, 1.0)),
    ]
    bars = [
        box((0.45, 1.65, 0.925), (0.06, 0.08, 1.15)),
        box((0.45, 1.65, 0.925), (1.7, 0.08, 0.05)),
    ]
    sides = [box((x, 0, 0.7), (0.2, 7, 3.6)) for x in (-3.9, 3.9)]
    tiles = checker(0.5, (0.50, 0.30, 0.20), (0.60, 0.50, 0.40))
    return [
        Surface("wall", join(wall), paper, gloss=0.2),
        Surface("bars", join(bars), mottled((0.86, 0.85, 0.82), 5.0, 0.04), gloss=0.6),
        Surface("sides", join(sides), mottled((0.70, 0.66, 0.62), 2.0, 0.06), gloss=0.2),
        Surface("ceiling", box((0, 0, 2.5), (8, 7, 0.1)), mottled((0.8, 0.78, 0.74), 2.0, 0.05)),
        Surface("floor", box((0, -1.6, -1.1), (8, 5, 0.1)), tiles),
    ]


def flat() -> Place:
    """Two furnished rooms with a door between them: x from 0 to 10, y from 0 to 4."""
    lamps = [sphere(0.16, (x, 2.0, 2.25)) for x in (2.5, 7.4)]
    surfaces = [
        *_flat_walls(),
        *_living_room(),
        *_bedroom(),
        Surface("lamps", join(lamps), lambda p: np.full_like(p, 0.97), shines=True),
    ]
    # Lights are below the lamps, which would shade the rooms from inside.
    lights = tuple(Light((x, 2.0, 1.85), reach=2.4) for x in (2.5, 7.4))
    return Place(tuple(surfaces), lights)


def _flat_walls() -> list[Surface]:
    paper = stripes(lambda p: p[0] + p[1], 0.62, (0.70, 0.72, 0.66), (0.75, 0.77, 0.72))
    plaster = mottled((0.85, 0.84, 0.80), 1.4, 0.05)
    red = stripes(lambda p: p[0], 0.1, (0.62, 0.28, 0.22), (0.74, 0.40, 0.30))
    walls = [
        *(box((5, y, 1.3), (10.2, 0.1, 2.8)) for y in (-0.05, 4.05)),
        *(box((x, 2, 1.3), (0.1, 4.2, 2.8)) for x in (-0.05, 10.05)),
        box((5, 0.75, 1.3), (0.12, 1.5, 2.8)),
        box((5, 3.3, 1.3), (0.12, 1.4, 2.8)),
        box((5, 2.05, 2.4), (0.12, 1.2, 0.6)),
    ]
    windows = [box((1.2, 0.02, 1.5), (1.4, 0.06, 1.2)), box((7.6, 0.02, 1.5), (1.8, 0.06, 1.2))]
    curtains = [box((x, 0.08, 1.4), (0.3, 0.08, 1.9)) for x in (0.3, 2.1, 6.5, 8.7)]
    return [
        Surface("walls", join(walls), paper, gloss=0.2),
        Surface("floor", box((5, 2, -0.05), (10.2, 4.2, 0.1)), _parquet),
        Surface("ceiling", box((5, 2, 2.65), (10.2, 4.2, 0.1)), plaster, gloss=0.1),
        Surface("windows", join(windows), _window, shines=True),
        Surface("curtains", join(curtains), red, gloss=0.2),
    ]


def _living_room() -> list[Surface]:
    sofa = [
        box((1.3, 3.5, 0.22), (2.0, 0.8, 0.44)),
        box((1.3, 3.82, 0.6), (2.0, 0.2, 0.5)),
        *(box((x, 3.5, 0.4), (0.18, 0.8, 0.5)) for x in (0.35, 2.25)),
    ]
    cushions = [
        box((x, 3.61, 0.58), (0.4, 0.16, 0.36), turn) for x, turn in ((0.8, 0.2), (1.8, -0.3))
    ]
    legs = [(2.4 + x, 1.9 + y) for x in (-0.48, 0.48) for y in (-0.28, 0.28)]
    table = [
        box((2.4, 1.9, 0.44), (1.1, 0.7, 0.05)),
        *(box((x, y, 0.21), (0.06, 0.06, 0.42)) for x, y in legs),
    ]
    pattern = stripes(
        lambda p: p[0] + 0.4 * np.abs(p[1] - 2.1), 0.42, (0.62, 0.20, 0.18), (0.80, 0.72, 0.58)
    )
    glaze = marble((0.90, 0.45, 0.12), (0.60, 0.22, 0.08))
    pictures = [box((0.03, 1.9, 1.5), (0.06, 1.3, 0.9)), box((3.6, 3.97, 1.5), (1.0, 0.06, 0.7))]
    return [
        Surface("sofa", join(sofa), mottled((0.30, 0.36, 0.48), 11.0, 0.16), gloss=0.2),
        Surface("cushions", join(cushions), rainbow, gloss=0.3),
        Surface("rug", box((2.2, 2.1, 0.012), (2.6, 1.9, 0.024)), pattern, gloss=0.1),
        Surface("table", join(table), _OAK, gloss=0.9),
        Surface("vase", sphere(0.14, (2.3, 1.9, 0.6)), _WHITE, gloss=2.2),
        Surface("bowl", torus(0.13, 0.05, (2.7, 2.0, 0.52)), glaze, gloss=1.6),
        Surface("shelf", box((3.9, 0.22, 0.9), (1.3, 0.4, 1.8)), _books, gloss=0.4),
        Surface("pictures", join(pictures), rainbow),
        Surface("plant", blob((4.4, 3.5, 0.9), (0.34, 0.34, 0.5), 0.35, 4), _FERN, gloss=0.5),
        Surface("pot", cylinder(0.18, 0.42, (4.4, 3.5, 0.21)), _CLAY, gloss=0.4),
    ]


def _bedroom() -> list[Surface]:
    desk = [
        box((6.2, 3.6, 0.74), (1.5, 0.7, 0.05)),
        *(box((x, 3.6, 0.36), (0.06, 0.6, 0.72)) for x in (5.5, 6.9)),
    ]
    chair = [
        box((6.2, 2.95, 0.45), (0.5, 0.5, 0.08), 0.3),
        box((6.26, 2.72, 0.8), (0.5, 0.06, 0.5), 0.3),
        cylinder(0.06, 0.42, (6.2, 2.95, 0.21)),
    ]
    bed = [box((8.7, 3.2, 0.25), (2.1, 1.5, 0.5)), box((9.85, 3.2, 0.6), (0.1, 1.5, 1.0))]
    quilt = checker(0.33, (0.80, 0.78, 0.74), (0.34, 0.46, 0.56))
    dice = checker(0.1, (0.93, 0.78, 0.22), (0.22, 0.20, 0.24), 0.4)
    pictures = [box((9.97, 2.9, 1.5), (0.06, 0.9, 1.1)), box((4.92, 3.3, 1.5), (0.06, 0.7, 0.9))]
    return [
        Surface("desk", join(desk), _OAK, gloss=0.9),
        Surface("screen", box((6.2, 3.72, 1.05), (0.8, 0.04, 0.5)), _BLUE, gloss=2.0),
        Surface("chair", join(chair), mottled((0.16, 0.17, 0.20), 9.0, 0.2), gloss=0.6),
        Surface("bed", join(bed), quilt, gloss=0.1),
        Surface("chest", box((7.9, 0.35, 0.4), (1.2, 0.45, 0.8)), _OAK, gloss=0.7),
        Surface("cube", box((7.7, 0.35, 0.95), (0.3, 0.3, 0.3), 0.4), dice),
        Surface("shelf", box((9.8, 0.9, 1.0), (0.36, 1.5, 2.0)), _books, gloss=0.4),
        Surface("pictures", join(pictures), _BLUE),
        Surface("plant", blob((9.4, 2.0, 0.8), (0.3, 0.3, 0.4), 0.35, 6), _FERN, gloss=0.5),
        Surface("pot", cylinder(0.16, 0.42, (9.4, 2.0, 0.21)), _CLAY, gloss=0.4),
    ]


def corridor() -> Place:
    """A corridor along x, from 0 to 20, with doors, notices, benches and a window at its end."""
    doors = [box((x, y, 1.05), (0.95, 0.06, 2.1)) for x in (2.5, 7, 11, 15.5) for y in (-1.1, 1.1)]
    notices = [box((x, y, 1.5), (1.3, 0.04, 0.8)) for x in (4.7, 13.2) for y in (-1.09, 1.09)]
    benches = [box((x, y, 0.45), (1.5, 0.36, 0.07)) for x, y in ((5, 0.85), (9, -0.85), (13, 0.85))]
    plants = [blob((x, y, 0.8), (0.25, 0.25, 0.45), 0.3, 2) for x, y in ((8.2, 0.8), (17, -0.7))]
    pots = [cylinder(0.16, 0.42, (x, y, 0.21)) for x, y in ((8.2, 0.8), (17, -0.7))]
    stains = stripes(lambda p: p[0], 1.7, (0.74, 0.72, 0.64), (0.68, 0.70, 0.64))
    tiles = checker(0.4, (0.50, 0.46, 0.42), (0.66, 0.64, 0.58))
    red = mottled((0.48, 0.20, 0.14), 5.0, 0.15)
    surfaces = [
        Surface("walls", box((10, 0, 1.3), (20, 2.24, 2.7)), stains, gloss=0.2),
        Surface("floor", box((10, 0, -0.05), (20, 2.24, 0.1)), tiles, gloss=0.8),
        Surface("window", box((19.9, 0, 1.4), (0.1, 1.4, 1.5)), _window, shines=True),
        Surface("doors", join(doors), _OAK, gloss=0.7),
        Surface("notices", join(notices), lambda p: rainbow(3 * p), gloss=0.3),
        Surface("benches", join(benches), red, gloss=0.5),
        Surface("plants", join(plants), _FERN, gloss=0.5),
        Surface("pots", join(pots), _CLAY, gloss=0.4),
    ]
    return Place(tuple(surfaces), tuple(Light((x, 0, 2.5), reach=2.6) for x in (3, 8, 13, 18)))


def _parquet(p: Array) -> Array:
    """Boards of different tones along x."""
    row = np.floor(p[1] / 0.16)
    board = np.floor((p[0] + 0.37 * row) / 0.9)
    tone = 0.85 + 0.22 * np.sin(5.3 * row + 2.9 * board) + 0.06 * waves(p * [[1], [9], [1]], 6.0)
    return np.multiply.outer((0.60, 0.43, 0.28), tone)


def _books(p: Array) -> Array:
    """Rows of coloured book spines."""
    row = np.floor(p[2] / 0.31)
    hue = 2.4 * np.floor((p[0] + p[1]) / 0.075 + 0.3 * row) + 1.7 * row
    backs = 0.40 + 0.20 * np.cos(hue + np.array([[0.0], [0.9], [2.2]]))
    return np.where(p[2] / 0.31 % 1 < 0.14, np.array([[0.36], [0.25], [0.16]]), backs)


def _window(p: Array) -> Array:
    """A bright view, too far away for parallax, and bars."""
    share = 1 / (1 + np.exp(-9 * (p[2] - 1.2)))
    bars = np.abs(np.sin(4.2 * (p[0] + p[1]))) < 0.06
    rgb = mix((0.50, 0.62, 0.45), (0.86, 0.92, 0.98), share)
    return rgb * (1 + 0.12 * waves(p, 3.0)) * np.where(bars, 0.5, 1.0)

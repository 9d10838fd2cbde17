"""Places with one object: a fox's head on a papered wall, and a sculpture on a turntable."""

from __future__ import annotations

import numpy as np

from samples.captures.place import Light, Place
from samples.shapes import blob, box, cylinder, join, knot, sphere
from samples.surfaces import Surface
from samples.textures import Array, checker, leaves, marble, mix, mottled, rainbow, stripes, wood


def papered_wall() -> Place:
    """A stuffed head on a shield at y = 0, with pictures; it looks towards -y."""
    ears = [blob((x, -0.22, 0.24), (0.05, 0.025, 0.10), 0.1, 3) for x in (-0.09, 0.09)]
    head = [
        blob((0, -0.13, -0.07), (0.12, 0.15, 0.20), 0.12, 1),
        blob((0, -0.26, 0.08), (0.12, 0.14, 0.12), 0.12, 2),
        blob((0, -0.42, 0.04), (0.05, 0.11, 0.05), 0.08, 4),
    ]
    frames = [
        box((-0.62, -0.02, 0.42), (0.46, 0.04, 0.6)),
        box((0.66, -0.02, -0.2), (0.4, 0.04, 0.5)),
    ]
    pictures = [
        box((-0.62, -0.045, 0.42), (0.36, 0.01, 0.5)),
        box((0.66, -0.045, -0.2), (0.3, 0.01, 0.4)),
    ]
    surfaces = [
        Surface("room", box((0, -3, 0), (8, 6, 8)), _roses, gloss=0.2),
        Surface(
            "shield",
            box((0, -0.02, -0.06), (0.34, 0.05, 0.52)),
            wood((0.2, 0.1, 0.06), (0.34, 0.2, 0.12)),
            gloss=1.2,
        ),
        Surface("head", join(head), leaves((0.66, 0.36, 0.16), 24.0), gloss=0.2),
        Surface("ears", join(ears), leaves((0.42, 0.24, 0.14), 24.0), gloss=0.2),
        Surface(
            "eyes",
            join([sphere(0.018, (x, -0.375, 0.11), 16) for x in (-0.055, 0.055)]),
            mottled((0.1, 0.07, 0.03), 9, 0.1),
            gloss=3.0,
        ),
        Surface(
            "frames",
            join(frames),
            stripes(lambda p: p[0] + p[2], 0.05, (0.5, 0.38, 0.2), (0.3, 0.2, 0.1)),
            gloss=1.5,
        ),
        Surface("pictures", join(pictures), lambda p: rainbow(4 * p), gloss=1.0),
    ]
    return Place(tuple(surfaces), (Light((1.4, -2.2, 1.1), 0.15, reach=3.0),))


def turntable() -> Place:
    """A sculpture and blocks on a disc in front of a plain backdrop."""
    disc = wood((0.36, 0.24, 0.15), (0.62, 0.47, 0.3))
    veins = marble((0.86, 0.85, 0.82), (0.20, 0.34, 0.36))
    surfaces = [
        Surface(
            "backdrop", sphere(3.0, (0, 0, 0), 24), lambda p: np.full_like(p, 0.72), shines=True
        ),
        Surface("disc", cylinder(0.42, 0.04, (0, 0, -0.02), 64), disc, gloss=0.6),
        Surface("plinth", cylinder(0.17, 0.1, (0, 0, 0.05)), veins, gloss=1.5),
        Surface("sculpture", 0.46 * knot() + np.array([[0.0], [-0.14], [0.1]]), rainbow, gloss=2.2),
        Surface(
            "block",
            box((0.25, -0.12, 0.05), (0.1, 0.1, 0.1), 0.4),
            checker(0.034, (0.93, 0.78, 0.22), (0.22, 0.20, 0.24), 0.4),
        ),
        Surface("ball", sphere(0.06, (-0.24, -0.16, 0.06)), veins, gloss=2.0),
    ]
    return Place(tuple(surfaces), (Light((0.8, -1.2, 1.9), 0.2, reach=3.0),))


def _roses(p: Array) -> Array:
    """Wallpaper with roses of uneven size and tone."""
    u, v = (p[0] + p[1]) / 0.21, p[2] / 0.21
    column = np.floor(u)
    v = v + 0.5 * (column % 2)
    kind = np.sin(12.9 * column + 78.2 * np.floor(v)) * 43758.5 % 1
    x, y = u % 1 - 0.5, v % 1 - 0.5
    r = np.hypot(x, y) / (0.26 + 0.2 * kind)
    petals = 0.5 + 0.5 * np.cos(5 * np.arctan2(y, x) + 11 * r + 6 * kind)
    rose = mix((0.86, 0.62, 0.55), (0.72, 0.16, 0.30), kind) * (0.7 + 0.4 * petals)
    stalk = np.abs(x - 0.1 * np.sin(6 * v)) < 0.02
    paper = np.where(stalk, np.array([[0.62], [0.55], [0.36]]), np.array([[0.88], [0.83], [0.77]]))
    return np.where(r < 1, rose, paper)

"""Coordinate systems by where x, y and z point: ``RDF`` is right, down, forward.

Scenes in PLY files are ``RDF`` by convention (the trainer's, COLMAP's), and so is every scene that
states no other system.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gs_codec.errors import InvalidInput
from gs_codec.scene import Scene, coordinates_comment, coordinates_of

#: The system of a scene that states none.
CONVENTION = "RDF"

#: Systems of formats that have one of their own, by their suffix.
OWN_SYSTEMS = {".spz": "RUB", ".glb": "LUF", ".gltf": "LUF"}

#: Letters of x, of y and of z: the negative direction, then the positive one.
_LETTERS = ("LR", "DU", "BF")

#: Axes that each SH-AC basis function is odd in, in the order of the coefficients.
_ODD = ("y", "z", "x", "xy", "yz", "", "xz", "", "y", "xyz", "y", "z", "x", "z", "x")

_A, _B, _C, _D = math.sqrt(3) / 2, math.sqrt(5 / 8), math.sqrt(3 / 8), math.sqrt(15) / 4

#: Each SH-AC coefficient after y and z are swapped, as a weighted sum of those before.
_SWAPPED: tuple[dict[int, float], ...] = (
    *({1: -1.0}, {0: -1.0}, {2: 1.0}),
    *({6: -1.0}, {4: 1.0}, {5: -0.5, 7: -_A}, {3: -1.0}, {5: -_A, 7: 0.5}),
    *({11: _B, 13: -_C}, {9: 1.0}, {11: _C, 13: _B}, {8: _B, 10: _C}),
    *({12: -0.25, 14: -_D}, {8: -_C, 10: _B}, {12: -_D, 14: 0.25}),
)


def system_of(scene: Scene) -> str:
    """The coordinate system a scene states, else the convention's."""
    return scene.coordinates or CONVENTION


def turn_axes(scene: Scene, system: str = CONVENTION) -> Scene:
    """Convert a scene to another coordinate system, and add the comment that names it.

    If only signs differ, as between ``RUB`` and ``RDF``, every number stays exact; if y and z are
    swapped, SH of degree 2 and 3 are rounded once.

    Parameters
    ----------
    scene : Scene
        In the system it states, else in ``RDF``.
    system : str
        Three letters for x, y and z: L or R first, then one of U or D and one of F or B.

    Returns
    -------
    Scene
        The same object if it is in that system already.

    Raises
    ------
    InvalidInput
        If `system` is not a coordinate system.
    """
    source = system_of(scene)
    upright, target = _ordered(source), _ordered(system)
    if source == system:
        return scene
    if upright != source:
        scene = _swapped(scene)
    scene = _mirrored(
        scene, [1.0 if a == b else -1.0 for a, b in zip(upright, target, strict=True)]
    )
    if target != system:
        scene = _swapped(scene)
    return state_system(scene, system)


def state_system(scene: Scene, system: str) -> Scene:
    """The scene with a comment that names its system, and the same numbers; see `turn_axes`."""
    _ordered(system)
    kept = tuple(line for line in scene.comments if coordinates_of([line]) is None)
    return replace(scene, comments=(*kept, coordinates_comment(system)))


def _ordered(system: str) -> str:
    """The system, with y and z swapped if up or down is not second."""
    for letters in (system, system[:1] + system[:0:-1]):
        if len(letters) == 3 and all(c in p for c, p in zip(letters, _LETTERS, strict=True)):
            return letters
    raise InvalidInput(f"coordinates {system!a:.20}, expected such as RDF, RUB or LUF")


def _mirrored(scene: Scene, signs: list[float]) -> Scene:
    x, y, z = signs
    by_axis = dict(zip("xyz", signs, strict=True))
    odd = [math.prod(by_axis[axis] for axis in axes) for axes in _ODD]
    return replace(
        scene,
        positions=_signed(scene.positions, [x, y, z]),
        # The axis of a rotation is mirrored as a pseudovector.
        rot=_signed(scene.rot, [1, y * z, x * z, x * y]),
        f_rest=_signed(scene.f_rest, odd[: len(scene.f_rest) // 3] * 3),
    )


def _swapped(scene: Scene) -> Scene:
    """The scene with y and z swapped."""
    count = len(scene.f_rest) // 3
    f_rest = np.empty_like(scene.f_rest)
    for start in range(0, 3 * count, max(count, 1)):
        for to, weights in enumerate(_SWAPPED[:count]):
            terms = [np.float64(w) * scene.f_rest[start + k] for k, w in weights.items()]
            f_rest[start + to] = sum(terms)
    return replace(
        scene,
        positions=scene.positions[[0, 2, 1]],
        log_scale=scene.log_scale[[0, 2, 1]],
        rot=_signed(scene.rot[[0, 1, 3, 2]], [1, -1, -1, -1]),
        f_rest=f_rest,
    )


def _signed(planes: np.ndarray, signs: list[float]) -> np.ndarray:
    signed = planes.copy()
    for row, sign in zip(signed, signs, strict=True):
        if sign < 0:
            np.negative(row, out=row)
    return signed

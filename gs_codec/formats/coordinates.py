"""Coordinate systems by the directions of x, y and z: ``RDF`` is right, down, forward.

Scenes in PLY files are ``RDF`` by convention (the trainer's, COLMAP's), and so is every scene that
states no other system.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.formats.similarity import move_scene
from gs_codec.scene import Scene, Shift, coordinates_comment, coordinates_of, offset_of, with_offset

#: The system of a scene that states none.
CONVENTION = "RDF"

#: Letters of opposite directions, along right, up and forward.
_LETTERS = ("LR", "DU", "BF")


def system_of(scene: Scene) -> str:
    """The coordinate system that a scene states, else the convention's."""
    return scene.coordinates or CONVENTION


def turn_axes(scene: Scene, system: str = CONVENTION) -> Scene:
    """Convert a scene to another coordinate system, and add the comment that names it.

    If only signs differ, as between ``RUB`` and ``RDF``, every number stays exact; if y and z are
    swapped, SH of degree 2 and 3 are rounded once; see `move_scene`. Raises InvalidInput if
    `system` is not a coordinate system.

    Parameters
    ----------
    scene : Scene
        A scene in the system that it states, else in ``RDF``.
    system : str
        Three letters for x, y and z: L or R first, then one of U or D and one of F or B.

    Returns
    -------
    Scene
        The same object if it is already in that system.
    """
    turn = _turn(system_of(scene), system)
    if np.array_equal(turn, np.eye(3)):
        return scene
    matrix = np.eye(4)
    matrix[:3, :3] = turn
    moved, offset = move_scene(scene, matrix), offset_of(scene.comments)
    if offset is not None:
        moved = replace(moved, comments=with_offset(moved.comments, turn @ offset))
    return state_system(moved, system)


def turn_shift(shift: Shift, before: str, after: str) -> Shift:
    """A translation in the axes of another system; see `turn_axes`."""
    x, y, z = (_turn(before, after) @ shift).tolist()
    return x, y, z


def state_system(scene: Scene, system: str) -> Scene:
    """Add a comment that names a scene's system, without changing numbers; see `turn_axes`."""
    _axes(system)
    kept = tuple(line for line in scene.comments if coordinates_of([line]) is None)
    return replace(scene, comments=(*kept, coordinates_comment(system)))


def _turn(before: str, after: str) -> NDArray[np.float64]:
    """The matrix that converts coordinates from one system to another."""
    return _axes(after) @ _axes(before).T


def _axes(system: str) -> NDArray[np.float64]:
    """Directions of x, y and z of a system (rows), in terms of right, up and forward."""
    places = [next((k for k, pair in enumerate(_LETTERS) if c in pair), -1) for c in system]
    if places not in ([0, 1, 2], [0, 2, 1]):
        raise InvalidInput(f"coordinates {system!a:.20}, expected for example RDF, RUB or LUF")
    axes = np.zeros((3, 3))
    axes[range(3), places] = [
        2 * _LETTERS[k].index(c) - 1 for k, c in zip(places, system, strict=True)
    ]
    return axes

"""Coordinate systems that differ in the signs of their axes, as ``RDF`` and ``RUB`` do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gs_codec.errors import InvalidInput
from gs_codec.scene import Scene, coordinates_comment, is_coordinates_comment

#: Of x, y, z: the letter of each of a system whose sign is minus, and the other.
_LETTERS = ("LR", "DU", "BF")

#: Axes that each SH-AC basis function is odd in, in the order of the coefficients.
_ODD = ("y", "z", "x", "xy", "yz", "", "xz", "", "y", "xyz", "y", "z", "x", "z", "x")


def turn_axes(scene: Scene, system: str) -> Scene:
    """The scene in another coordinate system, with the comment that says so.

    Raises
    ------
    InvalidInput
        If the scene does not state its own, or one of the two has other axes than right or left,
        up or down, forward or back.
    """
    if scene.coordinates is None:
        raise InvalidInput(f"coordinates: the scene states no system, cannot be made {system}")
    signs = {
        axis: 1.0 if a == b else -1.0
        for axis, a, b in zip("xyz", _axes(scene.coordinates), _axes(system), strict=True)
    }
    x, y, z = signs.values()
    odd = [float(np.prod([signs[axis] for axis in axes])) for axes in _ODD]
    kept = tuple(line for line in scene.comments if not is_coordinates_comment(line))
    return replace(
        scene,
        positions=_signed(scene.positions, [x, y, z]),
        # The axis of a rotation is mirrored as a pseudovector.
        rot=_signed(scene.rot, [1, y * z, x * z, x * y]),
        f_rest=_signed(scene.f_rest, odd[: len(scene.f_rest) // 3] * 3),
        comments=(*kept, coordinates_comment(system)),
    )


def _axes(system: str) -> str:
    known = len(system) == 3 and all(c in pair for c, pair in zip(system, _LETTERS, strict=True))
    if not known:
        raise InvalidInput(f"coordinates {system!a:.20}, expected such as RDF, RUB or LUF")
    return system


def _signed(planes: np.ndarray, signs: list[float]) -> np.ndarray:
    return planes * np.array(signs, np.float32).reshape(-1, 1)

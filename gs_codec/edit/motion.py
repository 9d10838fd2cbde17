"""Scenes moved: shifted, turned, scaled, by a matrix; shapes and SH follow."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gs_codec.codecs.matching import without_order
from gs_codec.edit.clouds import finite, on_clouds
from gs_codec.errors import InvalidInput
from gs_codec.formats.similarity import move_scene, rotation_of
from gs_codec.scene import Scene

#: Least factor; float32 holds lengths that are so many times smaller or larger.
_LEAST = 1e-30


@on_clouds
def translate(scene: Scene, offset: Sequence[float]) -> Scene:
    """Shift a scene.

    Parameters
    ----------
    scene : open3d.t.geometry.PointCloud
        As `gs_codec.read` gives it.
    offset : sequence of three float
        Added to the centres, scene units.

    Returns
    -------
    open3d.t.geometry.PointCloud
        The scene at its new place, with all of its attributes.

    Raises
    ------
    InvalidInput
        If the offset is not finite.

    Examples
    --------
    >>> cloud = gs_codec.read("scene.ply")
    >>> moved = gs_codec.edit.translate(cloud, (0, 0, 5))
    """
    matrix = np.eye(4)
    matrix[:3, 3] = finite("offset", offset, 3)
    return transform(scene, matrix)


@on_clouds
def rotate(scene: Scene, angles: Sequence[float]) -> Scene:
    """Turn a scene about the origin; SH-AC are turned by the exact matrix of each band.

    Parameters
    ----------
    scene : open3d.t.geometry.PointCloud
        As `gs_codec.read` gives it.
    angles : sequence of three or four float
        Degrees about the x axis, then about y, then about z, which all stay in place; or a
        quaternion wxyz of any norm.

    Returns
    -------
    open3d.t.geometry.PointCloud
        The scene at its new place, with all of its attributes.

    Raises
    ------
    InvalidInput
        If there are not three or four finite numbers, or the quaternion is zero.

    Examples
    --------
    >>> cloud = gs_codec.read("scene.ply")
    >>> upside_down = gs_codec.edit.rotate(cloud, (180, 0, 0))
    """
    matrix = np.eye(4)
    matrix[:3, :3] = _rotation(angles)
    return transform(scene, matrix)


@on_clouds
def scale(scene: Scene, factor: float) -> Scene:
    """Make a scene larger or smaller about the origin.

    Parameters
    ----------
    scene : open3d.t.geometry.PointCloud
        As `gs_codec.read` gives it.
    factor : float
        Of all lengths, 1e-30 to 1e30.

    Returns
    -------
    open3d.t.geometry.PointCloud
        The scene at its new place, with all of its attributes.

    Raises
    ------
    InvalidInput
        If the factor is out of its range.

    Examples
    --------
    >>> cloud = gs_codec.read("scene.ply")
    >>> in_centimetres = gs_codec.edit.scale(cloud, 100)
    """
    if not _LEAST <= factor <= 1 / _LEAST:
        raise InvalidInput(f"factor {factor:g}: expected {_LEAST:g} to {1 / _LEAST:g}")
    return transform(scene, np.diag([factor, factor, factor, 1.0]))


@on_clouds
def transform(scene: Scene, matrix: ArrayLike) -> Scene:
    """Move a scene by a matrix: a rotation or mirroring, times a scale, and a shift.

    Centres, ellipsoids and SH follow; numbers are computed in float64 and rounded once. If axes
    only swap and change signs, nothing is rounded but SH of degree 2 and 3.

    Parameters
    ----------
    scene : open3d.t.geometry.PointCloud
        As `gs_codec.read` gives it.
    matrix : array_like, shape (4, 4)
        Takes centres, as columns ``(x, y, z, 1)``, to their places.

    Returns
    -------
    open3d.t.geometry.PointCloud
        The scene at its new place, with all of its attributes.

    Raises
    ------
    InvalidInput
        If the matrix is not finite, shears, or scales axes differently or by 0.

    Examples
    --------
    >>> cloud = gs_codec.read("scene.ply")
    >>> matrix = [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    >>> mirrored = gs_codec.edit.transform(cloud, matrix)
    """
    moved = move_scene(scene, matrix)
    return scene if moved is scene else without_order(moved)


def _rotation(angles: Sequence[float]) -> NDArray[np.float64]:
    """The matrix of a rotation from `rotate`."""
    if len(angles) == 4:
        quaternion = finite("quaternion", angles, 4)
        if not quaternion.any():
            raise InvalidInput("quaternion of norm 0, expected a rotation")
        return rotation_of(quaternion / np.abs(quaternion).max())
    matrix = np.eye(3)
    for axis, half in enumerate(np.radians(finite("angles", angles, 3)) / 2):
        quaternion = np.zeros(4)
        quaternion[[0, 1 + axis]] = math.cos(half), math.sin(half)
        matrix = rotation_of(quaternion) @ matrix
    return matrix

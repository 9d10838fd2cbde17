"""Move scenes: translate, rotate, scale, or transform by a matrix, including shapes and SH."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gs_codec.codecs.matching import without_order
from gs_codec.edit.clouds import on_clouds
from gs_codec.edit.project_file import Move, Project
from gs_codec.errors import InvalidInput
from gs_codec.formats.similarity import move_scene, rotation_of
from gs_codec.runtime.arrays import finite
from gs_codec.runtime.wording import counted
from gs_codec.scene import Scene

#: Minimum scale factor, and inverse of the maximum; float32 can represent lengths in this range.
_LEAST = 1e-30


@on_clouds
def translate(scene: Scene, offset: Sequence[float]) -> Scene:
    """Translate a scene.

    Parameters
    ----------
    scene : open3d.t.geometry.PointCloud
        A cloud from `gs_codec.read`.
    offset : sequence of three float
        Translation of the centres, in scene units.

    Returns
    -------
    open3d.t.geometry.PointCloud
        The moved scene, with all attributes.

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
    """Rotate a scene about the origin; SH-AC are rotated exactly, band by band.

    Parameters
    ----------
    scene : open3d.t.geometry.PointCloud
        A cloud from `gs_codec.read`.
    angles : sequence of three or four float
        Degrees about the fixed x axis, then y, then z; or a quaternion wxyz of any norm.

    Returns
    -------
    open3d.t.geometry.PointCloud
        The moved scene, with all attributes.

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
    matrix[:3, :3] = rotation(angles)
    return transform(scene, matrix)


@on_clouds
def scale(scene: Scene, factor: float) -> Scene:
    """Scale a scene about the origin.

    Parameters
    ----------
    scene : open3d.t.geometry.PointCloud
        A cloud from `gs_codec.read`.
    factor : float
        Factor on all lengths, 1e-30 to 1e30.

    Returns
    -------
    open3d.t.geometry.PointCloud
        The moved scene, with all attributes.

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
    """Transform a scene by a matrix: rotation or reflection, uniform scale, and translation.

    Centres, ellipsoids and SH are transformed in float64 and rounded once. If axes are only swapped
    or negated, only SH of degree 2 and 3 are rounded.

    Parameters
    ----------
    scene : open3d.t.geometry.PointCloud
        A cloud from `gs_codec.read`.
    matrix : array_like, shape (4, 4)
        Multiplies centres, as columns ``(x, y, z, 1)``, from the left.

    Returns
    -------
    open3d.t.geometry.PointCloud
        The moved scene, with all attributes.

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


def apply_project(scene: Scene, project: Project, is_input: bool = False) -> Scene:
    """The joined scenes of a project, with its Gaussians moved and removed.

    `is_input` means that no action came before. Raises InvalidInput if the scene's number of
    Gaussians differs from the project's or, with `is_input`, its centres do.
    """
    if scene.count != len(project.removed):
        raise InvalidInput(
            f"edits of {counted(len(project.removed), 'Gaussian')}, the scene has {scene.count:,}"
        )
    if is_input:
        ends = np.cumsum([source.gaussians for source in project.sources])
        for source, end in zip(project.sources, ends.tolist(), strict=True):
            source.check(scene.positions[:, end - source.gaussians : end])
    scene = move_rows(scene, project.moves)
    return without_order(scene.take(~project.removed)) if project.removed.any() else scene


def move_rows(scene: Scene, moves: Sequence[Move]) -> Scene:
    """Apply moves of some Gaussians in their order; raises InvalidInput like `transform`."""
    for rows, matrix in moves:
        moved = move_scene(scene.take(rows), matrix)
        planes = {}
        for group in ("positions", "log_scale", "rot", "f_rest"):
            planes[group] = getattr(scene, group).copy()
            planes[group][:, rows] = getattr(moved, group)
        extra = {name: column.copy() for name, column in scene.extra.items()}
        for name, column in extra.items():
            column[rows] = moved.extra[name]
        comments = moved.comments if rows.all() else scene.comments
        scene = without_order(replace(scene, **planes, extra=extra, comments=comments))
    return scene


def rotation(angles: Sequence[float]) -> NDArray[np.float64]:
    """The matrix of a rotation from `rotate`."""
    angles = tuple(angles)
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

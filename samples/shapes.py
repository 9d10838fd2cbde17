"""Shapes as soups of triangles ``(3, 3, T)``: corner, xyz, triangle; counter-clockwise outside."""

from __future__ import annotations

from typing import Any

import numpy as np

from samples.textures import Array, waves

Point = tuple[float, float, float]


def open3d_shapes() -> Any:
    """Open3D's `TriangleMesh`, imported late, because Open3D takes over a second to load."""
    from open3d.geometry import TriangleMesh

    return TriangleMesh


def corners_of(mesh: Any, centre: Point) -> Array:
    """Triangles ``(3, 3, T)`` of an Open3D mesh moved to `centre`."""
    vertices = np.asarray(mesh.vertices) + centre
    return np.ascontiguousarray(vertices[np.asarray(mesh.triangles)].transpose(1, 2, 0))


def box(centre: Point, size: Point, turn: float = 0.0) -> Array:
    """A box, rotated about the vertical by `turn` radians."""
    mesh = open3d_shapes().create_box(*size)
    mesh.translate(-np.array(size) / 2)
    mesh.rotate(mesh.get_rotation_matrix_from_xyz((0, 0, turn)), center=(0, 0, 0))
    return corners_of(mesh, centre)


def knot() -> Array:
    """Open3D's torus bent into an upright trefoil, the (2, 3) torus knot."""
    mesh = open3d_shapes().create_torus(1.0, 0.5, 240, 24)
    x, y, z = np.asarray(mesh.vertices).T
    t, out = np.arctan2(y, x), np.hypot(x, y) - 1.0
    radius = 2 + np.cos(3 * t)
    curve = np.array([radius * np.cos(2 * t), radius * np.sin(2 * t), np.sin(3 * t)])
    slope = -3 * np.sin(3 * t)
    tangent = np.array(
        [
            slope * np.cos(2 * t) - 2 * curve[1],
            slope * np.sin(2 * t) + 2 * curve[0],
            3 * np.cos(3 * t),
        ]
    )
    tangent /= np.sqrt((tangent**2).sum(axis=0))
    # The normal of the torus around which the knot winds is perpendicular to the curve, and closes
    # with it.
    across = curve - 2 * np.array([np.cos(2 * t), np.sin(2 * t), 0 * t])
    side = np.cross(tangent, across, axis=0)
    a, b, c = 0.13 * (curve + 1.1 * (out * across + z * side))
    # Rotated about x, so that the hole faces the cameras, and lifted onto the table.
    upright = np.array([a, 0.30 - c, b - b.min()])
    return np.ascontiguousarray(upright.T[np.asarray(mesh.triangles)].transpose(1, 2, 0))


def join(parts: list[Array]) -> Array:
    """Join several shapes into one."""
    return np.concatenate(parts, axis=2)


def sphere(radius: float, centre: Point, resolution: int = 40) -> Array:
    """A sphere of flat triangles."""
    return corners_of(open3d_shapes().create_sphere(radius, resolution), centre)


def torus(radius: float, tube: float, centre: Point) -> Array:
    """A horizontal ring."""
    return corners_of(open3d_shapes().create_torus(radius, tube, 60, 30), centre)


def cylinder(radius: float, height: float, centre: Point, around: int = 40) -> Array:
    """An upright cylinder, closed at both ends."""
    return corners_of(open3d_shapes().create_cylinder(radius, height, around, 1), centre)


def blob(centre: Point, radii: Point, depth: float, seed: int, resolution: int = 28) -> Array:
    """An ellipsoid with bumps of relative height `depth`, such as the crown of a tree."""
    mesh = open3d_shapes().create_sphere(1.0, resolution)
    unit = np.asarray(mesh.vertices)
    bumps = waves(unit.T + 3.7 * seed, 4.0) + 0.6 * waves(unit.T - 2.1 * seed, 11.0)
    vertices = np.array(radii) * unit * (1 + depth * bumps[:, None]) + centre
    return np.ascontiguousarray(vertices[np.asarray(mesh.triangles)].transpose(1, 2, 0))


def roof(base: Point, length: float, width: float, turn: float) -> Array:
    """A gabled roof that overhangs a box of this length and width."""
    x, y, z = 0.54 * length, 0.58 * width, 0.45 * width
    vertices = np.array(
        [[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0], [-x, 0, z], [x, 0, z]], float
    )
    triangles = np.array([[0, 1, 5], [0, 5, 4], [2, 3, 4], [2, 4, 5], [1, 2, 5], [3, 0, 4]])
    cos, sin = np.cos(turn), np.sin(turn)
    vertices = vertices @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + base
    return np.ascontiguousarray(vertices[triangles].transpose(1, 2, 0))


def relief(heights: Array, half: float) -> Array:
    """A square of heights ``(X, Y)`` above z = 0, from -half to half along x and y."""
    x, y = (np.linspace(-half, half, count) for count in heights.shape)
    grid = np.stack([*np.meshgrid(x, y, indexing="ij"), heights], axis=-1)
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    triangles = np.stack([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)])
    return np.ascontiguousarray(triangles.reshape(-1, 3, 3).transpose(1, 2, 0))

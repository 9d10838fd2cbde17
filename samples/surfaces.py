"""The still life: textured surfaces of Open3D's built-in shapes, and points sampled on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from samples.shapes import box, corners_of, knot, open3d_shapes
from samples.textures import Array, Texture, checker, marble, rainbow, stripes, wood

#: Distance from the origin within which every surface lies, in scene units.
ROOM_RADIUS = 8.0

#: Footprints that darken the surface below them: x, y, height of the support, radius.
_SHADOWS = (
    (-0.85, 0.40, 0.0, 0.30),
    (0.68, -0.42, 0.0, 0.40),
    (0.00, 0.30, 0.0, 0.30),
    (-0.55, -0.40, 0.0, 0.33),
    (0.85, 0.42, 0.0, 0.20),
    (0.08, -0.55, 0.0, 0.20),
    (0.00, 0.00, -1.0, 1.30),
)
_LIGHT = np.array([0.48, -0.36, 0.80])


@dataclass(frozen=True)
class Surface:
    """One textured shape.

    Parameters
    ----------
    name : str
    corners : ndarray, shape (3, 3, T)
        Triangles: corner, xyz, triangle; counter-clockwise seen from outside.
    texture : callable
        Reflectance ``(3, N)`` in [0, 1] at points ``(3, N)``.
    density : float
        Gaussians per area, relative to the other surfaces.
    gloss : float
        Strength of view-dependent colour, relative to the other surfaces.
    shines : bool
        Whether it emits light, and so has neither shade nor gloss.
    """

    name: str
    corners: Array
    texture: Texture
    density: float = 5.0
    gloss: float = 1.0
    shines: bool = False


@dataclass(frozen=True)
class SurfacePoints:
    """Points sampled from a still life.

    Parameters
    ----------
    positions, normals : ndarray, shape (3, N), float64
        Points and the unit normals of their triangles.
    part : ndarray, shape (N,), intp
        Index of the surface of each point.
    """

    positions: Array
    normals: Array
    part: NDArray[np.intp]


@dataclass(frozen=True)
class StillLife:
    """All surfaces as one soup of triangles, sampled by area and density."""

    surfaces: tuple[Surface, ...]
    corners: Array
    normals: Array
    part: NDArray[np.intp]
    cumulative: Array

    @property
    def densities(self) -> Array:
        """Points per unit area on each surface, divided by the number of points, shape (P,)."""
        return np.array([surface.density for surface in self.surfaces]) / self.cumulative[-1]

    def sample(self, count: int, rng: np.random.Generator) -> SurfacePoints:
        """Sample `count` points, uniformly on each surface."""
        at = rng.random(count) * self.cumulative[-1]
        triangle = np.minimum(
            np.searchsorted(self.cumulative, at, side="right"), len(self.cumulative) - 1
        )
        # The square root makes barycentric coordinates uniform over the triangle.
        root, v = np.sqrt(rng.random(count)), rng.random(count)
        weights = (1 - root, root * (1 - v), root * v)
        positions = np.zeros((3, count))
        for corner, weight in zip(self.corners, weights, strict=True):
            positions += weight * corner[:, triangle]
        return SurfacePoints(positions, self.normals[:, triangle], self.part[triangle])

    def colours(self, points: SurfacePoints) -> Array:
        """Lit texture ``(3, N)``, RGB in [0, 1]."""
        rgb = np.empty_like(points.positions)
        for number, surface in enumerate(self.surfaces):
            inside = np.flatnonzero(points.part == number)
            rgb[:, inside] = surface.texture(points.positions[:, inside])
        facing = np.einsum("i,in->n", _LIGHT, points.normals)
        return rgb * (0.72 + 0.28 * facing) * _contact_shade(points.positions)


@lru_cache(maxsize=1)
def still_life() -> StillLife:
    """Build the scene: a table with seven objects in a room with its floor at z = -1."""
    return joined((*_room(), *_table(), *_objects()))


def joined(surfaces: Sequence[Surface]) -> StillLife:
    """Join surfaces to one soup of triangles."""
    corners = np.concatenate([surface.corners for surface in surfaces], axis=2)
    normals = np.cross(corners[1] - corners[0], corners[2] - corners[0], axis=0)
    length = np.sqrt((normals**2).sum(axis=0))
    sizes = [surface.corners.shape[2] for surface in surfaces]
    density = np.repeat([surface.density for surface in surfaces], sizes)
    return StillLife(
        tuple(surfaces),
        corners,
        normals / np.maximum(length, 1e-12),
        np.repeat(np.arange(len(surfaces)), sizes),
        np.cumsum(density * length / 2),
    )


def _room() -> list[Surface]:
    # The winding is reversed, because the room is seen from inside.
    faces = box((0, 0, 0.5), (9, 9, 3))[::-1]
    bottom = np.all(faces[:, 2] < -0.99, axis=0)
    top = np.all(faces[:, 2] > 1.99, axis=0)
    tiles = checker(0.75, (0.62, 0.56, 0.50), (0.80, 0.77, 0.72))
    paper = stripes(lambda p: p[0] + p[1], 0.9, (0.52, 0.60, 0.62), (0.60, 0.67, 0.66))
    return [
        Surface("floor", faces[:, :, bottom], tiles, density=0.2, gloss=0.6),
        Surface("walls", faces[:, :, ~bottom & ~top], paper, density=0.1, gloss=0.3),
    ]


def _table() -> list[Surface]:
    top = box((0, 0, -0.04), (2.7, 1.9, 0.08))
    legs = [box((x, y, -0.54), (0.1, 0.1, 0.92)) for x in (-1.2, 1.2) for y in (-0.8, 0.8)]
    planks = wood((0.42, 0.26, 0.14), (0.62, 0.42, 0.25))
    return [
        Surface("table", top, planks, density=1.6, gloss=0.8),
        Surface("legs", np.concatenate(legs, axis=2), planks, density=0.5, gloss=0.5),
    ]


def _objects() -> list[Surface]:
    """Make the seven objects; each stands on the table top at z = 0."""
    shapes = open3d_shapes()
    sphere = corners_of(shapes.create_sphere(0.28, 40), (-0.85, 0.40, 0.28))
    torus = corners_of(shapes.create_torus(0.28, 0.11, 80, 40), (0.68, -0.42, 0.11))
    cube = box((-0.55, -0.40, 0.19), (0.38, 0.38, 0.38), turn=0.4)
    block = box((-0.53, -0.42, 0.49), (0.26, 0.20, 0.22), turn=1.1)
    can = corners_of(shapes.create_cylinder(0.15, 0.56, 64, 1), (0.85, 0.42, 0.28))
    cone = corners_of(shapes.create_cone(0.17, 0.40, 64, 1), (0.08, -0.55, 0.0))
    around = stripes(
        lambda p: 0.28 * np.arctan2(p[1] + 0.42, p[0] - 0.68),
        0.16,
        (0.90, 0.84, 0.70),
        (0.75, 0.16, 0.14),
    )
    label = stripes(lambda p: p[2] + 0.05 * p[0], 0.14, (0.16, 0.32, 0.66), (0.88, 0.88, 0.84))
    return [
        Surface("sphere", sphere, marble((0.86, 0.85, 0.82), (0.20, 0.34, 0.36)), gloss=1.8),
        Surface("torus", torus, around, gloss=1.2),
        Surface("knot", knot(), rainbow, density=6.5, gloss=2.0),
        Surface("cube", cube, checker(0.127, (0.93, 0.78, 0.22), (0.22, 0.20, 0.24), 0.4)),
        Surface("block", block, wood((0.55, 0.22, 0.10), (0.80, 0.45, 0.22)), gloss=0.7),
        Surface("can", can, label, gloss=1.6),
        Surface("cone", cone, marble((0.90, 0.45, 0.12), (0.60, 0.22, 0.08)), gloss=0.8),
    ]


def _contact_shade(points: Array) -> Array:
    """Darkening of supports near the objects on them."""
    shade = np.ones(points.shape[1])
    for x, y, z, radius in _SHADOWS:
        under = np.flatnonzero(np.abs(points[2] - z) < 1e-3)
        apart = (points[0, under] - x) ** 2 + (points[1, under] - y) ** 2
        shade[under] *= 1 - 0.55 * np.exp(-((apart / radius**2) ** 2))
    return shade

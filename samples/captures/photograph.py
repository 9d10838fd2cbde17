"""Photographs of a place by ray casting, with shadows and view-dependent gloss."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from samples.captures.place import Light, Place
from samples.textures import Array

#: Number of rays along each side of a pixel.
_RAYS = 2

#: Offset of rays from a surface, in metres, so that they do not hit it again.
_OFF = 2e-3

#: Colour that glossy surfaces reflect from below.
_BELOW = (0.25, 0.22, 0.18)


class Hits(NamedTuple):
    """Hit points of rays: colours, points and normals ``(3, N)``, and distances ``(N,)``."""

    colours: Array
    points: Array
    normals: Array
    distances: Array


class Photographer:
    """Takes photographs of a place.

    Parameters
    ----------
    place : Place
    """

    def __init__(self, place: Place) -> None:
        # Imported late, because Open3D takes over a second to load.
        from open3d import core
        from open3d.t.geometry import RaycastingScene

        tensor: Any = core.Tensor
        self._place, self._tensor = place, tensor
        sizes = [surface.corners.shape[2] for surface in place.surfaces]
        self._part = np.repeat(np.arange(len(sizes)), sizes)
        corners = np.concatenate([surface.corners for surface in place.surfaces], axis=2)
        normals = np.cross(corners[1] - corners[0], corners[2] - corners[0], axis=0)
        self._normals = normals / np.maximum(np.sqrt((normals**2).sum(axis=0)), 1e-20)
        vertices = np.ascontiguousarray(corners.transpose(2, 0, 1).reshape(-1, 3), np.float32)
        triangles = np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3)
        self._scene = RaycastingScene()
        self._scene.add_triangles(tensor(vertices), tensor(triangles))

    def photograph(
        self, camera: Camera, rng: np.random.Generator
    ) -> tuple[NDArray[np.float32], Hits]:
        """Image ``(H, W, 3)`` in [0, 1], and the hit of one ray for each pixel, row by row."""
        shape = camera.height, camera.width
        y, x = np.indices(shape)
        total = np.zeros((3, y.size))
        for k in range(_RAYS**2):
            right = x + (k % _RAYS + rng.random(shape)) / _RAYS
            down = y + (k // _RAYS + rng.random(shape)) / _RAYS
            across, along = (right - camera.cx) / camera.fx, (down - camera.cy) / camera.fy
            local = np.stack([across.ravel(), along.ravel(), np.ones(y.size)])
            directions = camera.rotation.T @ (local / np.sqrt((local**2).sum(axis=0)))
            hits = self._look(camera.position, directions, rng)
            total += hits.colours
        image = (total / _RAYS**2).T.reshape(*shape, 3)
        return np.ascontiguousarray(image, np.float32), hits

    def _look(self, origin: Array, directions: Array, rng: np.random.Generator) -> Hits:
        start = np.broadcast_to(origin[:, None], directions.shape)
        distances, triangles = self._cast(start, directions)
        points = start + distances * directions
        normals = self._normals[:, triangles]
        normals = normals * -np.sign(_dot(normals, directions) + 1e-12)
        colours, gloss, lit = self._material(points, self._part[triangles])
        mirrored = directions - 2 * _dot(normals, directions) * normals
        # Ambient light, mostly from above.
        diffuse, shine = 0.42 + 0.14 * normals[2], np.zeros(len(distances))
        for light in self._place.lights:
            to, power = self._light(light, points, normals, rng)
            diffuse += 0.75 * power * np.maximum(_dot(normals, to), 0)
            shine += power * np.maximum(_dot(mirrored, to), 0) ** 18
        fresnel = 0.1 + 0.5 * (1 - np.clip(-_dot(normals, directions), 0, 1)) ** 4
        reflected = 0.22 * shine + 0.33 * fresnel * self._surroundings(mirrored)
        colours = np.where(lit, colours * diffuse + gloss * reflected, colours)
        return Hits(np.clip(colours, 0, 1), points, normals, distances)

    def _cast(self, origins: Array, directions: Array) -> tuple[Array, NDArray]:
        rays = np.concatenate([origins, directions]).T.astype(np.float32, order="C")
        hits = self._scene.cast_rays(self._tensor(rays))
        return hits["t_hit"].numpy().astype(np.float64), hits["primitive_ids"].numpy()

    def _material(self, points: Array, part: NDArray) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Reflectance, gloss, and whether a surface is lit and shaded."""
        colours = np.empty_like(points)
        for number, surface in enumerate(self._place.surfaces):
            inside = np.flatnonzero(part == number)
            if len(inside):
                colours[:, inside] = surface.texture(points[:, inside])
        gloss = np.array([surface.gloss for surface in self._place.surfaces])
        lit = np.array([not surface.shines for surface in self._place.surfaces])
        return colours, gloss[part], lit[part]

    def _light(
        self, light: Light, points: Array, normals: Array, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Directions to a light, and the light that arrives; each ray has its own shadow ray."""
        to = np.array(light.position)[:, None] - points
        to += light.radius * rng.standard_normal(points.shape)
        distance = np.sqrt(_dot(to, to))
        to /= distance
        clear, _ = self._cast(points + _OFF * normals, to)
        power = light.power / (1 + (distance / light.reach) ** 2)
        return to, np.where(clear < 0.98 * distance, 0, power)

    def _surroundings(self, directions: Array) -> Array:
        """Reflected surroundings: bright above, dark below, uneven all around."""
        x, y, z = directions
        above = 1 / (1 + np.exp(-4 * z))
        rgb = np.multiply.outer(self._place.above, above) + np.multiply.outer(_BELOW, 1 - above)
        return rgb * (0.75 + 0.5 * np.sin(2.3 * x + 1) * np.cos(1.9 * y))


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("in,in->n", a, b)

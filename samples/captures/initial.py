"""Initial Gaussians for training, like those of structure-from-motion and densification."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.coding.neighbours import Neighbours
from gs_codec.scene import SH_C0, Scene
from samples.captures.photograph import Hits
from samples.captures.rigs import Frame
from samples.textures import Array

#: Number of candidates for each selected point.
_CANDIDATES = 30

#: Error of matched features in the images, in pixels.
_FEATURE_ERROR = 0.5

#: Range of the distance of floaters from cameras, relative to the median distance.
_FLOATERS_AT = (0.08, 0.5)


class Points(NamedTuple):
    """Points visible to cameras.

    ``positions (N, 3)`` in metres, ``colours (N, 3)``, ``normals (N, 3)``, ``sizes (N,)``
    standard deviations in metres, and ``opacity (N,)``, logits.
    """

    positions: Array
    colours: Array
    normals: Array
    sizes: Array
    opacity: Array


def seen_candidates(
    camera: Camera, image: NDArray, hits: Hits, count: int, rng: np.random.Generator
) -> Array:
    """Candidates ``(N, 13)`` at some pixels: position, colour, normal, distance, camera centre."""
    pick = rng.choice(image.size // 3, min(count, image.size // 3), replace=False)
    centre = np.broadcast_to(camera.position, (len(pick), 3))
    rows = hits.points.T, image.reshape(-1, 3), hits.normals.T, hits.distances[:, None]
    return np.concatenate([*(row[pick] for row in rows), centre], axis=1)


def candidates_of_each(count: int, cameras: int) -> int:
    """Number of candidates from each camera."""
    return 1 + _CANDIDATES * count // cameras


def surface_points(
    candidates: Array, count: int, parallax: float, rng: np.random.Generator
) -> Points:
    """Choose points with a spacing that grows with the distance of the nearest camera.

    They are denser where colours vary. `parallax`, the radius of the rig times the focal length,
    determines how accurately distances are known.
    """
    positions, distances = candidates[:, :3], candidates[:, 9]
    apart, near = Neighbours(positions).nearest(positions, min(9, len(positions)))
    nearest = distances[near].min(axis=1)
    contrast = candidates[near, 3:6].std(axis=1).mean(axis=1)
    spacing = apart[:, -1] / nearest + 1e-3
    weights = spacing**2 * (0.35 + np.minimum(contrast / 0.08, 2))
    # The `count` smallest values are a weighted sample without replacement.
    chosen = np.argsort(rng.exponential(size=len(weights)) / weights)[:count]
    found, distance = candidates[chosen], distances[chosen]
    error = _FEATURE_ERROR / parallax * rng.standard_normal(len(chosen))
    shift = 1 / np.maximum(1 / distance + error, 0.3 / distance) - distance
    ray = (found[:, :3] - found[:, 10:]) / distance[:, None]
    at = found[:, :3] + shift[:, None] * ray
    apart, _ = Neighbours(at).nearest(at, 4)
    sizes = 0.6 * np.sqrt((apart[:, 1:] ** 2).mean(axis=1))
    at += 0.1 * sizes[:, None] * rng.standard_normal(at.shape)
    opacity = rng.normal(-2.0, 1.3, len(chosen))
    return Points(at, found[:, 3:6], found[:, 6:9], sizes, opacity)


def floaters(
    cameras: Sequence[Camera],
    images: Sequence[NDArray],
    count: int,
    distance: float,
    rng: np.random.Generator,
) -> Points:
    """Faint points close to the cameras, with the colours of the pixels behind them."""
    low, high = np.log(_FLOATERS_AT)
    depth = distance * np.exp(rng.uniform(low, high, count))
    spots = rng.random((2, count))
    positions, colours = np.empty((count, 3)), np.empty((count, 3))
    for i, view in enumerate(rng.integers(len(cameras), size=count)):
        camera, (across, down) = cameras[view], spots[:, i]
        x, y = across * camera.width, down * camera.height
        local = ((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0)
        positions[i] = camera.position + depth[i] * (local @ camera.rotation)
        colours[i] = images[view][int(y), int(x)]
    sizes = depth * np.exp(rng.normal(np.log(0.035), 0.5, count))
    # Spherical, because they have no surface.
    return Points(positions, colours, 0 * colours, sizes, rng.normal(-2.0, 1.0, count))


def initial_scene(points: Points, frame: Frame, rng: np.random.Generator) -> Scene:
    """Gaussians in random order, uneven in size and shape, slightly flattened along the normal."""
    count = len(points.positions)
    rot = np.array([[1.0], [0.0], [0.0], [0.0]]) + 0.5 * rng.standard_normal((4, count))
    normals = (points.normals @ frame.turn.T).T
    log_scale = np.log(frame.unit * points.sizes) + 0.5 * rng.standard_normal(count)
    log_scale = log_scale + 0.35 * rng.standard_normal((3, count))
    log_scale -= np.einsum("ikn,in->kn", _matrices(rot), normals) ** 2
    planes = {
        "positions": frame.points(points.positions).T,
        "f_dc": (points.colours.T - 0.5) / SH_C0,
        "f_rest": np.zeros((45, count)),
        "opacity": points.opacity[None],
        "log_scale": log_scale,
        "rot": rot,
    }
    order = rng.permutation(count)
    kept = {group: plane[:, order].astype(np.float32, order="C") for group, plane in planes.items()}
    return Scene(**kept, has_normals=True)


def _matrices(rot: Array) -> Array:
    """Rotations ``(3, 3, N)`` of quaternions wxyz ``(4, N)`` of any norm."""
    w, x, y, z = rot / np.sqrt((rot**2).sum(axis=0))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )

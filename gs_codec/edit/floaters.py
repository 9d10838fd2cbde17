"""Floaters: Gaussians that hang in empty space, that hardly a camera sees, or far outside."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.edit.spacing import (
    NEIGHBOURS,
    far_from_others,
    find_spacing,
    finite_mask,
    usual_distance,
)
from gs_codec.errors import InvalidInput
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.project import NEAR, camera_arguments, rotated
from gs_codec.rendering.renderer import render
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.kernels import kernel
from gs_codec.scene import Scene

#: Why a Gaussian is a floater; the index is the label. The first stays.
FLOATERS = ("", "isolated", "hardly seen", "outside")

#: Isolated: more than so many times the usual distance from others.
_FAR = 2.0

#: Hardly seen: below this part of the mean blending weight, by at least so many cameras.
_FAINT, _VIEWS = 1e-3, 10

#: Views are drawn at most this wide, pixels.
_WIDTH = 640

#: What is outside is beyond the hull enlarged by this factor.
_BEYOND = 2.0

#: Most products of facets and points that are kept at once.
_PRODUCTS = 1 << 24


class _Sight(NamedTuple):
    """Of each Gaussian ``(N,)``, the blending weight in all pixels, and the views that hold it."""

    weight: NDArray[np.float64]
    held: NDArray[np.int64]


def find_floaters(
    scene: Scene, cameras: Sequence[Camera] | None = None, progress: Progress | None = None
) -> NDArray[np.uint8]:
    """Label floaters; see `remove_floaters` for the rules.

    Parameters
    ----------
    scene : Scene
    cameras : sequence of Camera, optional
    progress : callable, optional
        Called with a stage's name, views done, and views in all.

    Returns
    -------
    ndarray, shape (N,), uint8
        0 for Gaussians that stay; for others the index in `FLOATERS` of the first rule they meet.

    Raises
    ------
    InvalidInput
        If the sequence of cameras is empty.
    """
    if cameras is not None and not len(cameras):
        raise InvalidInput("cameras: none, expected at least one")
    finite = finite_mask(scene)
    labels = np.zeros(scene.count, np.uint8)
    if not finite.any():
        return labels
    index = np.flatnonzero(finite)
    labels[index[_isolated(scene.take(index))]] = FLOATERS.index("isolated")
    if cameras is not None:
        sight = _look(scene, cameras, progress)
        faint = sight.weight < _FAINT * sight.weight[finite].mean()
        hardly = faint & (sight.held >= _VIEWS)
        left = finite & (labels == 0)
        labels[left & hardly] = FLOATERS.index("hardly seen")
        outside = _outside(scene, cameras, left & ~faint, left & faint & ~hardly)
        labels[outside] = FLOATERS.index("outside")
    return labels


def _isolated(scene: Scene) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` of a finite scene are far from most others."""
    isolated = np.zeros(scene.count, bool)
    if scene.count > NEIGHBOURS:
        spacing = find_spacing(scene)
        limit = _FAR * usual_distance(spacing)
        # The eighth nearest in units of sizes is at most as far as that by centre.
        asked = np.flatnonzero(spacing.in_sizes().max(axis=1) > limit)
        isolated[asked] = far_from_others(spacing, asked) > limit
    return isolated


def _look(scene: Scene, cameras: Sequence[Camera], progress: Progress | None) -> _Sight:
    """Draw what cameras see."""
    sight = _Sight(np.zeros(scene.count), np.zeros(scene.count, np.int64))
    advance = step_counter(progress, "views", len(cameras))
    for camera in cameras:
        width = min(camera.width, _WIDTH)
        small = camera.resized(width, max(1, round(camera.height * width / camera.width)))
        sums = render(scene, small, accumulate=True).accumulations
        assert sums is not None
        # Of an image of any size, the share that a Gaussian makes up.
        sight.weight[:] += sums.weight / (small.width * small.height)
        _count_held(scene.positions, *camera_arguments(small), sight.held)
        advance()
    return sight


@kernel
def _count_held(positions, rotation, position, intrinsics, width, height, held):
    """Count a view for each centre that is in its image."""
    fx, fy, cx, cy = intrinsics
    for i in range(positions.shape[1]):
        dx = positions[0, i] - position[0]
        dy = positions[1, i] - position[1]
        dz = positions[2, i] - position[2]
        x, y, z = rotated(rotation, dx, dy, dz)
        u, v = fx * x / z + cx, fy * y / z + cy
        if z > NEAR and 0.0 <= u < width and 0.0 <= v < height:
            held[i] += 1


def _outside(
    scene: Scene,
    cameras: Sequence[Camera],
    seen: NDArray[np.bool_],
    asked: NDArray[np.bool_],
) -> NDArray[np.int64]:
    """Indices of those Gaussians asked for that are far from cameras and what they see."""
    from scipy.spatial import ConvexHull, QhullError

    asking = np.flatnonzero(asked)
    points = np.concatenate([[camera.position for camera in cameras], scene.positions.T[seen]])
    if not len(asking) or not seen.any():
        return asking[:0]
    try:
        hull = ConvexHull(points)
    except QhullError:  # all in a plane
        return asking[:0]
    centre = points[hull.vertices].mean(axis=0)
    normals, offsets = hull.equations[:, :3], hull.equations[:, 3]
    margins = (1 - _BEYOND) * (normals @ centre) + _BEYOND * offsets
    beyond = np.zeros(len(asking), bool)
    size = max(1, _PRODUCTS // len(normals))
    for start in range(0, len(asking), size):
        part = slice(start, start + size)
        heights = scene.positions.T[asking[part]] @ normals.T + margins
        beyond[part] = (heights > 0).any(axis=1)
    return asking[beyond]


def remove_floaters(scene: Scene, cameras: Sequence[Camera] | None = None) -> Scene:
    """Remove Gaussians that hang in empty space, that cameras hardly see, or far outside.

    A Gaussian goes by the first rule that it meets:

    - isolated: fewer than eight others touch it. Two Gaussians touch if spheres around them do: of
      two standard deviations along their longest axes, rounded to a power of two; or of as many
      standard deviations as nine in ten Gaussians need to touch their eight nearest neighbours.
      So a large Gaussian far from others is not isolated if it reaches them, and a group of up to
      eight small ones is.
    - hardly seen, with cameras: at least ten have its centre in their image, but all together see
      less of it than a thousandth of what they see of a Gaussian on average, because it is hidden
      or transparent.
    - outside, with cameras: it is not seen, and beyond twice the convex hull of the cameras and of
      what they see.

    What cameras see stays, unless it is isolated. What fewer than ten cameras look at stays within
    that hull, so that few cameras do not remove what others would see. Gaussians with a value that
    is not finite stay.

    Parameters
    ----------
    scene : Scene
    cameras : sequence of Camera, optional
        Those the scene was trained with, or others that look at all that is to stay. Without them,
        only isolated Gaussians go.

    Returns
    -------
    Scene
        The Gaussians that stay, in their order; the same object if all do.

    Raises
    ------
    InvalidInput
        If the sequence of cameras is empty.
    """
    labels = find_floaters(scene, cameras)
    return scene.take(labels == 0) if labels.any() else scene

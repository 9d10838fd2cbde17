"""Floaters: Gaussians in empty space, hardly visible to cameras, or far outside."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.coding.exact_math import combine
from gs_codec.coding.far import find_far
from gs_codec.edit.clouds import on_clouds
from gs_codec.edit.spacing import (
    NEIGHBOURS,
    far_from_others,
    find_spacing,
    in_place_order,
    usual_distance,
)
from gs_codec.errors import InvalidInput
from gs_codec.rendering.project import camera_arguments, rotated
from gs_codec.rendering.renderer import render
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.optional import check_installed
from gs_codec.scene import Scene
from gs_codec.views.find import find_cameras

#: Reasons why a Gaussian is a floater; the label is the index. Label 0 is kept.
FLOATERS = ("", "isolated", "hardly seen", "outside")

#: Isolated: this many times the usual distance from other Gaussians, or more.
_FAR = 1.75

#: The same factor in front of a camera.
_FAR_BEFORE = 1.25

#: In front of a camera: nearer than this share of the depth of its subject.
_BEFORE = 0.7

#: The subject's depth is exceeded by this share of the pixels that are more than half opaque.
_LOOKED_AT = 0.95

#: Hardly seen: below this share of the mean blending weight.
_FAINT = 1e-3

#: Minimum number of cameras for the rule `hardly seen`.
_VIEWS = 10

#: Maximum width of rendered views, in pixels.
_WIDTH = 640

#: Outside: beyond the convex hull enlarged by this factor.
_BEYOND = 4.0

#: Maximum number of products of facets and points computed at once.
_PRODUCTS = 1 << 24


class _Sight(NamedTuple):
    """Visibility of each Gaussian ``(N,)`` to the cameras.

    Attributes
    ----------
    weight : ndarray, float64
        Sum over views of its share of the image.
    held : ndarray, int64
        Number of views with its centre in the image.
    closest : ndarray, float64
        Minimum over those views of its depth, relative to the depth of their subject.
    """

    weight: NDArray[np.float64]
    held: NDArray[np.int64]
    closest: NDArray[np.float64]


def find_floaters(
    scene: Scene,
    cameras: str | Path | Sequence[Camera] | None = None,
    progress: Progress | None = None,
) -> NDArray[np.uint8]:
    """Label floaters; see `remove_floaters` for the rules.

    Raises InvalidInput if cameras cannot be read, or there are none. Raises MissingTool if cameras
    are given, and scipy is not installed.

    Parameters
    ----------
    scene : Scene
    cameras : path or sequence of Camera, optional
    progress : callable, optional
        Called with a stage's name, the views done, and the number of views.

    Returns
    -------
    ndarray, shape (N,), uint8
        0 for Gaussians that are kept; for others the index in `FLOATERS` of the first rule that
        matches.
    """
    if str(cameras) == "auto":
        raise InvalidInput(
            "cameras 'auto': estimated cameras are not enough, expected cameras from a file"
        )
    if cameras is not None:
        check_installed("scipy", "remove-floaters with cameras")
        cameras = find_cameras(cameras, scene)
    finite, labels = in_place_order(scene), np.zeros(scene.count, np.uint8)
    if not len(finite):
        return labels
    isolation = np.zeros(scene.count)
    isolation[finite] = _isolation(scene.take(finite))
    labels[isolation > _FAR] = FLOATERS.index("isolated")
    far = np.zeros(scene.count, bool)
    if found := find_far(scene.positions[:, finite], scene.log_scale[:, finite]):
        far[finite[found.far]] = True
    if cameras is None:
        labels[far & (labels == 0)] = FLOATERS.index("outside")
    if cameras is not None:
        sight = _look(scene, cameras, progress)
        before = (isolation > _FAR_BEFORE) & (sight.closest < _BEFORE)
        labels[before] = FLOATERS.index("isolated")
        faint = sight.weight < _FAINT * sight.weight[finite].mean()
        hardly = faint & (sight.held >= _VIEWS)
        left = np.zeros(scene.count, bool)
        left[finite] = labels[finite] == 0
        labels[left & hardly] = FLOATERS.index("hardly seen")
        unseen = left & faint & ~hardly
        labels[unseen & far] = FLOATERS.index("outside")
        outside = _outside(scene, cameras, left & ~faint, unseen & ~far)
        labels[outside] = FLOATERS.index("outside")
    return labels


def _isolation(scene: Scene) -> NDArray[np.float64]:
    """Distance from others, in usual distances, ``(N,)`` of a finite scene; 0 if small."""
    isolation = np.zeros(scene.count)
    if scene.count > NEIGHBOURS:
        spacing = find_spacing(scene)
        usual = usual_distance(spacing)
        # The eighth nearest in units of sizes is at most as far as the eighth nearest by centre.
        candidates = np.flatnonzero(spacing.in_sizes().max(axis=1) > _FAR_BEFORE * usual)
        isolation[candidates] = far_from_others(spacing, candidates) / max(
            usual, np.finfo(float).tiny
        )
    return isolation


def _look(scene: Scene, cameras: Sequence[Camera], progress: Progress | None) -> _Sight:
    """Measure what cameras see."""
    count = scene.count
    sight = _Sight(np.zeros(count), np.zeros(count, np.int64), np.full(count, np.inf))
    advance = step_counter(progress, "views", len(cameras))
    for camera in cameras:
        width = min(camera.width, _WIDTH)
        small = camera.resized(width, max(1, round(camera.height * width / camera.width)))
        drawn = render(scene, small, accumulate=True)
        assert drawn.accumulations is not None
        sight.weight[:] += drawn.accumulations.weight / drawn.alpha.size
        depths = drawn.depth[drawn.alpha > 0.5]
        near = float(np.quantile(depths, 1 - _LOOKED_AT)) if depths.size else 0.0
        _find_held(scene.positions, *camera_arguments(small), near, sight.held, sight.closest)
        advance()
    return sight


@kernel
def _find_held(positions, rotation, position, intrinsics, width, height, middle, held, closest):
    """Count a view for each centre in its image; keep the minimum depth in units of `middle`."""
    fx, fy, cx, cy, near = intrinsics
    for i in range(positions.shape[1]):
        dx = positions[0, i] - position[0]
        dy = positions[1, i] - position[1]
        dz = positions[2, i] - position[2]
        x, y, z = rotated(rotation, dx, dy, dz)
        u, v = fx * x / z + cx, fy * y / z + cy
        if z > near and 0.0 <= u < width and 0.0 <= v < height:
            held[i] += 1
            if middle > 0.0:
                closest[i] = min(closest[i], z / middle)


def _outside(
    scene: Scene,
    cameras: Sequence[Camera],
    seen: NDArray[np.bool_],
    candidates: NDArray[np.bool_],
) -> NDArray[np.int64]:
    """Indices of those candidates that are far from cameras and from everything they see."""
    from scipy import spatial

    asking = np.flatnonzero(candidates)
    points = np.concatenate([[camera.position for camera in cameras], scene.positions.T[seen]])
    if not len(asking) or not seen.any():
        return asking[:0]
    try:
        hull = spatial.ConvexHull(points)
    except spatial.QhullError:  # all points are in a plane
        return asking[:0]
    centre = points[hull.vertices].mean(axis=0)
    normals, offsets = hull.equations[:, :3], hull.equations[:, 3]
    margins = (_BEYOND - 1) * combine(centre, normals.T) + _BEYOND * offsets
    beyond = np.zeros(len(asking), bool)
    size = max(1, _PRODUCTS // len(normals))
    for start in range(0, len(asking), size):
        part = slice(start, start + size)
        # Not with BLAS, whose sums depend on the number of threads.
        heights = np.einsum("ai,ja->ij", scene.positions[:, asking[part]], normals) + margins
        beyond[part] = (heights > 0).any(axis=1)
    return asking[beyond]


@on_clouds
def remove_floaters(scene: Scene, cameras: str | Path | Sequence[Camera] | None = None) -> Scene:
    """Remove Gaussians in empty space, hardly visible to the cameras, or far outside.

    A Gaussian is removed by the first rule that matches:

    - isolated: the distance to its eighth nearest neighbour is more than 1.75 times the 90th
      percentile of the scene. Distances are relative to size: divided by the largest standard
      deviation of the first Gaussian plus the geometric mean of those of the second, both rounded
      to powers of two.
      So small Gaussians in empty space are removed, alone or in clumps of up to eight; large ones
      in a sparse background are kept. In front of a camera the factor is 1.25: if the centre is in
      the image, nearer than 0.7 times the depth that 95 % of the opaque pixels exceed.
    - hardly seen, with cameras: its centre is in the image of at least ten cameras, but its total
      blending weight is less than a thousandth of the mean, because it is hidden or transparent.
    - outside: it is one of a few far Gaussians (see below); with cameras, only if its weight is
      below the same limit. With cameras, Gaussians below the limit are also removed outside the
      convex hull of the cameras and the Gaussians they see, enlarged four times around its middle.

    Far Gaussians are the few whose distance from the median centre is at least four times the best
    cut. The best cut minimises log2 of the distance, plus one bit for each 1 % of Gaussians beyond
    it. Most scenes have none. Writers of formats with a grid report that they moved these Gaussians
    nearer.

    Gaussians visible to cameras are kept unless isolated. With fewer than ten cameras, Gaussians
    inside the enlarged hull are kept, because other cameras might see them. Gaussians with a value
    that is not finite are kept.

    Parameters
    ----------
    scene : open3d.t.geometry.PointCloud
        A cloud from `gs_codec.read`.
    cameras : path or sequence of Camera, optional
        The training cameras, or others that show everything to be kept; as in `gs_codec.render`,
        but not ``auto``. Without cameras, only isolated and far Gaussians are removed.

    Returns
    -------
    open3d.t.geometry.PointCloud
        The remaining Gaussians, in their original order, with all attributes.

    Raises
    ------
    InvalidInput
        If cameras cannot be read, or there are none.
    MissingTool
        If cameras are given, and scipy is not installed.

    Examples
    --------
    >>> cloud = gs_codec.read("scene.ply")
    >>> clean = gs_codec.edit.remove_floaters(cloud)
    >>> cleaner = gs_codec.edit.remove_floaters(cloud, "cameras.json")
    """
    labels = find_floaters(scene, cameras)
    return scene.take(labels == 0) if labels.any() else scene

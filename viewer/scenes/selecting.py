"""Which Gaussians a region of a picture, a range of a quantity, or a reason selects."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

import gs_codec
from gs_codec.edit.clusters import largest_cluster
from gs_codec.edit.floaters import find_floaters
from gs_codec.edit.selection import attribute_names, attribute_values, in_box
from gs_codec.formats.cloud import from_cloud
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.project import NEAR
from gs_codec.scene import Scene
from viewer.scenes.opened import Opened, Progress, Pruned
from viewer.scenes.pose import Pose


def in_region(
    scene: Opened,
    pose: Pose,
    size: tuple[int, int],
    corners: Sequence[tuple[float, float]],
    least_opacity: float = 0.0,
) -> NDArray[np.bool_]:
    """Which Gaussians have their centre in a region of a picture, and are drawn.

    Parameters
    ----------
    scene : Opened
    pose : Pose
    size : tuple of two int
        Width and height of the picture, pixels.
    corners : sequence of pairs of float
        Corners of a polygon, pixels; one that crosses itself holds what it surrounds once.
    least_opacity : float
        Those below it are not drawn, 0-1.

    Returns
    -------
    ndarray, shape (N,), bool
    """
    chosen = np.zeros(scene.count, bool)
    pixels, depth = pose.project(scene.positions, *size)
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    near = (depth > NEAR) & ((pixels >= low) & (pixels <= high)).all(axis=1)
    asked = np.flatnonzero(near & (scene.opacities >= least_opacity))
    chosen[asked] = in_polygon(pixels[asked], corners)
    return chosen


def in_polygon(points: NDArray, corners: Sequence[tuple[float, float]]) -> NDArray[np.bool_]:
    """Which points ``(n, 2)`` are in a polygon, by the even-odd rule."""
    order = np.argsort(points[:, 1], kind="stable")
    x, y = points[order].T
    odd = np.zeros(len(points), bool)
    for (x0, y0), (x1, y1) in zip(corners, [*corners[1:], corners[0]], strict=True):
        if y0 == y1:
            continue
        # Only the points between the ends of the edge, so that a long lasso is fast.
        level = slice(*np.searchsorted(y, sorted((y0, y1))))
        odd[level] ^= x[level] < x0 + (y[level] - y0) * ((x1 - x0) / (y1 - y0))
    inside = np.empty_like(odd)
    inside[order] = odd
    return inside


def box_corners(first: tuple[float, float], last: tuple[float, float]) -> list[tuple[float, float]]:
    """Corners of a rectangle with these opposite corners."""
    (x0, y0), (x1, y1) = first, last
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def quantity_names(scene: Opened) -> list[str]:
    """Names of the quantities that `quantity` has of a scene."""
    return [*attribute_names(gaussians_of(scene)), *_DERIVED]


def quantity(scene: Opened, name: str) -> NDArray:
    """A quantity ``(N,)`` of each Gaussian.

    It is an attribute of `gs_codec.edit.select`, in the same unit, or ``sh_energy``: the sum of
    squares of all SH-AC.

    Raises
    ------
    gs_codec.GsCodecError
        If the scene has none of this name.
    """
    gaussians = gaussians_of(scene)
    if name in _DERIVED:
        return _DERIVED[name](gaussians)
    if name not in attribute_names(gaussians):
        raise gs_codec.GsCodecError(f"quantity '{name}': {scene.name} has none of this name")
    return attribute_values(gaussians, name)


_DERIVED: Mapping[str, Callable[[Scene], NDArray]] = {
    "sh_energy": lambda scene: np.square(scene.f_rest, dtype=np.float64).sum(axis=0)
}


def in_range(scene: Opened, name: str, low: float, high: float) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` have a `quantity` from `low` to `high`, both included; no NaN."""
    values = quantity(scene, name)
    return (values >= low) & (values <= high)


def by_reason(scene: Opened, pruned: Pruned, reason: str) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` preparation removed for a reason of `Pruned`."""
    return pruned.of(scene).labels == 1 + pruned.reasons.index(reason)


def inside_box(scene: Opened, low: Sequence[float], high: Sequence[float]) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` `gs_codec.edit.crop_box` keeps; raises as it does."""
    return in_box(gaussians_of(scene), low, high)


def not_floating(
    scene: Opened, cameras: Sequence[Camera] | None, progress: Progress | None
) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` `gs_codec.edit.remove_floaters` keeps."""
    return find_floaters(gaussians_of(scene), cameras, progress) == 0


def in_largest_cluster(scene: Opened) -> NDArray[np.bool_]:
    """Which Gaussians ``(N,)`` `gs_codec.edit.keep_largest_cluster` keeps."""
    return largest_cluster(gaussians_of(scene))


def gaussians_of(scene: Opened) -> Scene:
    """The Gaussians as gs_codec's functions take them; they share memory."""
    return from_cloud(scene.cloud, "drop")

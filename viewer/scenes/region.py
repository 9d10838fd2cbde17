"""Regions of a picture, drawn with the mouse, and the Gaussians inside them."""

from __future__ import annotations

from collections.abc import Sequence
from math import dist

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.inria import as_camera
from gs_codec.rendering.footprint import covering
from viewer.scenes.appearance import Look, gaussians_drawn, which_drawn
from viewer.scenes.opened import Opened
from viewer.scenes.pose import Pose

Pixel = tuple[float, float]

#: Shapes of regions: a rectangle by opposite corners, a freehand line that is closed, a polygon by
#: its corners, and everything near a stroke.
REGIONS = ("box", "lasso", "polygon", "brush")

#: Minimum distance between successive places of a freehand line, pixels.
_STEP = 3

#: A click this near to the first corner closes a polygon, pixels.
_CLOSE = 8

#: A Gaussian is in front if the transmittance before it is at least this.
_FRONT = 0.5

_ANGLES = 2 * np.pi * np.arange(48) / 48
_CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)


class Region:
    """A region that is being drawn.

    Parameters
    ----------
    kind : str
        One of `REGIONS`.
    start : tuple of two float
        Position where the mouse button went down, pixels.
    radius : float
        Of a brush, pixels.
    """

    def __init__(self, kind: str, start: Pixel, radius: float = 0.0) -> None:
        self.kind, self._radius = kind, radius
        self.path = [start]

    def extend(self, place: Pixel) -> bool:
        """Extend the region to a position, pixels; return whether it changed."""
        if self.kind == "box":
            self.path[1:] = [place]
        elif self.kind != "polygon" and dist(place, self.path[-1]) < _STEP:
            return False
        else:
            self.path.append(place)
        return True

    def closes(self, place: Pixel) -> bool:
        """Whether a click at a position closes the polygon."""
        return len(self.path) > 2 and dist(place, self.path[0]) <= _CLOSE

    @property
    def corners(self) -> list[Pixel]:
        """Corners of the polygon; fewer than three if nothing was drawn."""
        if self.kind != "box" or len(self.path) < 2:
            return list(self.path)
        (x0, y0), (x1, y1) = self.path
        return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]

    def lines(self, at: Pixel) -> list[NDArray[np.float64]]:
        """Closed lines ``(n, 2)`` to show it with the mouse at a position, pixels."""
        if self.kind == "brush":
            return [circle(at, self._radius)]
        return [np.array([*self.corners, at] if self.kind == "polygon" else self.corners)]

    def covers(self, points: NDArray, since: int = 0) -> NDArray[np.bool_]:
        """Mask of the points ``(n, 2)`` in the region; of a brush, near its path from `since`."""
        if self.kind == "brush":
            return near_path(points, self.path[max(since, 0) :], self._radius)
        return in_polygon(points, self.corners)


def in_region(
    scene: Opened,
    pose: Pose,
    size: tuple[int, int],
    region: Region,
    look: Look | None = None,
    footprint: bool = False,
    front: bool = False,
) -> NDArray[np.bool_]:
    """Mask of the Gaussians in a region of a picture.

    Parameters
    ----------
    scene : Opened
    pose : Pose
    size : tuple of two int
        Width and height of the picture, pixels.
    region : Region
    look : Look, optional
        Gaussians that it does not draw are not selected.
    footprint : bool
        Whether to select the Gaussians whose splats cover a pixel of the region, not only those
        whose centres are in it.
    front : bool
        Whether to select only those that are seen: at a pixel that the splat covers (and that is in
        the region, with `footprint`), more than half of the light passes everything before it.

    Returns
    -------
    ndarray, shape (N,), bool
    """
    look = look or Look()
    drawn = which_drawn(scene, look)
    chosen = np.ones(scene.count, bool) if drawn is None else drawn.copy()
    if not footprint:
        chosen &= centres_in(region, *pose.project(scene.positions, *size), pose.near)
    if footprint or front:
        rows, columns = np.indices(size[::-1])
        pixels = np.stack([columns.ravel() + 0.5, rows.ravel() + 0.5], axis=1)
        wanted = region.covers(pixels).reshape(rows.shape) if footprint else rows >= 0
        camera = as_camera(pose.camera(*size))
        chosen &= covering(gaussians_drawn(scene, look), camera, wanted, _FRONT if front else 0.0)
    return chosen


def centres_in(
    region: Region, pixels: NDArray, depth: NDArray, near: float, since: int = 0
) -> NDArray[np.bool_]:
    """Mask of the centres in a region, from `Pose.project`; `since` is as in `Region.covers`."""
    chosen = np.zeros(len(pixels), bool)
    candidates = np.flatnonzero(depth > near)
    chosen[candidates] = region.covers(pixels[candidates], since)
    return chosen


def in_polygon(points: NDArray, corners: Sequence[Pixel]) -> NDArray[np.bool_]:
    """Mask of the points ``(n, 2)`` inside a polygon, by the even-odd rule."""
    inside = np.zeros(len(points), bool)
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    near = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    near = near[np.argsort(points[near, 1], kind="stable")]
    x, y = points[near].T
    odd = np.zeros(len(near), bool)
    for (x0, y0), (x1, y1) in zip(corners, [*corners[1:], corners[0]], strict=True):
        if y0 == y1:
            continue
        # Only points level with the edge, so that a long lasso is fast.
        level = slice(*np.searchsorted(y, sorted((y0, y1))))
        odd[level] ^= x[level] < x0 + (y[level] - y0) * ((x1 - x0) / (y1 - y0))
    inside[near] = odd
    return inside


def near_path(points: NDArray, path: list[Pixel], radius: float) -> NDArray[np.bool_]:
    """Mask of the points ``(n, 2)`` at most `radius` from an open line."""
    near = np.zeros(len(points), bool)
    for start, end in zip(path[:1] + path[:-1], path, strict=True):
        ends = np.array([start, end])
        low, high = ends.min(axis=0) - radius, ends.max(axis=0) + radius
        level = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
        along, away = ends[1] - ends[0], points[level] - ends[0]
        share = np.clip(away @ along / max(along @ along, 1e-12), 0, 1)
        near[level] |= np.linalg.norm(away - share[:, None] * along, axis=1) <= radius
    return near


def circle(centre: Pixel, radius: float) -> NDArray[np.float64]:
    """A circle as a closed line ``(n, 2)``."""
    return np.add(centre, radius * _CIRCLE)

"""Regions of a picture, drawn with the mouse, and the Gaussians inside them."""

from __future__ import annotations

from collections.abc import Sequence
from math import dist

import numpy as np
from numpy.typing import NDArray

from gs_codec.rendering.project import NEAR
from viewer.scenes.opened import Opened
from viewer.scenes.pose import Pose

Pixel = tuple[float, float]

#: Shapes of regions: a rectangle by opposite corners, or a freehand line that is closed.
REGIONS = ("box", "lasso")

#: Minimum distance between successive corners of a lasso, pixels.
_STEP = 3


class Region:
    """A region that is being drawn.

    Parameters
    ----------
    kind : str
        One of `REGIONS`.
    start : tuple of two float
        Position where the mouse button went down, pixels.
    """

    def __init__(self, kind: str, start: Pixel) -> None:
        self._kind = kind
        self._path = [start]

    def extend(self, place: Pixel) -> None:
        """Extend the region to a position, pixels."""
        if self._kind == "box":
            self._path[1:] = [place]
        elif dist(place, self._path[-1]) >= _STEP:
            self._path.append(place)

    @property
    def corners(self) -> list[Pixel]:
        """Corners of the polygon; fewer than three if nothing was drawn."""
        if self._kind == "lasso" or len(self._path) < 2:
            return list(self._path)
        (x0, y0), (x1, y1) = self._path
        return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def in_region(
    scene: Opened,
    pose: Pose,
    size: tuple[int, int],
    corners: Sequence[Pixel],
    drawn: NDArray[np.bool_] | None = None,
) -> NDArray[np.bool_]:
    """Mask of the Gaussians whose centres are in a region of a picture.

    Parameters
    ----------
    scene : Opened
    pose : Pose
    size : tuple of two int
        Width and height of the picture, pixels.
    corners : sequence of pairs of float
        Corners of a polygon, pixels; the even-odd rule applies if it crosses itself.
    drawn : ndarray, shape (N,), bool, or None
        Mask of Gaussians to select from; None for all.

    Returns
    -------
    ndarray, shape (N,), bool
    """
    chosen = np.zeros(scene.count, bool)
    pixels, depth = pose.project(scene.positions, *size)
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    near = (depth > NEAR) & ((pixels >= low) & (pixels <= high)).all(axis=1)
    candidates = np.flatnonzero(near if drawn is None else near & drawn)
    chosen[candidates] = in_polygon(pixels[candidates], corners)
    return chosen


def in_polygon(points: NDArray, corners: Sequence[Pixel]) -> NDArray[np.bool_]:
    """Mask of the points ``(n, 2)`` inside a polygon, by the even-odd rule."""
    order = np.argsort(points[:, 1], kind="stable")
    x, y = points[order].T
    odd = np.zeros(len(points), bool)
    for (x0, y0), (x1, y1) in zip(corners, [*corners[1:], corners[0]], strict=True):
        if y0 == y1:
            continue
        # Only points level with the edge, so that a long lasso is fast.
        level = slice(*np.searchsorted(y, sorted((y0, y1))))
        odd[level] ^= x[level] < x0 + (y[level] - y0) * ((x1 - x0) / (y1 - y0))
    inside = np.empty_like(odd)
    inside[order] = odd
    return inside

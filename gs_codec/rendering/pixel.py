"""The Gaussians that contribute to a pixel, and the contribution of a Gaussian to a view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.rendering.frame import make_frame, project_all
from gs_codec.rendering.project import (
    CENTRE_X,
    CENTRE_Y,
    DEPTH,
    FACTOR_XX,
    FACTOR_XY,
    FACTOR_YY,
    TILE,
    project,
)
from gs_codec.rendering.tiles_float64 import tile_bounds, tile_buffers, trace_splat
from gs_codec.runtime.kernels import kernel
from gs_codec.scene import Scene

#: Number of points of an outline.
_AROUND = 96


def pixel_weights(
    scene: Scene, camera: Camera, column: int, row: int, antialiased: bool | None = None
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The Gaussians that contribute to a pixel, nearest first, and weights alpha T, ``(n,)``.

    Parameters
    ----------
    scene : Scene
    camera : Camera
    column, row : int
        The pixel; the upper left one is 0, 0.
    antialiased : bool, optional
        As in `render`.
    """
    if antialiased is None:
        antialiased = scene.antialiased
    found = []
    for fields, tiles, gaussians in project_all(scene, camera, antialiased):
        first_x, end_x, first_y, end_y = tiles.T
        here = (first_x <= column // TILE) & (column // TILE < end_x)
        here &= (first_y <= row // TILE) & (row // TILE < end_y)
        found.append((fields[here], gaussians[here]))
    fields, gaussians = (np.concatenate(part) for part in zip(*found, strict=True))
    # Equal depths keep the scene's order.
    order = np.argsort(fields[:, DEPTH], kind="stable")
    weights = np.zeros(len(order))
    _weigh_pixel(fields[order], column, row, weights)
    drawn = weights > 0
    return gaussians[order][drawn], weights[drawn]


def gaussian_weight(
    scene: Scene, camera: Camera, gaussian: int, antialiased: bool | None = None
) -> tuple[float, int]:
    """Contribution of a Gaussian to a view: the sum of its weights alpha T, and its pixel count.

    `gaussian` is its index in `scene`; `antialiased` is as in `render`. The results equal those of
    `Accumulations`.
    """
    frame = make_frame(scene, camera, antialiased)
    splats = np.flatnonzero(frame.splats.gaussians == gaussian)
    totals = np.zeros((frame.columns * frame.rows, 2))
    for splat in splats:
        frame.over_tiles(_weigh_splat, camera.width, camera.height, splat, totals)
    weight, pixels = totals.sum(axis=0).tolist()
    return weight, round(pixels)


def splat_outline(
    scene: Scene,
    camera: Camera,
    gaussian: int,
    sigmas: float = 3.0,
    antialiased: bool | None = None,
) -> NDArray[np.float64] | None:
    """Outline ``(n, 2)`` of a Gaussian's splat at `sigmas` standard deviations, in pixels.

    The upper left corner of the image is (0, 0). None if the splat is not drawn.
    """
    if antialiased is None:
        antialiased = scene.antialiased
    fields = project(scene, camera, antialiased, gaussian, gaussian + 1).fields
    if not len(fields):
        return None
    field, angles = fields[0], 2 * np.pi * np.arange(_AROUND) / _AROUND
    down = sigmas * np.sin(angles) / field[FACTOR_YY]
    right = (sigmas * np.cos(angles) - field[FACTOR_XY] * down) / field[FACTOR_XX]
    return np.stack([field[CENTRE_X] + right, field[CENTRE_Y] + down], axis=1) + 0.5


@kernel
def _weigh_pixel(fields, column, row, weights):
    """Fill the weight of each splat, nearest first."""
    left, pixels, alphas, before = tile_buffers()
    left[:] = 1.0
    for i in range(len(fields)):
        count, done = trace_splat(
            fields[i], column, column + 1, row, row + 1, left, pixels, alphas, before
        )
        if count > 0:
            weights[i] = alphas[0] * before[0]
        if done > 0:
            break


@kernel
def _weigh_splat(fields, splats, starts, first, end, columns, width, height, wanted, totals):
    """Add the weights of a splat, and its pixels, in tiles `first` to `end`."""
    left, pixels, alphas, before = tile_buffers()
    for tile in range(first, end):
        last = starts[tile + 1] - 1
        while last >= starts[tile] and splats[last] != wanted:
            last -= 1
        if last < starts[tile]:
            continue
        x0, x1, y0, y1 = tile_bounds(tile, columns, width, height)
        left[:] = 1.0
        for pair in range(starts[tile], last + 1):
            count, _ = trace_splat(
                fields[splats[pair]], x0, x1, y0, y1, left, pixels, alphas, before
            )
        for i in range(count):
            totals[tile, 0] += alphas[i] * before[i]
        totals[tile, 1] += count

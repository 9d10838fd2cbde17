"""Cameras halfway between neighbours of a capture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gs_codec.cameras.camera import Camera

#: Number of neighbours of each camera between which views are added.
_NEIGHBOURS = 3

#: Weight of a turn of one radian, in distances to the nearest camera.
_TURN = 2.0

#: Minimum cosine of the angle between the directions of two neighbours.
_TOGETHER = 0.5


def cameras_between(cameras: Sequence[Camera]) -> list[Camera]:
    """A camera halfway between each camera and its three nearest neighbours in similar directions.

    They show what is between a capture's views: with few views, a Gaussian that none of them needs
    may be visible there. Distances include turns. The lens is that of one of the two.
    """
    if len(cameras) < 2:
        return []
    positions = np.array([camera.position for camera in cameras])
    rotations = np.array([camera.rotation for camera in cameras])
    forward = rotations[:, 2]
    squares = ((positions[:, None] - positions) ** 2).sum(axis=2)
    np.fill_diagonal(squares, np.inf)
    spacing = max(float(np.median(squares.min(axis=1))), 1e-30)
    cosines = forward @ forward.T
    apart = squares / spacing + 2 * _TURN**2 * (1 - cosines)
    # For turns above 120 degrees, the mean of two rotations is not meaningful.
    traces = np.einsum("aij,bij->ab", rotations, rotations)
    apart[(cosines < _TOGETHER) | (traces <= 0)] = np.inf
    found: dict[tuple[int, int], Camera] = {}
    for first, order in enumerate(np.argsort(apart, axis=1, kind="stable")[:, :_NEIGHBOURS]):
        for second in order:
            pair = min(first, int(second)), max(first, int(second))
            if np.isfinite(apart[pair]) and pair not in found:
                found[pair] = _halfway(cameras[first], cameras[second])
    return list(found.values())


def _halfway(first: Camera, second: Camera) -> Camera:
    """The camera halfway between two, with the lens of the first."""
    left, _, right = np.linalg.svd(first.rotation + second.rotation)
    return replace(
        first,
        name=f"{first.name} to {second.name}",
        rotation=left @ right,
        position=(first.position + second.position) / 2,
        split=None,
        lens=None,
    )

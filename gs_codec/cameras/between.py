"""Cameras halfway between neighbours of a capture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gs_codec.cameras.camera import Camera

#: Neighbours of each camera that views are put between.
_NEIGHBOURS = 3

#: How far a turn of a radian is, in distances to the nearest camera.
_TURN = 2.0

#: Least cosine between the directions of two neighbours.
_TOGETHER = 0.5


def cameras_between(cameras: Sequence[Camera]) -> list[Camera]:
    """A camera halfway between each and its three nearest neighbours, which look the same way.

    They show what lies between a capture's views: where these are few, a Gaussian that none of them
    needs may be seen from there. Distances count turns as well. The lens is that of one of the two.
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
    # Beyond a turn of 120 degrees in all, a mean of two rotations is hardly one.
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
    """Between two cameras, with the lens of the first."""
    left, _, right = np.linalg.svd(first.rotation + second.rotation)
    return replace(
        first,
        name=f"{first.name} to {second.name}",
        rotation=left @ right,
        position=(first.position + second.position) / 2,
        split=None,
        lens=None,
    )

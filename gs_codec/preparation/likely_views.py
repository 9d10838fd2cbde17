"""Extra views: directions weighted by the strength of SH-AC, and cameras between given ones.

Training changes the SH-AC of a Gaussian only in the directions of its cameras. Estimated cameras
may miss some of these directions, such as part of an arc. So each run of Gaussians is also viewed
from all around, with the highest weight where its SH-AC are strongest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.preparation.sh_weights import zero_weights
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene
from gs_codec.views.evidence import sh_bases, sphere

#: Number of directions.
_DIRECTIONS = 32

#: Weight of these views relative to the estimated ones. Chosen on fox, bonsai and captures of a
#: wall: at 0.5, true views of the wall lose 0.11 dB instead of 0.08; at 8, files are larger at
#: equal loss.
_SHARE = 4.0

#: Exponent of the SH-AC power in a direction, which varies by a factor of 3 over the directions.
#: With 1 and 3, compaction saves less at equal loss; with 6 and 10, directions of true cameras get
#: too little weight.
_POWER = 4

#: Number of Gaussians in a run; they are neighbours in the stream.
_RUN = 512

#: Gaussians below this quantile of mean square SH-AC have mostly noise.
_WEAK = 0.3

#: Gaussians not visible to any estimated camera get this quantile of the others' weights.
_UNSEEN = 0.02

#: Distance of these views from the scene, in units of its largest coordinate.
_FAR_AWAY = 1e5


class LikelyViews(NamedTuple):
    """Views from far away.

    Attributes
    ----------
    centres : ndarray, shape (M, 3)
    weights : ndarray, shape (M, N), float32
        Weights like the `squared_weights` of cameras.
    """

    centres: NDArray[np.float64]
    weights: NDArray[np.float32]


def likely_views(scene: Scene, weights: NDArray[np.float32]) -> LikelyViews:
    """Extra views of a scene with SH-AC, in stream order.

    Parameters
    ----------
    scene : Scene
        A scene of at least one Gaussian.
    weights : ndarray, shape (views, N), float32
        `squared_weights` of the estimated cameras.
    """
    directions = sphere(_DIRECTIONS)
    bases = sh_bases(directions, len(scene.f_rest) // 3)
    planes = scene.f_rest.reshape(3, -1, scene.count)
    mean = np.sum(planes.astype(np.float64) ** 2, axis=(0, 1)) / (4 * np.pi)
    least = max(float(np.quantile(mean, _WEAK)), 1e-30)
    total = weights.sum(axis=0, dtype=np.float64)
    if total.any():
        total = np.maximum(total, np.quantile(total[total > 0], _UNSEEN))
    found = zero_weights(_DIRECTIONS, scene.count)

    def fill(start: int) -> None:
        stop = min(start + _RUN, scene.count)
        shows = np.zeros(_DIRECTIONS)
        _add_shown(planes[:, :, start:stop], mean[start:stop] + least, bases, shows)
        powers = shows**_POWER
        shares = powers / powers.sum() if powers.any() else np.full(_DIRECTIONS, 1 / _DIRECTIONS)
        found[:, start:stop] = _SHARE * shares[:, None] * total[start:stop]

    run_all(fill, range(0, scene.count, _RUN))
    away = _FAR_AWAY * max(float(np.abs(scene.positions).max(initial=0.0)), 1e-30)
    return LikelyViews(-away * directions, found)


@kernel
def _add_shown(planes, scales, bases, shows):
    """Add to ``shows (M,)`` the squared SH colour in each direction, divided by ``scales (n,)``."""
    _, size, count = planes.shape
    for i in range(count):
        for m in range(len(bases)):
            power = 0.0
            for channel in range(3):
                colour = 0.0
                for k in range(size):
                    colour += planes[channel, k, i] * bases[m, k]
                power += colour * colour
            shows[m] += power / scales[i]


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
    distances = squares / spacing + 2 * _TURN**2 * (1 - cosines)
    # For turns above 120 degrees, the mean of two rotations is not meaningful.
    traces = np.einsum("aij,bij->ab", rotations, rotations)
    distances[(cosines < _TOGETHER) | (traces <= 0)] = np.inf
    found: dict[tuple[int, int], Camera] = {}
    for first, order in enumerate(np.argsort(distances, axis=1, kind="stable")[:, :_NEIGHBOURS]):
        for second in order:
            pair = min(first, int(second)), max(first, int(second))
            if np.isfinite(distances[pair]) and pair not in found:
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

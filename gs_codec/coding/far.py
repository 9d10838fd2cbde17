"""Far centres: a few that are so far away that a grid over all centres is too coarse for the rest.

Training leaves such strays, some at 1e8 times the size of a scene. What is ordered or quantised
over the range of all centres is then the same for all but the strays.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.runtime.arrays import empty
from gs_codec.scene import Scene

#: Largest share of centres that may be far; with fewer than eight centres, none is.
_MOST = 1 / 8

#: A scene is cut off where a grid gains most: bits per coordinate, less this many for all centres
#: that are outside, as a share of all: one for a hundredth of them.
_BITS = 100.0

#: And less this many for the sum over those outside of squares of size by distance: a background
#: of a few large Gaussians is no stray. At most so many bits, which make any grid too coarse.
_BITS_SEEN, _MOST_BITS_SEEN = 200.0, 6.0

#: Far is what is beyond this many times that distance: a scene's own outskirts are not.
_OUTSKIRTS = 4.0

#: On each axis the box reaches this share of its longest reach from the middle, to either side.
_THINNEST = 1 / 8

#: Standard deviations are not scaled below this share of the distance from the middle: a hundredth
#: of a pixel.
_FINEST = 1e-5

#: Renderers draw what is smaller than a pixel as a dot of the pixel. Such dots would be seen in the
#: wrong places, so they are as faint as Mip-Splatting makes them: with a low-pass of this variance
#: for pixels of this angle, radians; but not fainter than what no 8 bits hold (logit).
_LOW_PASS, _PIXEL, _FAINTEST = 0.3, 5e-4, -6.93

#: Centres that quantiles are estimated from, and those that are looked at together.
_SAMPLE, _AT_ONCE = 1 << 14, 1 << 18


@dataclass(frozen=True)
class Box:
    """An axis-parallel box.

    Attributes
    ----------
    low, high : ndarray, shape (3,), float64
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]


@dataclass(frozen=True)
class FarCentres:
    """Which centres are far, and where the others are.

    Attributes
    ----------
    far : ndarray, shape (F,), int64
        Indices of the far ones, ascending; at least one.
    middle : ndarray, shape (3,), float64
        Median of all centres.
    reach : float
        Largest distance of a near centre from the middle along an axis.
    farthest : float
        The same of all centres.
    near : Box
        The box of the near centres.
    """

    far: NDArray[np.int64]
    middle: NDArray[np.float64]
    reach: float
    farthest: float
    near: Box

    def box(self, factor: float = 1.0) -> Box:
        """The box of the near centres, made thicker where it is thin, enlarged about the middle."""
        thin = _THINNEST * self.reach
        return Box(
            self.middle - factor * np.maximum(self.middle - self.near.low, thin),
            self.middle + factor * np.maximum(self.near.high - self.middle, thin),
        )


def find_far(
    positions: NDArray[np.float32], log_scale: NDArray[np.float32] | None = None
) -> FarCentres | None:
    """The far ones of finite centres; None if there are none, as in most scenes.

    A distance is the largest of the three along axes, from the median. The best distance to cut a
    scene off is where a grid gains most: log2 of its size, less a bit for each hundredth of centres
    outside, and less up to six bits if those outside look large. What is beyond four times that
    distance is far.

    Parameters
    ----------
    positions : ndarray, shape (3, N)
    log_scale : ndarray, shape (3, N), optional
        Without it, Gaussians are points.
    """
    count = positions.shape[1]
    if count * _MOST < 1:
        return None
    some = positions[:, :: -(-count // _SAMPLE)].astype(np.float64)
    middle = np.median(some, axis=1)
    start = float(np.quantile(_distances(some, middle), 1 - 2 * _MOST))
    outer, where = _beyond(positions, middle, start)
    farthest = float(outer.max(initial=0.0))
    # The best distance is not less than the start: at most half of the outer ones are beyond it.
    if not farthest > _OUTSKIRTS * start:
        return None
    sizes = np.zeros(len(outer)) if log_scale is None else _sizes(log_scale[:, where], outer)
    order = np.argsort(outer)
    reach = _reach(outer[order], sizes[order], count)
    if reach == farthest:
        return None
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for _, part in _parts(positions):
        near = part[:, _distances(part, middle) <= reach]
        low = np.minimum(low, near.min(axis=1, initial=np.inf))
        high = np.maximum(high, near.max(axis=1, initial=-np.inf))
    return FarCentres(where[outer > reach], middle, reach, farthest, Box(low, high))


def _beyond(
    positions: NDArray[np.float32], middle: NDArray[np.float64], start: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Distances of the centres beyond one, and their indices."""
    found, where = [], []
    for first, part in _parts(positions):
        distances = _distances(part, middle)
        which = np.flatnonzero(distances > start)
        found.append(distances[which])
        where.append(first + which)
    return np.concatenate(found), np.concatenate(where)


def _parts(positions: NDArray[np.float32]) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Index of the first, and centres, of those that are looked at together."""
    for start in range(0, positions.shape[1], _AT_ONCE):
        yield start, positions[:, start : start + _AT_ONCE].astype(np.float64)


def _distances(points: NDArray[np.float64], middle: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.abs(points - middle[:, None]).max(axis=0)


def _sizes(log_scale: NDArray[np.float32], distances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squares of the longest standard deviations by distances, at most 1."""
    return np.exp(2 * np.fmin(log_scale.max(axis=0) - np.log(distances), 0.0))


def _reach(outer: NDArray[np.float64], sizes: NDArray[np.float64], count: int) -> float:
    """Largest distance of a near centre, of the sorted distances of the outermost."""
    most = int(_MOST * count) + 1
    outer, sizes = outer[-most:], sizes[-most:]
    outside = np.arange(len(outer) - 1, -1, -1) / count
    seen = np.cumsum(sizes[::-1])[::-1] - sizes
    lost = _BITS * outside + np.minimum(_BITS_SEEN * seen, _MOST_BITS_SEEN)
    best = outer[np.argmin(np.log2(outer) + lost)]
    return float(outer[np.searchsorted(outer, _OUTSKIRTS * best, "right") - 1])


def draw_nearer(scene: Scene, found: FarCentres | None, box: Box) -> tuple[Scene, tuple[str, ...]]:
    """Move far Gaussians that are outside a box onto its surface, and say so.

    Each moves along the ray from the scene's middle, and is scaled down by the same factor: from
    the middle it looks the same. Those smaller than a pixel fade, unless the scene asks for
    opacity compensation, which has the same effect.

    Parameters
    ----------
    scene : Scene
    found : FarCentres or None
        What `find_far` says of its centres.
    box : Box
        Holds all near centres.

    Returns
    -------
    scene : Scene
        The same one if nothing moves.
    lost : tuple of str
        What was done, in a sentence, if anything was.
    """
    if found is None:
        return scene, ()
    rays = scene.positions[:, found.far].astype(np.float64) - found.middle[:, None]
    with np.errstate(divide="ignore"):
        ends = np.where(rays > 0, box.high[:, None], box.low[:, None]) - found.middle[:, None]
        factors = (np.abs(ends) / np.abs(rays)).min(axis=0)
    moved = np.flatnonzero(factors < 1)
    if not len(moved):
        return scene, ()
    which, rays, factors = found.far[moved], factors[moved] * rays[:, moved], factors[moved]
    positions, log_scale = _copy(scene.positions), _copy(scene.log_scale)
    positions[:, which] = np.clip(found.middle[:, None] + rays, box.low[:, None], box.high[:, None])
    finest = np.log(_FINEST * np.sqrt((rays * rays).sum(axis=0)))
    scales = log_scale[:, which].astype(np.float64)
    log_scale[:, which] = np.maximum(scales + np.log(factors), np.minimum(scales, finest))
    opacity = scene.opacity
    if not scene.antialiased:
        opacity = _copy(scene.opacity)
        angles = scales - np.log(np.sqrt((rays * rays).sum(axis=0)) / factors)
        opacity[:, which] = _faded(scene.opacity[:, which], angles)
    drawn = replace(scene, positions=positions, log_scale=log_scale, opacity=opacity)
    return drawn, (_sentence(scene.positions, found, which),)


def bring_nearer(scene: Scene, factor: float = 1.0) -> tuple[Scene, tuple[str, ...]]:
    """A finite scene with its far Gaussians drawn to the box of the others, or to a larger one.

    Returns the same as `draw_nearer`; `factor` as for `FarCentres.box`.
    """
    found = find_far(scene.positions, scene.log_scale)
    return (scene, ()) if found is None else draw_nearer(scene, found, found.box(factor))


def _faded(opacity: NDArray[np.float32], angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Logits of Gaussians whose axes are seen under angles ``(3, n)``, by their logarithm."""
    wide = np.sort(np.exp(2 * (angles - np.log(_PIXEL))), axis=0)[1:]
    with np.errstate(over="ignore", divide="ignore"):
        share = np.sqrt((wide / (wide + _LOW_PASS)).prod(axis=0)) / (1 + np.exp(-opacity))
        logit = np.log(share) - np.log1p(-share)
    return np.maximum(logit, np.minimum(opacity, _FAINTEST))


def _copy(planes: NDArray[np.float32]) -> NDArray[np.float32]:
    copied = empty(planes.shape, np.float32)
    copied[:] = planes
    return copied


def _sentence(positions: NDArray[np.float32], found: FarCentres, moved: NDArray[np.int64]) -> str:
    distances = _distances(positions[:, moved].astype(np.float64), found.middle)
    stay = np.setdiff1d(found.far, moved)
    others = _distances(positions[:, stay].astype(np.float64), found.middle)
    least, most = float(distances.min()), float(distances.max())
    span = f"{most:.4g}" if f"{least:.4g}" == f"{most:.4g}" else f"{least:.4g} to {most:.4g}"
    return (
        f"{len(moved):,} of {positions.shape[1]:,} Gaussians, {span} from the middle of the scene "
        f"(the others: up to {others.max(initial=found.reach):.4g}), were moved nearer and scaled "
        "down to look the same, fainter if below a pixel; --remove-floaters removes such Gaussians"
    )

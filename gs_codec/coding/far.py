"""Far centres: the few so far away that a grid over all centres would be too coarse for the rest.

Training leaves such outliers, some at 1e8 times the size of the scene. On a grid over all centres,
the rest would fall into one cell.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.runtime.arrays import empty
from gs_codec.runtime.wording import counted
from gs_codec.scene import Scene

#: Maximum share of far centres; with fewer than eight centres, there are none.
_MOST = 1 / 8

#: A cut at a distance saves some bits per coordinate. It costs this many bits times the share of
#: centres outside: one bit for 1 % of them.
_BITS = 100.0

#: It also costs this many bits times the sum of (size / distance)^2 over the centres outside, so
#: that a background of a few large Gaussians is kept.
_BITS_SEEN = 200.0

#: Maximum of these bits.
_MOST_BITS_SEEN = 6.0

#: Centres beyond this factor times the best cut are far; those just beyond the cut are not.
_OUTSKIRTS = 4.0

#: Minimum half-width of the box on each axis, relative to the largest distance from the middle.
_THINNEST = 1 / 8

#: Minimum standard deviation after scaling, relative to the distance from the middle: a hundredth
#: of a pixel.
_FINEST = 1e-5

#: Renderers draw a Gaussian smaller than a pixel as a dot of one pixel. Far dots would appear in
#: the wrong places, so their opacity is reduced as Mip-Splatting does, with a low-pass of this
#: variance, square pixels.
_LOW_PASS = 0.3

#: Angle of a pixel, in radians.
_PIXEL = 5e-4

#: Opacity is not reduced below this logit, which rounds to zero in 8 bits.
_FAINTEST = -6.93

#: Maximum log of an angle in pixels; larger ones do not need fading.
_WIDEST = 100.0

#: Number of centres for estimating quantiles.
_SAMPLE = 1 << 14

#: Number of centres processed at once.
_AT_ONCE = 1 << 18


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
    """The far centres, and the extent of the near ones.

    Attributes
    ----------
    far : ndarray, shape (F,), int64
        Indices of the far centres, ascending; at least one.
    middle : ndarray, shape (3,), float64
        Median of all centres.
    reach : float
        Largest distance of a near centre from the middle along an axis.
    farthest : float
        Largest distance of any centre from the middle along an axis.
    near : Box
        The box of the near centres.
    """

    far: NDArray[np.int64]
    middle: NDArray[np.float64]
    reach: float
    farthest: float
    near: Box

    def box(self, factor: float = 1.0) -> Box:
        """The box of the near centres, with a minimum thickness, scaled about the middle."""
        thin = _THINNEST * self.reach
        return Box(
            self.middle - factor * np.maximum(self.middle - self.near.low, thin),
            self.middle + factor * np.maximum(self.near.high - self.middle, thin),
        )


def find_far(
    positions: NDArray[np.float32], log_scale: NDArray[np.float32] | None = None
) -> FarCentres | None:
    """Find the far centres among finite ones; None if there are none, as in most scenes.

    Distance means the largest distance from the median along an axis. The best cut has the largest
    gain: the bits per coordinate that a smaller grid saves, minus one for each hundredth of centres
    outside, minus up to six if those outside look large. Centres beyond four times that distance
    are far.

    Parameters
    ----------
    positions : ndarray, shape (3, N)
    log_scale : ndarray, shape (3, N), optional
        If None, Gaussians count as points.
    """
    count = positions.shape[1]
    if count * _MOST < 1:
        return None
    some = positions[:, :: -(-count // _SAMPLE)].astype(np.float64)
    middle = np.median(some, axis=1)
    start = float(np.quantile(_distances(some, middle), 1 - 2 * _MOST))
    outer, where = _beyond(positions, middle, start)
    farthest = float(outer.max(initial=0.0))
    # The best distance is at least `start`, because at most half of the outer centres are beyond
    # it.
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
    """Distances and indices of the centres beyond `start`."""
    found, where = [], []
    for first, part in _parts(positions):
        distances = _distances(part, middle)
        which = np.flatnonzero(distances > start)
        found.append(distances[which])
        where.append(first + which)
    return np.concatenate(found), np.concatenate(where)


def _parts(positions: NDArray[np.float32]) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Chunks of centres, each with the index of its first."""
    for start in range(0, positions.shape[1], _AT_ONCE):
        yield start, positions[:, start : start + _AT_ONCE].astype(np.float64)


def _distances(points: NDArray[np.float64], middle: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.abs(points - middle[:, None]).max(axis=0)


def _sizes(log_scale: NDArray[np.float32], distances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squared ratios of the longest standard deviation to the distance, at most 1."""
    return np.exp(2 * np.fmin(log_scale.max(axis=0) - np.log(distances), 0.0))


def _reach(outer: NDArray[np.float64], sizes: NDArray[np.float64], count: int) -> float:
    """Largest distance of a near centre; `outer` are the sorted distances of the outermost."""
    most = int(_MOST * count) + 1
    outer, sizes = outer[-most:], sizes[-most:]
    outside = np.arange(len(outer) - 1, -1, -1) / count
    seen = np.cumsum(sizes[::-1])[::-1] - sizes
    lost = _BITS * outside + np.minimum(_BITS_SEEN * seen, _MOST_BITS_SEEN)
    best = outer[np.argmin(np.log2(outer) + lost)]
    return float(outer[np.searchsorted(outer, _OUTSKIRTS * best, "right") - 1])


def draw_nearer(scene: Scene, found: FarCentres | None, box: Box) -> tuple[Scene, tuple[str, ...]]:
    """Move far Gaussians outside a box onto its surface, and describe what was done.

    Each moves along the ray from the scene's middle and is scaled down by the same factor, so that
    it looks the same from the middle. The opacity of those smaller than a pixel is reduced, unless
    the scene uses opacity compensation, which has the same effect.

    Parameters
    ----------
    scene : Scene
    found : FarCentres or None
        Result of `find_far` for its centres.
    box : Box
        Contains all near centres.

    Returns
    -------
    scene : Scene
        The same one if nothing moves.
    lost : tuple of str
        One sentence on what was done; empty if nothing was.
    """
    if found is None:
        return scene, ()
    rays = scene.positions[:, found.far].astype(np.float64) - found.middle[:, None]
    ends = np.where(rays > 0, box.high[:, None], box.low[:, None]) - found.middle[:, None]
    # Far from the origin, float spacing may exceed the thickness of a box.
    ends = np.maximum(np.abs(ends), np.spacing(np.abs(found.middle))[:, None])
    with np.errstate(divide="ignore"):
        factors = (ends / np.abs(rays)).min(axis=0)
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
    """Move the far Gaussians of a finite scene to the box of the others, scaled by `factor`.

    Returns the same as `draw_nearer`.
    """
    found = find_far(scene.positions, scene.log_scale)
    return (scene, ()) if found is None else draw_nearer(scene, found, found.box(factor))


def _faded(opacity: NDArray[np.float32], angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Reduced logits of Gaussians; `angles` ``(3, n)`` are logs of the angles of their axes."""
    wide = np.sort(np.exp(2 * np.minimum(angles - np.log(_PIXEL), _WIDEST)), axis=0)[1:]
    with np.errstate(over="ignore", divide="ignore"):
        share = np.sqrt((wide / (wide + _LOW_PASS)).prod(axis=0)) / (1 + np.exp(-opacity))
        logit = np.log(share) - np.log1p(-share)
    return np.clip(logit, np.minimum(opacity, _FAINTEST), opacity)


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
        f"{len(moved):,} of {counted(positions.shape[1], 'Gaussian')}, {span} from the "
        f"middle of the scene (the others at most {others.max(initial=found.reach):.4g}), moved "
        'nearer and scaled down to look the same; Action("remove-floaters") removes them instead'
    )

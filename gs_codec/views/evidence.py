"""Estimate camera positions and the up direction from traces of training in a scene.

Training changes the SH-AC of a Gaussian only in the directions of its cameras: there they are
strong, elsewhere almost 0. So positions from which the surrounding Gaussians show strong SH-AC are
near cameras; and floors show strong SH-AC on one side, which is up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.clean import finite_gaussians, solid_gaussians
from gs_codec.coding.exact_math import combine, exact_log
from gs_codec.rendering.harmonics import sh_basis
from gs_codec.rendering.project import quaternion_turn
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene

#: Approximate number of Gaussians used for the estimate, enlarged to cover the same surfaces.
_THUMB_GAUSSIANS = 50_000


class _Tried(NamedTuple):
    """Number of positions tried, Gaussians that each is tested on, and share that is kept."""

    places: int
    witnesses: int
    stay: float


#: For estimated cameras. With fewer positions, views are too similar.
_THOROUGH = _Tried(6000, 2500, 0.1)

#: For a quick estimate.
_QUICK = _Tried(3000, 800, 0.05)

#: Minimum distance of a position from a Gaussian, in units of the scene's size.
_NEAREST = 0.3

#: Maximum distance of a position from a Gaussian and from the scene's centre, in units of its
#: reach.
_FARTHEST = 3.0

#: Added to the share of SH-AC visible in a direction before its logarithm is taken.
_FLOOR = 0.3

#: Positions are estimated if the mean logarithm of visible SH-AC in the kept positions exceeds that
#: in all positions by at least this. A real room and captures in five styles reach 0.39 to 0.89; a
#: real orbit whose estimated cameras mislead reaches 0.31, a quantised garden 0.22.
_TELLING = 0.35

#: Maximum logarithm of the typical size of Gaussians, so that squares of distances are finite.
_LARGEST = 80.0

#: Number of points whose SH are evaluated together.
_AT_ONCE = 64

#: Number of directions in the upper hemisphere.
_DIRECTIONS = 1000

#: Normals count for a direction if the cosine of the angle between them is at least this.
_ALIKE = 0.99

#: Number of frequent normal directions that are compared.
_MODES = 4

#: Up in most captures.
_USUAL_UP = np.array([0.0, -1.0, 0.0])

#: Maximum weight of one-sidedness for an axis, in powers of e: cameras also see walls from one
#: side.
_ONE_SIDED = 1.0

#: Preference for axes near -y in scenes without estimated positions, in powers of e of more flat
#: Gaussians.
_PREFERENCE = 0.8

#: Axes whose scores differ by less count as equally likely, in powers of e. In the 24 of 28 scenes
#: where the best is right, scores differ by 0.42 or more.
_TIE = 0.25

#: Cameras face along the up axis, as above a floor or in front of a wall, if the median cosine of
#: the angle between up and the camera positions is larger. Above floors and in front of walls it is
#: 0.67 to 0.79, around objects and in rooms at most 0.5, which is also that of a hemisphere.
_FACING = 0.6

#: Scenes without estimated positions have a floor if the most frequent normal has this many times
#: the flat Gaussians of the median one. Rooms, tables and fields have 5 to 27 times; plants, people
#: and gardens 2 to 4.
_FLAT = 4.5


@dataclass(frozen=True)
class Evidence:
    """Evidence in a scene about its cameras.

    Attributes
    ----------
    thumb : Scene
        Every k-th solid Gaussian, larger by sqrt(k).
    size : float
        Median distance of Gaussians from the scene's centre.
    subject : ndarray, shape (N,), bool
        The smallest Gaussians of `thumb`; all, if camera positions cannot be estimated.
    places : ndarray, shape (P, 3)
        Likely camera positions, the likeliest first.
    up : ndarray, shape (3,)
        Unit vector.
    up_certain : bool
        Whether `up` is certain: not if two axes are equally likely, or if cameras may have faced
        either a wall or a floor.
    telling : bool
        Whether the positions could be estimated; otherwise they are spread around the scene.
    """

    thumb: Scene
    size: float
    subject: NDArray[np.bool_]
    places: NDArray[np.float64]
    up: NDArray[np.float64]
    up_certain: bool
    telling: bool


def gather_evidence(
    scene: Scene, quick: bool = False, progress: Progress | None = None
) -> Evidence | None:
    """Gather the evidence in a scene about its cameras; None if it has no finite Gaussians.

    The same scene gives the same positions. `quick` tries fewer, and assumes that -y is up.
    """
    thumb = _thinned(scene)
    if not thumb.count:
        return None
    points, sizes = thumb.positions.T.astype(np.float64), _log_sizes(thumb)
    centre = np.median(points, axis=0)
    distance = np.linalg.norm(points - centre, axis=1)
    # View a single Gaussian from a distance of its own size, but not below float resolution.
    least = max(float(np.spacing(np.float32(np.abs(centre).max()))), 1e-6)
    typical = float(np.exp(min(np.median(sizes), _LARGEST)))
    size = max(float(np.median(distance)), typical, least)
    reach = max(float(np.quantile(distance, 0.75)), size)
    shown = _shown(thumb)
    tried = _QUICK if quick else _THOROUGH
    places, shows = _places(points, shown, centre, size, reach, tried, progress)
    order = np.argsort(-shows, kind="stable")[: max(1, int(tried.stay * tried.places))]
    telling = bool(shows[order].mean() - shows.mean() > _TELLING)
    subject = (sizes <= np.quantile(sizes, 0.1)) | (not telling)
    likely = places[order]
    up, is_certain = _USUAL_UP, False
    if not quick:
        up, is_certain = _vertical(thumb, shown, subject, likely, telling)
    return Evidence(thumb, size, subject, likely, up, is_certain, telling)


def _thinned(scene: Scene) -> Scene:
    """Thin out a scene; see `Evidence.thumb`."""
    usable = finite_gaussians(scene) & scene.rot.any(axis=0)
    index = solid_gaussians(scene.opacity[0], usable)
    step = max(1, len(index) // _THUMB_GAUSSIANS)
    thumb = scene.take(index[::step])
    return replace(thumb, log_scale=thumb.log_scale + np.float32(0.5 * np.log(step)))


def _log_sizes(scene: Scene) -> NDArray[np.float64]:
    """Logarithm of the geometric mean of the two longer axes ``(N,)``."""
    return np.sort(scene.log_scale.astype(np.float64), axis=0)[1:].mean(axis=0)


def _shown(scene: Scene) -> NDArray[np.float32]:
    """SH-AC ``(3, K, N)`` normalised to a mean square of 1 over directions; weak ones less."""
    sh = scene.f_rest.reshape(3, -1, scene.count)
    mean = np.sum(sh.astype(np.float64) ** 2, axis=(0, 1)) / (4 * np.pi)
    least = np.quantile(mean, 0.2)
    return (sh / np.sqrt(np.maximum(mean + least, 1e-30))).astype(np.float32)


def _places(
    points: NDArray[np.float64],
    shown: NDArray[np.float32],
    centre: NDArray[np.float64],
    size: float,
    reach: float,
    tried: _Tried,
    progress: Progress | None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Random positions ``(P, 3)``, and the mean logarithm of the SH-AC visible from each."""
    rng = np.random.default_rng(0)
    inner = points[np.linalg.norm(points - centre, axis=1) <= 1.5 * reach]
    sides = rng.standard_normal((tried.places, 3))
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)
    low, high = np.log([_NEAREST * size, _FARTHEST * reach])
    away = np.exp(rng.uniform(low, high, (tried.places, 1)))
    places = inner[rng.integers(len(inner), size=tried.places)] + away * sides
    places = places[np.linalg.norm(places - centre, axis=1) <= _FARTHEST * reach]
    some = rng.integers(len(points), size=tried.witnesses)
    shows, soft = np.zeros(len(places)), (_NEAREST * size) ** 2
    seen, around = np.ascontiguousarray(shown[:, :, some]), np.ascontiguousarray(points[some].T)
    if seen.any():
        parts = np.array_split(np.arange(len(places)), 16)
        advance = step_counter(progress, "cameras", len(parts))
        weigh = partial(_weigh, around, seen, places, soft, shows)
        run_all(weigh, parts, advance=advance)
    return places, shows


@kernel
def _weigh(points, shown, places, soft, shows, part):
    """Fill the mean logarithm of SH-AC visible on ``points (3, n)``; near ones count most."""
    size, count = shown.shape[1], points.shape[1]
    # Loops over a few points at once, for vector instructions.
    xs, ys, zs, weights, powers, colour = np.empty((6, _AT_ONCE))
    bases = np.empty((15, _AT_ONCE))
    for place in part:
        total = whole = 0.0
        for first in range(0, count, _AT_ONCE):
            some = min(_AT_ONCE, count - first)
            for j in range(some):
                x = points[0, first + j] - places[place, 0]
                y = points[1, first + j] - places[place, 1]
                z = points[2, first + j] - places[place, 2]
                square = x * x + y * y + z * z
                distance = math.sqrt(square) + 1e-12
                xs[j], ys[j], zs[j] = x / distance, y / distance, z / distance
                weights[j] = 1.0 / (square + soft)
                powers[j] = 0.0
            for j in range(some):
                sh_basis(xs[j], ys[j], zs[j], size, bases[:, j])
            for channel in range(3):
                for j in range(some):
                    colour[j] = 0.0
                for k in range(size):
                    values, basis = shown[channel, k, first : first + some], bases[k]
                    for j in range(some):
                        colour[j] += values[j] * basis[j]
                for j in range(some):
                    powers[j] += colour[j] * colour[j]
            for j in range(some):
                powers[j] = exact_log(powers[j] + _FLOOR)
            for j in range(some):
                total += weights[j] * powers[j]
                whole += weights[j]
        shows[place] = total / whole


def sh_bases(directions: NDArray[np.float64], coefficients: int) -> NDArray[np.float64]:
    """The SH-AC basis ``(D, K)`` in ``directions (D, 3)``, from the camera to the Gaussian."""
    bases = np.empty((len(directions), coefficients))
    _fill_bases(directions, bases)
    return bases


@kernel
def _fill_bases(directions, bases):
    for i in range(len(directions)):
        sh_basis(directions[i, 0], directions[i, 1], directions[i, 2], bases.shape[1], bases[i])


def _vertical(
    scene: Scene,
    shown: NDArray[np.float32],
    subject: NDArray[np.bool_],
    places: NDArray[np.float64],
    telling: bool,
) -> tuple[NDArray[np.float64], bool]:
    """Up direction: a frequent normal of flat Gaussians, along which positions differ least.

    The sign follows from the side on which those Gaussians show SH-AC, and from the side of the
    subject relative to the positions. Without estimated positions, up is -y, as in most captures;
    if there is a floor, it is a normal near -y, or else on the side of +z. Among equally likely
    normals, one near -y is replaced by -y. Also returns whether the axis is certain.
    """
    normals, flatness = _normals(scene)
    some = slice(None, None, max(1, scene.count // 5000))
    axes = sphere(2 * _DIRECTIONS)[_DIRECTIONS:]
    level = np.abs(np.einsum("ia,ja->ij", axes, normals[some])) > _ALIKE
    found = np.einsum("ij,j->i", level, flatness[some])
    if not telling and found.max() < _FLAT * np.median(found):
        return _USUAL_UP, False
    likely = np.log(found + 1e-3 * (found.max() + 1))
    if telling:
        offsets = places - places.mean(axis=0)
        spread = np.mean(np.einsum("ia,ja->ij", axes, offsets) ** 2, axis=1)
        likely = likely - np.log(np.maximum(spread, 1e-12))
    modes = []
    left = np.ones(len(axes), bool)
    for _ in range(_MODES):
        mode = int(np.argmax(np.where(left, found, -1.0)))
        axis, score = axes[mode], float(likely[mode])
        left &= np.abs(combine(axis, axes.T)) < 0.8
        flat = np.abs(combine(axis, normals.T)) > _ALIKE - 0.04
        upside = bool(abs(axis[1]) > 0.8)
        if telling:
            side = _side(shown[:, :, flat], axis)
            score += min(abs(side), _ONE_SIDED)
            side += _above(scene.positions[:, subject], places, axis)
        else:
            side = -axis[1] if upside else axis[2]
            score += _PREFERENCE * upside
        up = _mean_normal(normals[flat], flatness[flat], axis) * (1 if side >= 0 else -1)
        modes.append(_Mode(score, upside, up))
    best = max(modes, key=lambda mode: mode.score)
    if not telling:
        return best.up, True
    if not best.upside:
        rivals = [mode for mode in modes if mode.score > best.score - _TIE and mode is not best]
        if rivals:
            return (_USUAL_UP if any(mode.upside for mode in rivals) else best.up), False
    middle = np.median(scene.positions[:, subject].astype(np.float64), axis=1)
    return best.up, not _is_faced(places - middle, best.up)


def _normals(scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Normals ``(N, 3)`` of Gaussians, and their flatness, in powers of e."""
    normals = np.empty((scene.count, 3))
    _fill_axes(np.ascontiguousarray(scene.rot), np.argmin(scene.log_scale, axis=0), normals)
    scales = np.sort(scene.log_scale.astype(np.float64), axis=0)
    return normals, np.clip(scales[1] - scales[0], 0, 3)


@kernel
def _fill_axes(rot, which, axes):
    """One axis of each Gaussian, of length 1."""
    for i in range(len(axes)):
        _, turn = quaternion_turn(rot, i)
        for k in range(3):
            axes[i, k] = turn[k][which[i]]


class _Mode(NamedTuple):
    """A direction of many normals: its score as up or down, whether it is near y, and as up."""

    score: float
    upside: bool
    up: NDArray[np.float64]


def _mean_normal(
    normals: NDArray[np.float64], weights: NDArray[np.float64], axis: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Mean of normals near an axis, flipped to its side; the axis itself if there are none."""
    towards = normals * np.sign(combine(axis, normals.T))[:, None]
    mean = np.sum(towards * weights[:, None], axis=0)
    length = float(np.linalg.norm(mean))
    return mean / length if length > 0 else axis


def _is_faced(offsets: NDArray[np.float64], axis: NDArray[np.float64]) -> bool:
    """Whether most positions, given as offsets from a subject, are straight in front of it."""
    away = np.maximum(np.linalg.norm(offsets, axis=1), 1e-12)
    return bool(np.median(combine(axis, offsets.T) / away) > _FACING)


def _side(shown: NDArray[np.float32], axis: NDArray[np.float64]) -> float:
    """Log of the ratio of SH-AC visible from along `axis` to those from behind."""
    directions = sphere(64)
    bases = sh_bases(directions, shown.shape[1])
    some = shown[:, :, :: max(1, shown.shape[2] // 2000)]
    powers = np.sum(np.einsum("dk,ckn->cdn", bases, some) ** 2, axis=(0, 2))
    # The SH basis uses directions from the camera.
    ahead = combine(axis, directions.T)
    above, below = powers[ahead < -0.5].sum(), powers[ahead > 0.5].sum()
    return float(np.log(above / below)) if above > 0 and below > 0 else 0.0


def _above(
    points: NDArray[np.float32], places: NDArray[np.float64], axis: NDArray[np.float64]
) -> float:
    """Log of the mean ratio of points below positions, along `axis`, to points above them."""
    heights = np.sort(combine(axis, points.astype(np.float64)))
    below = np.searchsorted(heights, combine(axis, places.T)).mean() + 1
    return float(np.log(below / (len(heights) + 2 - below)))


def sphere(count: int) -> NDArray[np.float64]:
    """Evenly spaced unit vectors ``(count, 3)``: golden-angle steps up the sphere."""
    height = (2 * np.arange(count) + 1) / count - 1
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    ring = np.sqrt(1 - height**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1)

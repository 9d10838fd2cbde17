"""Virtual cameras for a scene that comes without any.

Training changes the SH-AC of a Gaussian only in directions in which cameras saw it: they hold
signal there, and next to nothing elsewhere. So places from which the Gaussians around show much of
their SH-AC are near those of the cameras; and walls and floors are seen from one side only, which
tells up from down. Views look from such places at random Gaussians, as these are densest where
cameras looked. Those that show holes or close-ups go; of the others, those stay that together see
most.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.linear import combine
from gs_codec.errors import InvalidInput
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.harmonics import sh_basis
from gs_codec.rendering.project import NEAR
from gs_codec.rendering.renderer import render
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.threads import run_all
from gs_codec.scene import GROUPS, Scene

#: Size of the images, pixels; the field of view is 51 degrees wide.
WIDTH, HEIGHT = 600, 400
_FOCAL = 1.04 * WIDTH

#: Candidates are judged on about this many Gaussians, enlarged to cover the same surfaces.
_THUMB_GAUSSIANS = 50_000
_THUMB = (96, 64)

#: Gaussians below this logit (opacity 0.3) say little about where surfaces are.
_SOLID = -0.85

#: Places that are tried, the Gaussians that each is tried on, and the share of the places that
#: stay. With a smaller share, views are too much alike.
_PLACES, _WITNESSES, _STAY = 6000, 2500, 0.1

#: Distances of places from a Gaussian: from this part of the scene's size to that of its reach; and
#: the largest distance from the scene's centre in units of its reach.
_NEAREST, _FARTHEST = 0.3, 3.0

#: Added to the share of SH-AC that a direction shows before its logarithm is taken.
_FLOOR = 0.3

#: Views that are tried for each that is asked for, their least number, and the share to choose from.
_TRIED, _LEAST_TRIED, _GOOD = 3, 96, 0.6

#: Views tried for an overview.
_OVERVIEWS = 48

#: Directions of the upper half of a sphere, cosine of the normals that count as one direction, and
#: how many directions of normals are compared.
_DIRECTIONS, _ALIKE, _MODES = 1000, 0.99, 4


@dataclass(frozen=True)
class _Layout:
    """A scene's centre, the median distance from there, a far one, and what it looks detailed at."""

    centre: NDArray[np.float64]
    size: float
    reach: float
    focus: NDArray[np.float64]


def auto_cameras(scene: Scene, count: int = 24) -> list[Camera]:
    """Choose cameras near those that a scene was trained with: first an overview, then others.

    The same scene gives the same cameras, of `WIDTH` x `HEIGHT` pixels. Without SH-AC nothing tells
    where cameras were: they are anywhere around.

    Raises
    ------
    InvalidInput
        If no view shows anything.
    """
    thumb = _thinned(scene)
    chosen: list[Camera] = []
    if thumb.count and count > 0:
        rng = np.random.default_rng(0)
        layout, shown = _layout(thumb), _shown(thumb)
        places = _places(thumb, layout, shown, rng)
        up = _vertical(thumb, shown, places)
        first = _overview(thumb, layout, places, up, rng)
        chosen = [*first, *_others(thumb, layout, places, up, rng, count - len(first))]
    if not chosen:
        raise InvalidInput("cameras 'auto': no view shows anything of the scene")
    return [replace(view, name=f"auto_{n:02d}") for n, view in enumerate(chosen)]


def _thinned(scene: Scene) -> Scene:
    """Every k-th solid Gaussian (of all, if none is), larger by sqrt(k)."""
    finite = np.all([np.isfinite(getattr(scene, group)).all(axis=0) for group in GROUPS], axis=0)
    usable = finite & scene.rot.any(axis=0)
    solid = usable & (scene.opacity[0] > _SOLID)
    index = np.flatnonzero(solid if solid.any() else usable)
    step = max(1, len(index) // _THUMB_GAUSSIANS)
    thumb = scene.take(index[::step])
    return replace(thumb, log_scale=thumb.log_scale + np.float32(0.5 * np.log(step)))


def _layout(scene: Scene) -> _Layout:
    points, sizes = scene.positions.T.astype(np.float64), _log_sizes(scene)
    centre = np.median(points, axis=0)
    distance = np.linalg.norm(points - centre, axis=1)
    # A single Gaussian is looked at from a distance of its own size.
    size = max(float(np.median(distance)), float(np.exp(np.median(sizes))), 1e-6)
    reach = max(float(np.quantile(distance, 0.75)), size)
    focus = np.median(points[sizes <= np.quantile(sizes, 0.1)], axis=0)
    return _Layout(centre, size, reach, focus)


def _log_sizes(scene: Scene) -> NDArray[np.float64]:
    """Logarithm of the geometric mean of the two longer axes ``(N,)``."""
    return np.sort(scene.log_scale.astype(np.float64), axis=0)[1:].mean(axis=0)


def _shown(scene: Scene) -> NDArray[np.float32]:
    """SH-AC ``(3, K, N)`` of which a direction shows a square of 1 in the mean, of all but weak."""
    sh = scene.f_rest.reshape(3, -1, scene.count)
    mean = np.sum(sh.astype(np.float64) ** 2, axis=(0, 1)) / (4 * np.pi)
    least = np.quantile(mean, 0.2)
    return (sh / np.sqrt(np.maximum(mean + least, 1e-30))).astype(np.float32)


def _places(
    scene: Scene, layout: _Layout, shown: NDArray[np.float32], rng: np.random.Generator
) -> NDArray[np.float64]:
    """Places ``(P, 3)`` from which the Gaussians around show most of their SH-AC."""
    points = scene.positions.T.astype(np.float64)
    inner = points[np.linalg.norm(points - layout.centre, axis=1) <= 1.5 * layout.reach]
    sides = rng.standard_normal((_PLACES, 3))
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)
    low, high = np.log([_NEAREST * layout.size, _FARTHEST * layout.reach])
    away = np.exp(rng.uniform(low, high, (_PLACES, 1)))
    places = inner[rng.integers(len(inner), size=_PLACES)] + away * sides
    places = places[np.linalg.norm(places - layout.centre, axis=1) <= _FARTHEST * layout.reach]
    some = rng.integers(scene.count, size=_WITNESSES)
    evidence, soft = np.zeros(len(places)), (_NEAREST * layout.size) ** 2
    seen, around = np.ascontiguousarray(shown[:, :, some]), np.ascontiguousarray(points[some])
    if seen.any():
        parts = np.array_split(np.arange(len(places)), 16)
        run_all(lambda part: _weigh(around, seen, places, soft, evidence, part), parts)
    return places[np.argsort(-evidence, kind="stable")[: max(1, int(_STAY * _PLACES))]]


@kernel
def _weigh(points, shown, places, soft, evidence, part):
    """Fill the mean logarithm of what points ``(n, 3)`` show; those near by count most."""
    basis = np.empty(15)
    size = shown.shape[1]
    for place in part:
        total = weights = 0.0
        for i in range(len(points)):
            x = points[i, 0] - places[place, 0]
            y = points[i, 1] - places[place, 1]
            z = points[i, 2] - places[place, 2]
            square = x * x + y * y + z * z
            distance = math.sqrt(square) + 1e-12
            sh_basis(x / distance, y / distance, z / distance, size, basis)
            power = 0.0
            for channel in range(3):
                colour = 0.0
                for k in range(size):
                    colour += shown[channel, k, i] * basis[k]
                power += colour * colour
            weight = 1.0 / (square + soft)
            total += weight * math.log(power + _FLOOR)
            weights += weight
        evidence[place] = total / weights


@kernel
def _fill_bases(directions, bases):
    """Fill ``bases (D, K)`` with the SH-AC basis in ``directions (D, 3)``."""
    for i in range(len(directions)):
        sh_basis(
            directions[i, 0], directions[i, 1], directions[i, 2], bases.shape[1], bases[i]
        )


def _vertical(
    scene: Scene, shown: NDArray[np.float32], places: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Up direction: a normal of many flat Gaussians, along which places differ least.

    Those Gaussians show their SH-AC to one side, which is up. Without SH-AC, up is away from where
    they are.
    """
    from scipy.spatial.transform import Rotation

    flattest = np.argmin(scene.log_scale, axis=0)
    turn = Rotation.from_quat(scene.rot.T, scalar_first=True).as_matrix()
    normals = turn[np.arange(scene.count), :, flattest]
    scales = np.sort(scene.log_scale.astype(np.float64), axis=0)
    flatness = np.clip(scales[1] - scales[0], 0, 3)
    some = slice(None, None, max(1, scene.count // 5000))
    axes = _sphere(2 * _DIRECTIONS)[_DIRECTIONS:]
    level = np.abs(np.einsum("ia,ja->ij", axes, normals[some]))
    found = np.einsum("ij,j->i", level > _ALIKE, flatness[some])
    found += 1e-3 * (found.max() + 1)
    offsets = places - places.mean(axis=0)
    spread = np.sqrt(np.mean(np.einsum("ia,ja->ij", axes, offsets) ** 2, axis=1))
    best, up = -np.inf, axes[0]
    left = np.ones(len(axes), bool)
    for _ in range(_MODES):
        if not left.any():
            break
        mode = int(np.argmax(np.where(left, found, 0.0)))
        axis = axes[mode]
        left &= np.abs(combine(axis, axes.T)) < 0.8
        flat = np.abs(combine(axis, normals.T)) > _ALIKE - 0.04
        side = _side(shown[:, :, flat], axis)
        if side == 0.0:
            heights = combine(axis, scene.positions[:, flat].astype(np.float64))
            below = np.median(combine(axis, scene.positions.astype(np.float64)))
            side = 1e-3 * (1.0 if np.sum(heights - below) < 0 else -1.0)
        score = np.log(found[mode]) - 2 * np.log(max(spread[mode], 1e-12)) + abs(side)
        if score > best:
            towards = normals[flat] * np.sign(combine(axis, normals[flat].T))[:, None]
            mean = np.sum(towards * flatness[flat, None], axis=0)
            length = float(np.linalg.norm(mean))
            best, up = float(score), np.sign(side) * (mean / length if length > 0 else axis)
    return up


def _side(shown: NDArray[np.float32], axis: NDArray[np.float64]) -> float:
    """Log of how much more Gaussians show of their SH-AC from along `axis` than from behind."""
    directions = _sphere(64)
    bases = np.empty((len(directions), shown.shape[1]))
    _fill_bases(directions, bases)
    some = shown[:, :, :: max(1, shown.shape[2] // 2000)]
    powers = np.sum(np.einsum("dk,ckn->cdn", bases, some) ** 2, axis=(0, 2))
    # A basis is that of the direction from the camera.
    ahead = combine(axis, directions.T)
    above, below = powers[ahead < -0.5].sum(), powers[ahead > 0.5].sum()
    return float(np.log(above / below)) if above > 0 and below > 0 else 0.0


def _overview(
    scene: Scene,
    layout: _Layout,
    places: NDArray[np.float64],
    up: NDArray[np.float64],
    rng: np.random.Generator,
) -> list[Camera]:
    """The view of the detailed part of a scene that shows most of it; none shows anything: none."""
    some = places[rng.integers(len(places), size=_OVERVIEWS)]
    views = [_look(place, layout.focus, up, layout.size) for place in some]
    fine = _log_sizes(scene) <= np.quantile(_log_sizes(scene), 0.1)

    def judge(view: Camera) -> float:
        score, weight = _judge(scene, view)
        level = 1 - abs(float(np.sum(view.rotation[2] * up)))
        return score + 2 * np.log((weight[fine] > 0).mean() + 1e-3) + 2 * np.log(level + 0.1)

    scores = run_all(judge, views)
    best = int(np.argmax(scores))
    return [views[best]] if np.isfinite(scores[best]) else []


def _others(
    scene: Scene,
    layout: _Layout,
    places: NDArray[np.float64],
    up: NDArray[np.float64],
    rng: np.random.Generator,
    count: int,
) -> list[Camera]:
    """Views of random Gaussians; of the better ones, those that together see most."""
    tried = max(_TRIED * count, _LEAST_TRIED)
    some = places[rng.integers(len(places), size=tried)]
    aims = scene.positions.T[rng.integers(scene.count, size=tried)].astype(np.float64)
    pairs = zip(some, aims, strict=True)
    views = [_look(place, aim, up, layout.size) for place, aim in pairs]
    judged = run_all(lambda view: _judge(scene, view), views)
    scores = np.array([score for score, _ in judged])
    left = [i for i in np.argsort(-scores, kind="stable") if np.isfinite(scores[i])]
    left = left[: max(int(_GOOD * len(left)), count)]
    every = max(1, scene.count // 10_000)
    weights = np.array([weight[::every] for _, weight in judged])
    chosen: list[int] = []
    total = np.zeros(weights.shape[1], np.float32)
    while left and len(chosen) < count:
        gains = [float(np.sqrt(total + weights[i]).sum()) for i in left]
        chosen.append(left.pop(int(np.argmax(gains))))
        total += weights[chosen[-1]]
    return [views[i] for i in chosen]


def _sphere(count: int) -> NDArray[np.float64]:
    """Evenly spaced unit vectors ``(count, 3)``: golden-angle steps up the sphere."""
    height = (2 * np.arange(count) + 1) / count - 1
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    ring = np.sqrt(1 - height**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1)


def _look(position: NDArray, target: NDArray, up: NDArray, size: float) -> Camera:
    """A camera that looks at a target; at tiny scenes from farther away, with a longer lens."""
    zoom = max(1.0, 2 * NEAR / (_NEAREST * size)) if size < NEAR else 1.0
    position = target + zoom * (position - target)
    forward = (target - position) / max(float(np.linalg.norm(target - position)), 1e-12)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-3:
        right = np.cross(forward, np.roll(up, 1) + forward[::-1])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    focal = zoom * _FOCAL
    return Camera("auto", WIDTH, HEIGHT, focal, focal, WIDTH / 2, HEIGHT / 2, rotation, position)


def _judge(scene: Scene, view: Camera) -> tuple[float, NDArray[np.float32]]:
    """Score of a view, higher is better, and each Gaussian's weight in it ``(N,)``."""
    rendering = render(scene, view.resized(*_THUMB), accumulate=True, device="cpu")
    assert rendering.accumulations is not None
    weight = rendering.accumulations.weight.astype(np.float32)
    seen = np.flatnonzero(weight > 0)
    if not len(seen):
        return -np.inf, weight
    depth = combine(view.rotation[2], scene.positions[:, seen] - view.position[:, None])
    near, middle = np.quantile(depth, [0.02, 0.5])
    share = weight[seen] / (weight[seen] + np.median(weight[seen]))
    score = math.log(share.sum()) + 3 * math.log(rendering.alpha.mean())
    return score + math.log(min(max(near / middle, 0.01), 0.3)), weight

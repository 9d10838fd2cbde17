"""Virtual cameras for a scene that comes without any.

Training leaves traces: Gaussians are small where cameras were near or looked at, and a view from a
training camera is sharp, has no holes, and shows much of the scene. Candidates are scored by this
at thumbnail size. From the better half, those that together see the scene best are chosen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.linear import combine, main_axis
from gs_codec.errors import InvalidInput
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.project import NEAR
from gs_codec.rendering.renderer import render
from gs_codec.runtime.threads import run_all
from gs_codec.scene import GROUPS, Scene

#: Size of the images, pixels; the field of view is 51 degrees wide.
WIDTH, HEIGHT = 600, 400
_FOCAL = 1.04 * WIDTH

#: Candidates are scored on about this many Gaussians, enlarged to cover the same surfaces.
_THUMB_GAUSSIANS = 50_000
_THUMB = (96, 64)
_INSIDE, _ORBIT = 192, 64

#: A room has a focus if half of the smallest tenth of the Gaussians lie within this distance of one
#: point; cameras are then placed at these distances from it. Units of the scene's size.
_FOCUSED, _AWAY = 0.25, (0.35, 0.7)

#: Share of the candidates that are good enough to choose from.
_SHARE = 0.5

#: Spread of camera positions inside, and of the points they look at; units of the scene's size.
_SPREAD, _AIM = 0.35, 0.15

#: Share of the variation of Gaussians' sizes that distance must explain in a room.
_ROOM_GAIN = 0.2

#: Gaussians below this logit (opacity 0.3) say little about where surfaces are.
_SOLID = -0.85


@dataclass(frozen=True)
class _Layout:
    """Layout of a scene: its centre, typical and far distances from there, and the vertical.

    `focus` is the point that all cameras in a room look at, if there is one.
    """

    centre: NDArray[np.float64]
    size: float
    reach: float
    is_room: bool
    focus: NDArray[np.float64] | None
    up: NDArray[np.float64]


def auto_cameras(scene: Scene, count: int = 24) -> list[Camera]:
    """Choose cameras: inside a scene that is like a room, around and inside any other.

    The same scene gives the same cameras, of `WIDTH` x `HEIGHT` pixels.

    Raises
    ------
    InvalidInput
        If no view shows anything.
    """
    thumb = _thinned(scene)
    views = _candidates(_layout(thumb), count) if thumb.count else []
    judged = run_all(lambda view: _judge(thumb, view.resized(*_THUMB)), views)
    scores = np.array([score for score, _ in judged])
    chosen = _best_together(scores, np.array([weight for _, weight in judged]), count)
    if not chosen:
        raise InvalidInput("cameras 'auto': no view shows anything of the scene")
    return [replace(views[i], name=f"auto_{n:02d}") for n, i in enumerate(sorted(chosen))]


def _thinned(scene: Scene) -> Scene:
    """Every k-th solid Gaussian (of all, if none is), larger by sqrt(k), without its SH-AC."""
    finite = np.all([np.isfinite(getattr(scene, group)).all(axis=0) for group in GROUPS], axis=0)
    usable = finite & scene.rot.any(axis=0)
    solid = usable & (scene.opacity[0] > _SOLID)
    index = np.flatnonzero(solid if solid.any() else usable)
    step = max(1, len(index) // _THUMB_GAUSSIANS)
    thumb = scene.take(index[::step])
    grown = thumb.log_scale + np.float32(0.5 * np.log(step))
    return replace(thumb, log_scale=grown, f_rest=thumb.f_rest[:0])


def _layout(scene: Scene) -> _Layout:
    """Fit sizes to distances: in a room, Gaussians are larger farther from the cameras."""
    from scipy.optimize import minimize

    points = scene.positions.T.astype(np.float64)
    sizes = _log_sizes(scene)
    centre = np.median(points, axis=0)
    distance = np.linalg.norm(points - centre, axis=1)
    # A single Gaussian is looked at from a distance of its own size.
    size = max(float(np.median(distance)), float(np.exp(np.median(sizes))), 1e-6)
    reach = max(float(np.quantile(distance, 0.9)), size)
    some = slice(None, None, max(1, len(points) // 5000))

    def misfit(guess: NDArray) -> float:
        squares = ((points[some] - centre - size * guess[:3]) ** 2).sum(axis=1)
        left = sizes[some] - 0.5 * np.log(squares / size**2 + np.exp(2 * np.clip(guess[3], -9, 9)))
        return float(np.abs(left - np.median(left)).mean())

    alone = float(np.abs(sizes[some] - np.median(sizes[some])).mean())
    starts = [(x, y, z, -1.0) for x in (-0.3, 0.3) for y in (-0.3, 0.3) for z in (-0.3, 0.3)]
    fits = [minimize(misfit, start, method="Nelder-Mead") for start in starts]
    best = min(fits, key=lambda fit: fit.fun)
    is_room = best.fun < (1 - _ROOM_GAIN) * alone and np.linalg.norm(best.x[:3]) < 2
    focus = None
    if is_room:
        centre = centre + size * best.x[:3]
        small = points[sizes <= np.quantile(sizes, 0.1)]
        middle = np.median(small, axis=0)
        if np.median(np.linalg.norm(small - middle, axis=1)) < _FOCUSED * size:
            focus = middle
    return _Layout(centre, size, reach, bool(is_room), focus, _vertical(scene, centre))


def _log_sizes(scene: Scene) -> NDArray[np.float64]:
    """Logarithm of the geometric mean of the two longer axes ``(N,)``."""
    return np.sort(scene.log_scale.astype(np.float64), axis=0)[1:].mean(axis=0)


def _vertical(scene: Scene, centre: NDArray[np.float64]) -> NDArray[np.float64]:
    """Up direction: the main normal of flat Gaussians, away from where most of them are."""
    from scipy.spatial.transform import Rotation

    flattest = np.argmin(scene.log_scale, axis=0)
    turn = Rotation.from_quat(scene.rot.T, scalar_first=True).as_matrix()
    normals = turn[np.arange(scene.count), :, flattest]
    flatness = np.exp(2 * (_log_sizes(scene) - scene.log_scale.min(axis=0)).clip(max=4))
    axis = main_axis(np.sqrt(flatness) * normals.T)
    level = combine(axis, normals.T)
    height = combine(axis, scene.positions - centre[:, None])
    return -axis if np.average(height, weights=flatness * level**2) > 0 else axis


def _candidates(layout: _Layout, count: int) -> list[Camera]:
    rng = np.random.default_rng(0)
    if layout.focus is not None:
        # Twice the number asked for: the better half is then an even orbit without bad sides.
        sides = _sphere(max(2 * count, _ORBIT))
        low, high = np.log(_AWAY)
        offsets = layout.size * np.exp(rng.uniform(low, high, (len(sides), 1))) * sides
        return [_look(layout.focus + offset, layout.focus, layout.up) for offset in offsets]
    offsets, aims = rng.standard_normal((2, _INSIDE, 3)) * layout.size
    inside = zip(layout.centre + _SPREAD * offsets, layout.centre + _AIM * aims, strict=True)
    views = [_look(position, target, layout.up) for position, target in inside]
    if not layout.is_room:
        whole = 2.2 * layout.reach
        # Scenes smaller than the near distance are seen from beyond it, with a longer lens.
        away = max(whole, 2 * NEAR)
        views += [
            _look(layout.centre + away * side, layout.centre, layout.up, away / whole)
            for side in _sphere(_ORBIT)
        ]
    return views


def _sphere(count: int) -> NDArray[np.float64]:
    """Evenly spaced unit vectors ``(count, 3)``: golden-angle steps up the sphere."""
    height = 1 - (2 * np.arange(count) + 1) / count
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    ring = np.sqrt(1 - height**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1)


def _look(position: NDArray, target: NDArray, up: NDArray, zoom: float = 1.0) -> Camera:
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-3:
        right = np.cross(forward, np.roll(up, 1) + forward[::-1])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    focal = zoom * _FOCAL
    return Camera("auto", WIDTH, HEIGHT, focal, focal, WIDTH / 2, HEIGHT / 2, rotation, position)


def _judge(scene: Scene, view: Camera) -> tuple[float, NDArray[np.float32]]:
    """Score of a view, higher is better, and each Gaussian's weight in it ``(N,)``."""
    rendering = render(scene, view, accumulate=True)
    assert rendering.accumulations is not None
    weight = rendering.accumulations.weight
    seen = weight > 0
    if not seen.any():
        return -np.inf, weight.astype(np.float32)
    depth = combine(view.rotation[2], scene.positions[:, seen] - view.position[:, None])
    footprint = np.average(_log_sizes(scene)[seen] - np.log(depth), weights=weight[seen])
    score = np.log(seen.mean()) - footprint + 3 * np.log(rendering.alpha.mean())
    return float(score), weight.astype(np.float32)


def _best_together(scores: NDArray, weights: NDArray, count: int) -> list[int]:
    """Greedily choose views of the better half that most increase summed roots of weights."""
    left = [i for i in np.argsort(-scores, kind="stable") if np.isfinite(scores[i])]
    left = left[: max(int(_SHARE * len(left)), count)]
    chosen: list[int] = []
    total = np.zeros(weights.shape[1:], np.float32)
    while left and len(chosen) < count:
        gains = [float(np.sqrt(total + weights[i]).sum()) for i in left]
        chosen.append(left.pop(int(np.argmax(gains))))
        total += weights[chosen[-1]]
    return chosen

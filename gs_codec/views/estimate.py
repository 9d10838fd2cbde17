"""Virtual cameras for a scene that comes without any.

Views look from places where cameras may have been at random Gaussians, as these are densest where
cameras looked, and at the finest. Those that show holes or close-ups go; of the others, those stay
that together see most.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera, facing
from gs_codec.coding.linear import combine
from gs_codec.errors import InvalidInput
from gs_codec.rendering.project import NEAR
from gs_codec.rendering.renderer import render
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene
from gs_codec.views.evidence import Evidence, gather_evidence

#: Default number of cameras.
COUNT = 24

#: Size of the images, pixels.
WIDTH = 420
HEIGHT = 280

#: Focal length, pixels: a horizontal field of view of 51 degrees.
_FOCAL = 1.04 * WIDTH

#: Number of places tried for an overview.
_OVERVIEWS = 48

#: Overviews are also tried from farther away: this many times the distance of each place.
_BACK = (1.0, 1.6, 2.5)

#: About how many Gaussians are drawn to compare views.
_ROUGH = 10_000

#: Number of the best overviews that are compared again with all Gaussians.
_FINALISTS = 16

#: Distance of an overview, in units of that at which 0.99 of the subject fits into the image.
_MARGIN = 1.2

#: Nothing surrounds a scene if the distance from which a camera sees 0.99 of it is less than this
#: many times that for 0.9. Objects, people and plants have 1.2 to 1.3, objects in a room above 2.
_COMPACT = 1.5

#: Number of views tried for each one requested.
_TRIED = 3

#: Minimum number of views tried.
_LEAST_TRIED = 96

#: Views are chosen among this many times the requested number: the best of those tried.
_GOOD = 2.7

#: Share of the views that look at the subject; the others look at random Gaussians.
_AT_SUBJECT = 0.5

#: Places are drawn by rank: 1/e as often after this share of them.
_LIKELY = 0.5

#: Size at which views are compared, pixels.
_THUMB = (96, 64)

#: Views for guidance and refinement: this many times the requested number.
_MANY = 4

#: Width of these views, pixels.
SMALL = WIDTH // 2

#: They are up to this many times as wide, and fewer, in scenes of many small Gaussians.
_LARGER = math.sqrt(2)

#: Those are scenes of which a view has fewer pixels than this for each Gaussian that it shows.
_PIXELS = 3.0


class Estimate(NamedTuple):
    """Cameras that were chosen for a scene.

    Attributes
    ----------
    cameras : list of Camera
        Those that together see most come first, after an overview.
    up : ndarray, shape (3,)
        Unit vector: what is up in the scene.
    up_certain : bool
        As for `Evidence`: whether the up axis is certain.
    telling : bool
        As for `Evidence`: whether cameras are near those that the scene was trained with.
    shown : float
        Share of the Gaussians that a view shows, on average.
    """

    cameras: list[Camera]
    up: NDArray[np.float64]
    up_certain: bool
    telling: bool
    shown: float


def auto_cameras(
    scene: Scene, count: int = COUNT, progress: Progress | None = None
) -> list[Camera]:
    """Choose cameras near those that a scene was trained with: first an overview, then others.

    The same scene gives the same cameras, of `WIDTH` x `HEIGHT` pixels.

    Raises
    ------
    InvalidInput
        If no view shows anything.
    """
    return estimate_views(scene, count, progress=progress).cameras


def estimate_views(
    scene: Scene,
    count: int = COUNT,
    up: NDArray | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """The same cameras, and what is known of them.

    If `up` is given, also a unit vector, cameras are upright by that one instead.

    Raises
    ------
    InvalidInput
        If no view shows anything.
    """
    found = gather_evidence(scene, progress=progress)
    chosen: list[Camera] = []
    shown = 0.0
    if found is not None and count > 0:
        rng = np.random.default_rng(1)
        seen = found if up is None else replace(found, up=up)
        chosen = _overview(seen, rng, progress)
        others, shown = _others(seen, count - len(chosen), rng, progress)
        chosen += others
    if found is None or not chosen:
        raise InvalidInput("cameras 'auto': no view shows anything of the scene")
    cameras = [replace(view, name=f"auto_{n:02d}") for n, view in enumerate(chosen)]
    return Estimate(cameras, found.up, found.up_certain, found.telling, shown)


def guiding_cameras(
    scene: Scene, views: int, width: int | None = None, progress: Progress | None = None
) -> Estimate:
    """Cameras to work by: two to four for each of the `views`, with no more pixels together.

    What all places see counts for more than pixels that show nothing smaller. The width of the
    images can be given.

    Raises
    ------
    InvalidInput
        If no view shows anything.
    """
    found = estimate_views(scene, _MANY * views, progress=progress)
    if width is None:
        fine = math.sqrt(_PIXELS * found.shown * scene.count * WIDTH / HEIGHT)
        width = round(min(max(fine, SMALL), SMALL * _LARGER))
    size = width, max(1, round(width * HEIGHT / WIDTH))
    some = found.cameras[: guiding_number(views, width)]
    return found._replace(cameras=[view.resized(*size) for view in some])


def guiding_number(views: int, width: int) -> int:
    """How many `guiding_cameras` there are of this width."""
    return math.ceil(_MANY * views / min(max(width / SMALL, 1.0), _LARGER) ** 2)


def _overview(seen: Evidence, rng: np.random.Generator, progress: Progress | None) -> list[Camera]:
    """The level view with most of the subject in it, if any shows anything."""
    some = seen.places[rng.integers(len(seen.places), size=_OVERVIEWS)]
    middle = np.median(_subject(seen), axis=1)
    # Behind the places that a scene tells may be walls.
    back = _BACK[:1] if seen.telling else _BACK
    views = [look_at(middle + k * (place - middle), middle, seen) for k in back for place in some]
    rough = _thinned(seen)
    if rough is not seen:
        finalists = np.argsort(-_rate_overviews(rough, views, progress), kind="stable")[:_FINALISTS]
        views = [views[i] for i in np.sort(finalists)]
    scores = _rate_overviews(seen, views, progress)
    best = int(np.argmax(scores))
    if not math.isfinite(scores[best]):
        return []
    return [views[best] if seen.telling else _whole(seen, views[best])]


def _whole(seen: Evidence, view: Camera) -> Camera:
    """The view with all of a subject without surroundings in its middle, from farther back if so.

    What surrounds a subject may be cut off; all of it inside would make the subject small.
    """
    points = _subject(seen)
    target = np.median(points, axis=1)
    # The middle of the subject in the image, at the depth of the target.
    for row in view.rotation[:2]:
        low, high = np.quantile(combine(row, points - target[:, None]), [0.005, 0.995])
        target = target + (low + high) / 2 * row
    x, y, z = (combine(row, points - target[:, None]) for row in view.rotation)
    # From so far behind the target a point is at the image's edge.
    back = np.maximum(np.abs(view.fx * x) / view.cx, np.abs(view.fy * y) / view.cy) - z
    most, whole = np.quantile(back, [0.9, 0.99])
    away = float(np.sum(view.rotation[2] * (target - view.position)))
    if whole > _COMPACT * most:
        return view
    return replace(view, position=target - max(away, _MARGIN * whole) * view.rotation[2])


def _rate_overviews(
    seen: Evidence, views: list[Camera], progress: Progress | None
) -> NDArray[np.float64]:
    """Score of each view as an overview, higher is better."""
    points = _subject(seen)

    def judge(view: Camera) -> float:
        score, weight = _judge(seen, view)
        x, y, z = (combine(row, points - view.position[:, None]) for row in view.rotation)
        inside = np.maximum(np.abs(view.fx * x) / view.cx, np.abs(view.fy * y) / view.cy) < z
        own = weight[seen.subject]
        # What fog or walls hide is not shown.
        shown = own / (own + np.median(weight[weight > 0])) if weight.any() else own
        level = 1 - abs(float(np.sum(view.rotation[2] * seen.up)))
        shares = inside.mean() ** 2, shown.mean(), level
        return score + 3 * sum(math.log(share + 0.01) for share in shares)

    return np.array(run_all(judge, views, advance=step_counter(progress, "cameras", len(views))))


def _subject(seen: Evidence) -> NDArray[np.float64]:
    """Centres of the subject ``(3, n)``."""
    return seen.thumb.positions[:, seen.subject].astype(np.float64)


def _thinned(seen: Evidence) -> Evidence:
    """The evidence with about `_ROUGH` Gaussians, some of the subject; all, if it has few."""
    step = seen.thumb.count // _ROUGH
    if step < 2:
        return seen
    own, others = np.flatnonzero(seen.subject), np.flatnonzero(~seen.subject)
    left = np.sort(np.concatenate([own[::step], others[::step]]))
    thumb = seen.thumb.take(left)
    thumb = replace(thumb, log_scale=thumb.log_scale + np.float32(0.5 * np.log(step)))
    return replace(seen, thumb=thumb, subject=seen.subject[left])


def _others(
    seen: Evidence, count: int, rng: np.random.Generator, progress: Progress | None
) -> tuple[list[Camera], float]:
    """Views of random Gaussians and the subject; of the better ones, those that together see most.

    Also the share of the Gaussians that each shows, on average.
    """
    if count < 1:
        return [], 0.0
    tried = max(_TRIED * count, _LEAST_TRIED)
    number = len(seen.places)
    likely = np.exp(-np.arange(number) / (_LIKELY * number))
    some = rng.choice(number, tried, replace=tried > number, p=likely / likely.sum())
    aims = rng.integers(seen.thumb.count, size=tried)
    subject = np.flatnonzero(seen.subject)
    finest = rng.random(tried) < _AT_SUBJECT
    aims[finest] = subject[rng.integers(len(subject), size=int(finest.sum()))]
    targets = seen.thumb.positions.T[aims].astype(np.float64)
    views = [
        look_at(place, target, seen)
        for place, target in zip(seen.places[some], targets, strict=True)
    ]
    rough = _thinned(seen)
    advance = step_counter(progress, "cameras", len(views))
    judged = run_all(lambda view: _judge(rough, view), views, advance=advance)
    scores = np.array([score for score, _ in judged])
    good = [int(i) for i in np.argsort(-scores, kind="stable") if np.isfinite(scores[i])]
    weights = np.array([weight for _, weight in judged])
    chosen = _see_most(weights, good[: math.ceil(_GOOD * count)], count)
    shown = float((weights[chosen] > 0).mean()) if chosen else 0.0
    return [views[i] for i in chosen], shown


def _see_most(weights: NDArray[np.float32], views: list[int], count: int) -> list[int]:
    """Of views with ``weights (V, N)`` those that together see most: greedily, the best first.

    What a view adds to the sum of roots of weights only falls as others are chosen, so that one
    whose last value is no longer the largest need not be looked at again.
    """
    chosen: list[int] = []
    total = np.zeros(weights.shape[1], np.float32)
    left = [(-math.inf, view) for view in views]
    while left and len(chosen) < count:
        _, view = heapq.heappop(left)
        gain = float((np.sqrt(total + weights[view]) - np.sqrt(total)).sum(dtype=np.float64))
        if left and gain < -left[0][0]:
            heapq.heappush(left, (-gain, view))
            continue
        chosen.append(view)
        total += weights[view]
    return chosen


def look_at(position: NDArray, target: NDArray, seen: Evidence) -> Camera:
    """A camera that looks at a target; at tiny scenes from farther away, with a longer lens."""
    zoom = max(1.0, 2 * NEAR / (0.3 * seen.size)) if seen.size < NEAR else 1.0
    position = target + zoom * (position - target)
    rotation = facing(target - position, seen.up)
    focal = zoom * _FOCAL
    return Camera("auto", WIDTH, HEIGHT, focal, focal, WIDTH / 2, HEIGHT / 2, rotation, position)


def _judge(seen: Evidence, view: Camera) -> tuple[float, NDArray[np.float32]]:
    """Score of a view, higher is better, and each Gaussian's weight in it ``(N,)``."""
    rendering = render(seen.thumb, view.resized(*_THUMB), accumulate=True, device="cpu")
    assert rendering.accumulations is not None
    weight = rendering.accumulations.weight.astype(np.float32)
    drawn = np.flatnonzero(weight > 0)
    if not len(drawn):
        return -np.inf, weight
    depth = combine(view.rotation[2], seen.thumb.positions[:, drawn] - view.position[:, None])
    near, middle = np.quantile(depth, [0.02, 0.5])
    share = weight[drawn] / (weight[drawn] + np.median(weight[drawn]))
    score = math.log(share.sum()) + 3 * math.log(rendering.alpha.mean())
    if not seen.telling:
        # Places may be in cavities, where all is close.
        score += 2 * math.log(min(middle / seen.size, 1.0))
    return score + math.log(min(max(near / middle, 0.01), 0.3)), weight

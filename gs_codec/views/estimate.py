"""Estimate cameras for a scene without any.

Candidate views look from likely camera positions at random Gaussians (which are densest where
cameras looked) and at the finest Gaussians. Views with holes or close-ups are rejected. From the
rest, the set that sees the most is selected.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import NEAR, Camera, facing
from gs_codec.coding.exact_math import combine
from gs_codec.errors import InvalidInput
from gs_codec.rendering.renderer import render
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene
from gs_codec.views.evidence import Evidence, gather_evidence

#: Default number of cameras.
COUNT = 24

#: Width of the images, in pixels.
WIDTH = 420
HEIGHT = 280

#: Focal length, pixels: a horizontal field of view of 51 degrees.
_FOCAL = 1.04 * WIDTH

#: Minimum depth of a Gaussian to be drawn in tiny scenes, relative to the scene's size.
_NEAR = 0.03

#: Number of positions tried for an overview.
_OVERVIEWS = 48

#: Overviews are also tried from farther away: factors on the distance of each position.
_BACK = (1.0, 1.6, 2.5)

#: Approximate number of Gaussians rendered to compare views.
_ROUGH = 10_000

#: Number of the best overviews that are compared again with all Gaussians.
_FINALISTS = 16

#: Distance of an overview, relative to that at which 99 % of the subject fits into the image.
_MARGIN = 1.2

#: A scene has no surroundings if the distance from which a camera sees 99 % of it is less than this
#: many times the distance for 90 %. Objects, people and plants have 1.2 to 1.3, objects in a room
#: above 2.
_COMPACT = 1.5

#: Number of views tried for each one requested.
_TRIED = 3

#: Minimum number of views tried.
_LEAST_TRIED = 96

#: Views are selected from the best of those tried: this many times the requested number.
_GOOD = 2.7

#: Share of the views that look at the subject; the others look at random Gaussians.
_AT_SUBJECT = 0.5

#: Positions are drawn by rank: the probability falls to 1/e after this share of them.
_LIKELY = 0.5

#: Size of images for comparing views, in pixels.
_THUMB = (96, 64)

#: Views for guidance and refinement: this many times the requested number, at the width below.
_MANY = 4

#: Width of these views, pixels.
SMALL = WIDTH // 2

#: In scenes with many small Gaussians, views are up to this many times wider, and fewer.
_LARGER = math.sqrt(2)

#: Such scenes have fewer pixels per visible Gaussian than this.
_PIXELS = 3.0


class Estimate(NamedTuple):
    """Cameras estimated for a scene.

    Attributes
    ----------
    cameras : list of Camera
        An overview, then the cameras that together see most.
    up : ndarray, shape (3,)
        Unit vector of the up direction.
    up_certain : bool
        Whether the up axis is certain, as in `Evidence`.
    telling : bool
        Whether cameras are near the training cameras, as in `Evidence`.
    shown : float
        Mean share of the Gaussians that are visible in a view.
    """

    cameras: list[Camera]
    up: NDArray[np.float64]
    up_certain: bool
    telling: bool
    shown: float


def auto_cameras(
    scene: Scene, count: int = COUNT, progress: Progress | None = None
) -> list[Camera]:
    """Estimate cameras near a scene's training cameras: first an overview, then others.

    The same scene gives the same cameras, of `WIDTH` x `HEIGHT` pixels. Raises InvalidInput if no
    view shows anything.
    """
    return estimate_views(scene, count, progress=progress).cameras


def estimate_views(
    scene: Scene,
    count: int = COUNT,
    up: NDArray | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """Like `auto_cameras`, with further results.

    If the unit vector `up` is given, cameras are upright with respect to it. Raises InvalidInput if
    no view shows anything.
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
    """Cameras for guidance: two to four for each of `views`, with no more pixels in total.

    Many small views see more of a scene than few large ones. `width` overrides the width of the
    images. Raises InvalidInput if no view shows anything.
    """
    found = estimate_views(scene, _MANY * views, progress=progress)
    if width is None:
        fine = math.sqrt(_PIXELS * found.shown * scene.count * WIDTH / HEIGHT)
        width = round(min(max(fine, SMALL), SMALL * _LARGER))
    size = width, max(1, round(width * HEIGHT / WIDTH))
    some = found.cameras[: guiding_number(views, width)]
    return found._replace(cameras=[view.resized(*size) for view in some])


def guiding_number(views: int, width: int) -> int:
    """Number of `guiding_cameras` of this width."""
    return math.ceil(_MANY * views / min(max(width / SMALL, 1.0), _LARGER) ** 2)


def _overview(seen: Evidence, rng: np.random.Generator, progress: Progress | None) -> list[Camera]:
    """The level view with most of the subject in it; none if no view shows anything."""
    some = seen.places[rng.integers(len(seen.places), size=_OVERVIEWS)]
    middle = np.median(_subject(seen), axis=1)
    # Behind positions that were estimated from the scene there may be walls.
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
    """Centre a subject that has no surroundings in the view, moving back until all of it fits.

    Surroundings of a subject may be cut off; showing all of them would make the subject small.
    """
    points = _subject(seen)
    target = np.median(points, axis=1)
    # Centre the subject in the image, at the depth of the target.
    for row in view.rotation[:2]:
        low, high = np.quantile(combine(row, points - target[:, None]), [0.005, 0.995])
        target = target + (low + high) / 2 * row
    x, y, z = (combine(row, points - target[:, None]) for row in view.rotation)
    # From this far behind the target, a point is at the edge of the image.
    back = np.maximum(np.abs(view.fx * x) / view.cx, np.abs(view.fy * y) / view.cy) - z
    most, whole = np.quantile(back, [0.9, 0.99])
    away = float(np.sum(view.rotation[2] * (target - view.position)))
    if whole > _COMPACT * most:
        return view
    return replace(view, position=target - max(away, _MARGIN * whole) * view.rotation[2])


def _rate_overviews(
    seen: Evidence, views: list[Camera], progress: Progress | None
) -> NDArray[np.float64]:
    """Score of each view as an overview; higher is better."""
    points = _subject(seen)

    def judge(view: Camera) -> float:
        score, weight = _judge(seen, view)
        x, y, z = (combine(row, points - view.position[:, None]) for row in view.rotation)
        inside = np.maximum(np.abs(view.fx * x) / view.cx, np.abs(view.fy * y) / view.cy) < z
        own = weight[seen.subject]
        # Gaussians hidden by fog or walls do not count.
        shown = own / (own + np.median(weight[weight > 0])) if weight.any() else own
        level = 1 - abs(float(np.sum(view.rotation[2] * seen.up)))
        shares = inside.mean() ** 2, shown.mean(), level
        return score + 3 * sum(math.log(share + 0.01) for share in shares)

    return np.array(run_all(judge, views, advance=step_counter(progress, "cameras", len(views))))


def _subject(seen: Evidence) -> NDArray[np.float64]:
    """Centres of the subject ``(3, n)``."""
    return seen.thumb.positions[:, seen.subject].astype(np.float64)


def _thinned(seen: Evidence) -> Evidence:
    """The evidence thinned to about `_ROUGH` Gaussians, including some of the subject."""
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
    """Select, from good views of random Gaussians and the subject, those that together see most.

    Also return the mean share of the Gaussians that are visible in a view.
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
    """Select greedily the views with ``weights (V, N)`` that together see most, the best first.

    The gain of a view in the sum of square roots of weights only decreases as others are selected.
    So a view need not be re-evaluated while its last known gain is not the largest.
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
    """A camera that looks at a target; in tiny scenes, also at what is near."""
    near = _NEAR * seen.size if seen.size < NEAR else NEAR
    rotation = facing(target - position, seen.up)
    lens = (_FOCAL, _FOCAL, WIDTH / 2, HEIGHT / 2)
    return Camera("auto", WIDTH, HEIGHT, *lens, rotation, position, near=near)


def _judge(seen: Evidence, view: Camera) -> tuple[float, NDArray[np.float32]]:
    """Score of a view (higher is better), and each Gaussian's weight in it ``(N,)``."""
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
        # Positions may be in cavities, where everything is close.
        score += 2 * math.log(min(middle / seen.size, 1.0))
    return score + math.log(min(max(near / middle, 0.01), 0.3)), weight

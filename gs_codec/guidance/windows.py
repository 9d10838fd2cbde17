"""Small crops of views (windows), rendered before and after coding to measure the loss.

A window is a square crop of a view, 32 pixels wide, with about 500 Gaussians, so measuring takes
the same time for small and large scenes. Some windows choose the step sizes. Others, from other
positions, measure the result.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.coding.clean import clean_scene
from gs_codec.config import Config
from gs_codec.rendering.frame import draw_few
from gs_codec.runtime.arrays import empty
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene
from gs_codec.views.estimate import look_at
from gs_codec.views.evidence import Evidence, gather_evidence

#: Share of windows aimed at the smallest Gaussians, which belong to the subject of the capture.
#: Most other Gaussians may be sky.
_AT_SUBJECT = 0.5

#: Minimum number of Gaussians for calibration: in smaller scenes it would take longer than
#: encoding.
_LEAST = 5000

#: Number of windows for choosing step sizes.
_CHOOSING = 96

#: Number of windows for measuring the result from likely camera positions.
_CHECKING = 64

#: Number of windows for measuring the result from given cameras.
_CHECKING_GIVEN = 128

#: Side of a window, in pixels; smaller ones are used if these show too many Gaussians.
_SIDE = 32
SIDES = (_SIDE, 16, 8, 4)

#: Approximate number of Gaussians in a window.
_SHOWN = 500

#: Skip windows with more Gaussians, which take too long.
MOST_SHOWN = 5000

#: Minimum number of usable windows for choosing step sizes.
ENOUGH = 16

#: Skip windows with a higher mean transmittance, which show holes.
_MOST_LEFT = 0.3

#: The same if too few windows are left, as of thin objects.
_MOST_LEFT_THIN = 0.8

#: Approximate size of the sample for choosing windows.
_SAMPLE = 20_000

#: Number of Gaussians whose radii are computed at once.
_CHUNK = 1 << 18

#: Number of Gaussians tested together.
_AT_ONCE = 2048


class Windows(NamedTuple):
    """Windows from likely camera positions: some choose step sizes, the others measure.

    `telling` states whether the positions were estimated; if not, they are spread around the scene.
    """

    choosing: list[Camera]
    checking: list[Camera]
    telling: bool


class Part(NamedTuple):
    """A window, and the range of its Gaussians in the list of all windows' Gaussians."""

    window: Camera
    start: int
    stop: int


def sample_stride(count: int) -> int:
    """Stride of the sample for choosing windows, in a scene of `count` Gaussians."""
    return max(1, count // _SAMPLE)


def sample_of(scene: Scene) -> Scene:
    """The sample of a scene for choosing windows."""
    some = np.arange(0, scene.count, sample_stride(scene.count))
    return replace(scene, extra={}).take(some)


def cleaned(sample: Scene) -> Scene:
    """A sample without Gaussians that are not finite."""
    return clean_scene(sample, Config(nonfinite="drop"), whole=False)[0]


def choose_windows(sample: Scene, count: int) -> Windows:
    """Choose windows of a scene of `count` Gaussians, from its `sample_of`."""
    with np.errstate(all="ignore"):
        seen = gather_evidence(cleaned(sample), quick=True)
        if seen is None:
            return Windows([], [], False)
        rng, taken = np.random.default_rng(0), set[int]()
        all_places = range(len(seen.places))
        number = _CHOOSING if count >= _LEAST else 0
        choosing = [_look(seen, all_places, count, rng, taken) for _ in range(number)]
        others = [place for place in all_places if place not in taken] or all_places
        checking = [_look(seen, others, count, rng, taken) for _ in range(_CHECKING)]
        return Windows(choosing, checking, seen.telling)


def _look(
    seen: Evidence, places: Sequence[int], count: int, rng: np.random.Generator, taken: set[int]
) -> Camera:
    """A random window from one of `places`, aimed at a random Gaussian; mark the place taken."""
    points = seen.thumb.positions
    place = places[int(rng.integers(len(places)))]
    taken.add(place)
    aims = np.flatnonzero(seen.subject) if rng.random() < _AT_SUBJECT else np.arange(len(points.T))
    target = points[:, aims[rng.integers(len(aims))]].astype(np.float64)
    return _crop(look_at(seen.places[place], target, seen), points, count, rng)


def windows_of(cameras: Sequence[Camera], most: int = _SIDE) -> list[Camera]:
    """Random windows of given cameras, with their pixel size; their sides are at most `most`.

    Every pixel is equally likely to be in a window, including the edges, where views lose most.
    """
    rng = np.random.default_rng(0)
    windows = []
    for _ in range(_CHECKING_GIVEN):
        view = cameras[int(rng.integers(len(cameras)))]
        side = min(most, view.width, view.height)
        room = np.array([view.width - side, view.height - side])
        corner = np.clip(rng.uniform(-side / 2, room + side / 2), 0, room)
        windows.append(_cut(view, np.rint(corner), side, side))
    return windows


def _crop(
    view: Camera, points: NDArray[np.float32], count: int, rng: np.random.Generator
) -> Camera:
    """A random square crop of a view with about `_SHOWN` of `count` Gaussians."""
    inside = _find_inside(points, np.zeros_like(points[0]), view, np.empty(0, np.int64))
    shown = count * inside / points.shape[1]
    area = _SHOWN / max(shown, 1) * view.width * view.height
    side = min(math.sqrt(area), view.height)
    corner = rng.uniform(0, [view.width - side, view.height - side])
    return _cut(view, corner, side, _SIDE)


def _cut(view: Camera, corner: NDArray[np.float64], side: float, pixels: int) -> Camera:
    """The square crop of a view at a corner, resized to `pixels` per side."""
    scale = pixels / side
    left, top = corner.tolist()
    return replace(
        view,
        width=pixels,
        height=pixels,
        fx=scale * view.fx,
        fy=scale * view.fy,
        cx=scale * (view.cx - left),
        cy=scale * (view.cy - top),
        lens=None,
    )


def find_shown(scene: Scene, windows: Sequence[Camera]) -> list[NDArray[np.int64]]:
    """Indices of the Gaussians in each window; at most `MOST_SHOWN` + 1."""
    if not windows:
        return []
    reaches = _reaches(scene)

    def find(window: Camera) -> NDArray[np.int64]:
        found = np.empty(MOST_SHOWN + 1, np.int64)
        return found[: _find_inside(scene.positions, reaches, window, found)]

    return run_all(find, windows)


def error_factors(left: Sequence[float], enough: int = ENOUGH) -> NDArray[np.float64] | None:
    """Factors on the errors of windows with a mean transmittance ``(W,)``; 0 for those to skip.

    If most windows show holes, errors are those of the opaque part. None if not `enough` are
    usable.
    """
    through = np.array(left)
    usable = through <= _MOST_LEFT
    if np.count_nonzero(usable) >= enough:
        return usable.astype(np.float64)
    usable = through <= _MOST_LEFT_THIN
    if np.count_nonzero(usable) >= enough:
        return usable / np.where(usable, 1.0 - through, 1.0)
    return None


def parts_of(windows: Sequence[Camera], sizes: Sequence[int]) -> list[Part]:
    """Consecutive parts, one per window, of the given sizes."""
    ends = np.cumsum(sizes).tolist()
    spans = zip([0, *ends], ends, strict=False)
    return [Part(window, *span) for window, span in zip(windows, spans, strict=True)]


@kernel
def _mark(x, y, z, reaches, rotation, position, slopes, inside):
    """Set ``inside (n,)`` where a Gaussian reaches into a window; in float32, for speed."""
    (right_x, right_y, right_z), (down_x, down_y, down_z), (ahead_x, ahead_y, ahead_z) = rotation
    left, right, top, bottom, near = slopes
    for i in range(len(x)):
        dx, dy, dz = x[i] - position[0], y[i] - position[1], z[i] - position[2]
        across = right_x * dx + right_y * dy + right_z * dz
        down = down_x * dx + down_y * dy + down_z * dz
        depth = ahead_x * dx + ahead_y * dy + ahead_z * dz
        reach = reaches[i]
        # Without branches, this takes half a nanosecond.
        inside[i] = (
            (depth > near)
            & (across > left * depth - reach)
            & (across < right * depth + reach)
            & (down > top * depth - reach)
            & (down < bottom * depth + reach)
        )


@kernel
def _list_inside(x, y, z, reaches, rotation, position, slopes, found):
    """Count the Gaussians that reach into a window; list the first of them in `found`."""
    inside, count = np.zeros(_AT_ONCE, np.bool_), 0
    eights = inside.view(np.uint64)
    for first in range(0, len(x), _AT_ONCE):
        end = min(first + _AT_ONCE, len(x))
        inside[end - first :] = False
        _mark(
            x[first:end], y[first:end], z[first:end], reaches[first:end],
            rotation, position, slopes, inside,
        )  # fmt: skip
        for j in range(len(eights)):
            if eights[j] == 0:
                continue
            for i in range(8 * j, 8 * j + 8):
                if inside[i]:
                    if count < len(found):
                        found[count] = first + i
                    count += 1
    return count


def _find_inside(
    positions: NDArray[np.float32],
    reaches: NDArray[np.float32],
    window: Camera,
    found: NDArray[np.int64],
) -> int:
    """Count the Gaussians that reach into a window; list the first of them in `found`."""
    slopes = (
        -window.cx / window.fx, (window.width - window.cx) / window.fx,
        -window.cy / window.fy, (window.height - window.cy) / window.fy, window.near,
    )  # fmt: skip
    rotation = tuple(tuple(np.float32(v) for v in row) for row in window.rotation)
    with np.errstate(over="ignore"):  # an infinitely distant Gaussian is not in a window
        position = tuple(np.float32(v) for v in window.position)
    edges = tuple(np.float32(slope) for slope in slopes)
    return _list_inside(*positions, reaches, rotation, position, edges, found)


def _reaches(scene: Scene) -> NDArray[np.float32]:
    """Visible radius of each Gaussian ``(N,)``: three times its longest axis."""
    reaches = empty((scene.count,), np.float32)

    def work(start: int) -> None:
        part = slice(start, start + _CHUNK)
        with np.errstate(all="ignore"):
            reaches[part] = 3 * np.exp(scene.log_scale[:, part].max(axis=0))

    run_all(work, range(0, scene.count, _CHUNK))
    return reaches


def draw_parts(scene: Scene, parts: Sequence[Part]) -> list[tuple[NDArray[np.float32], float]]:
    """Colour ``(H, W, 3)``, clamped to 1 (also NaN), and mean transmittance of each window."""

    def draw(part: Part) -> tuple[NDArray[np.float32], float]:
        colour, left = draw_few(scene, part.window, part.start, part.stop)
        return np.fmin(colour, 1), float(np.mean(left))

    return run_all(draw, parts)

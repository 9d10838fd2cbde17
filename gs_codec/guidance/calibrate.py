"""The coarseness that a scene needs without cameras: windows of it, drawn as it is and rounded.

The rules of profiles `l`, `m` and `s` tell which step sizes suit each other, not how far off a
scene then looks: that depends on its contrast, and on how much of each Gaussian is seen. So small
windows of views from where cameras may have been are drawn, and compared with those of rounded
attributes. How large pixels are matters little: twice the width, 0.2 dB.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.step_sizes import SH_RATIO, StepSizes, blind_coefficients
from gs_codec.codecs.adaptive.wanted_steps import wanted_steps
from gs_codec.coding.axes import sort_axes
from gs_codec.coding.clean import clean_scene
from gs_codec.coding.ycocg import from_ycocg, to_ycocg
from gs_codec.config import ADAPTIVE_PROFILES, Config, options_of
from gs_codec.formats.attribute_steps import AttributeSteps
from gs_codec.rendering.auto_cameras import look_at
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.evidence import Evidence, gather_evidence
from gs_codec.rendering.frame import make_frame
from gs_codec.rendering.project import NEAR
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.arrays import empty
from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.threads import run_all
from gs_codec.scene import GROUPS, Scene, join_scenes, sh_bands

#: Scenes of fewer Gaussians are left as they are: the look would take longer than all else.
_LEAST = 5000

#: Windows, their side in pixels, and about how many Gaussians each shows, and at most.
_WINDOWS, _SIDE, _SHOWN, _MOST_SHOWN = 96, 32, 500, 5000

#: Windows that let more light through are of holes; the least number of others that tell.
_MOST_LEFT, _LEAST_TELLING = 0.3, 16

#: A few windows have most of the error, so their mean is uncertain: this share of them have less
#: than the error that is looked at.
_QUANTILE = 0.8

#: That error where views lose 0.05 dB of 30, for which their mean has to be 1.16e-5 (49.4 dB): in
#: 17 scenes, real, generated and trained on generated pictures, it is then at 47.6 to 52.3 dB.
_WANTED = 1.4e-5

#: The error grows with about this power of the step sizes. It is measured once more, at most, if
#: they change by more octaves than so many.
_POWER, _ROUNDS, _NEAR = 1.76, 2, 0.25

#: The result is a multiple of so many octaves, and at most so many.
_OCTAVE, _FARTHEST = 1 / 16, 2.0

#: Places and rules are chosen by about this many Gaussians.
_SAMPLE = 20_000

#: Gaussians that are looked at, and rounded, at once.
_CHUNK, _AT_ONCE = 1 << 18, 1 << 13


class _Part(NamedTuple):
    """A window, and which Gaussians of all windows' are its own."""

    window: Camera
    start: int
    stop: int


def calibrated(scene: Scene, config: Config, progress: Progress | None = None) -> Config:
    """The configuration with the coarseness at which `m` loses 0.05 dB of 30 in a scene's views.

    Profiles `l` and `s` change by the same factor. Scenes of fewer than 5,000 Gaussians, and those
    of which views do not show enough, leave it as it is.
    """
    plain = replace(scene, extra={})
    sample = plain.take(np.arange(0, scene.count, sample_stride(scene.count)))
    windows = choose_windows(sample, scene.count)
    shown = [plain.take(members) for members in find_shown(plain, windows)]
    return calibrated_by(sample, windows, shown, config, progress)


def sample_stride(count: int) -> int:
    """Every so many Gaussians, of `count`, one is in the sample that tells where to look."""
    return max(1, count // _SAMPLE)


def choose_windows(sample: Scene, count: int) -> list[Camera]:
    """Windows on a scene of `count` Gaussians; none if it is to be left as it is.

    The sample is every `sample_stride`-th of them.
    """
    if count < _LEAST:
        return []
    with np.errstate(all="ignore"):
        seen = gather_evidence(_cleaned(sample), quick=True)
        rng = np.random.default_rng(0)
        return [] if seen is None else [_window(seen, count, rng) for _ in range(_WINDOWS)]


def _cleaned(sample: Scene) -> Scene:
    return clean_scene(sample, Config(nonfinite="drop"))[0]


def find_shown(scene: Scene, windows: Sequence[Camera]) -> list[NDArray[np.int64]]:
    """Indices of the Gaussians that each window shows: one too many, if there are too many."""
    if not windows:
        return []
    reaches = _reaches(scene)
    chunks = list(pairwise([*range(0, scene.count, _CHUNK), scene.count]))

    def find(window: Camera) -> NDArray[np.int64]:
        found = [
            first
            + np.flatnonzero(_inside(scene.positions[:, first:end], reaches[first:end], window))
            for first, end in chunks
        ]
        return np.concatenate([np.empty(0, np.int64), *found])[: _MOST_SHOWN + 1]

    return run_all(find, windows)


def calibrated_by(
    sample: Scene,
    windows: Sequence[Camera],
    shown: Sequence[Scene],
    config: Config,
    progress: Progress | None = None,
) -> Config:
    """See `calibrated`; `shown` are the Gaussians that each window shows."""
    chosen = [
        (window, own)
        for window, own in zip(windows, shown, strict=True)
        if 0 < own.count <= _MOST_SHOWN
    ]
    if not chosen:
        return config
    ends = np.cumsum([own.count for _, own in chosen]).tolist()
    spans = zip([0, *ends], ends, strict=False)
    parts = [_Part(window, *span) for (window, _), span in zip(chosen, spans, strict=True)]
    with np.errstate(all="ignore"):
        scene = join_scenes([own for _, own in chosen])
        octaves = _octaves(scene, parts, _cleaned(sample), progress)
    coarseness, bounds = config.coarseness * 2.0**octaves, options_of(Config)["coarseness"]
    return replace(config, coarseness=min(max(coarseness, bounds.low), bounds.high))


def _octaves(shown: Scene, parts: list[_Part], sample: Scene, progress: Progress | None) -> float:
    """Log2 of the coarseness that `m` needs."""
    advance = step_counter(progress, "calibrate", 1 + _ROUNDS)
    drawn = zip(parts, _images(shown, parts), strict=True)
    telling = [(part, colour) for part, (colour, left) in drawn if left <= _MOST_LEFT]
    advance()
    if len(telling) < _LEAST_TELLING:
        return 0.0
    _, scales, _ = sort_axes(sample.log_scale, sample.rot)
    octaves = 0.0
    for _ in range(_ROUNDS):
        rules = blind_coefficients(scales, ADAPTIVE_PROFILES["m"].fineness * 2.0**octaves)
        rounded = _images(_rounded(shown, rules), [part for part, _ in telling])
        errors = [
            np.mean((before - after) ** 2, dtype=np.float64)
            for (_, before), (after, _) in zip(telling, rounded, strict=True)
        ]
        step = math.log2(_WANTED / max(float(np.quantile(errors, _QUANTILE)), 1e-12)) / _POWER
        octaves = min(max(octaves + step, -_FARTHEST), _FARTHEST)
        advance()
        if abs(step) < _NEAR:
            break
    return _OCTAVE * round(octaves / _OCTAVE)


def _window(seen: Evidence, count: int, rng: np.random.Generator) -> Camera:
    """A random part of a view from a likely place towards a Gaussian."""
    points = seen.thumb.positions
    place = seen.places[rng.integers(len(seen.places))]
    view = look_at(place, points[:, rng.integers(points.shape[1])].astype(np.float64), seen)
    shown = count * float(_inside(points, np.zeros_like(points[0]), view).mean())
    side = min(math.sqrt(_SHOWN / max(shown, 1) * view.width * view.height), view.height)
    left, top = rng.uniform(0, [view.width - side, view.height - side])
    scale = _SIDE / side
    return replace(
        view,
        width=_SIDE,
        height=_SIDE,
        fx=scale * view.fx,
        fy=scale * view.fy,
        cx=scale * (view.cx - left),
        cy=scale * (view.cy - top),
    )


@kernel
def _mark(x, y, z, reaches, rotation, position, slopes, inside):
    """Set ``inside (N,)`` where a Gaussian reaches into a window; all in float32, for speed."""
    (right_x, right_y, right_z), (down_x, down_y, down_z), (ahead_x, ahead_y, ahead_z) = rotation
    left, right, top, bottom, near = slopes
    for i in range(len(x)):
        dx, dy, dz = x[i] - position[0], y[i] - position[1], z[i] - position[2]
        across = right_x * dx + right_y * dy + right_z * dz
        down = down_x * dx + down_y * dy + down_z * dz
        depth = ahead_x * dx + ahead_y * dy + ahead_z * dz
        reach = reaches[i]
        # Without branches, it takes half a nanosecond.
        inside[i] = (
            (depth > near)
            & (across > left * depth - reach)
            & (across < right * depth + reach)
            & (down > top * depth - reach)
            & (down < bottom * depth + reach)
        )


def _inside(
    positions: NDArray[np.float32], reaches: NDArray[np.float32], window: Camera
) -> NDArray[np.bool_]:
    """Which Gaussians reach into a window ``(N,)``."""
    slopes = (
        -window.cx / window.fx, (window.width - window.cx) / window.fx,
        -window.cy / window.fy, (window.height - window.cy) / window.fy, NEAR,
    )  # fmt: skip
    rotation = tuple(tuple(np.float32(v) for v in row) for row in window.rotation)
    position = tuple(np.float32(v) for v in window.position)
    inside = np.empty(positions.shape[1], np.bool_)
    _mark(*positions, reaches, rotation, position, tuple(np.float32(s) for s in slopes), inside)
    return inside


def _reaches(scene: Scene) -> NDArray[np.float32]:
    """How far each Gaussian is seen from its centre ``(N,)``: three times its longest axis."""
    reaches = empty((scene.count,), np.float32)

    def work(start: int) -> None:
        part = slice(start, start + _CHUNK)
        with np.errstate(all="ignore"):
            reaches[part] = 3 * np.exp(scene.log_scale[:, part].max(axis=0))

    run_all(work, range(0, scene.count, _CHUNK))
    return reaches


def _images(scene: Scene, parts: list[_Part]) -> list[tuple[NDArray[np.float32], float]]:
    """Colour ``(H, W, 3)``, at most 1 (so if NaN), and the mean transmittance of each window."""

    def draw(part: _Part) -> tuple[NDArray[np.float32], float]:
        frame = make_frame(scene.between(part.start, part.stop), part.window)
        colour, (left, _, _) = frame.draw_rows((0.0, 0.0, 0.0))
        return np.fmin(colour, 1), float(np.mean(np.abs(left)))

    return run_all(draw, parts)


def _rounded(scene: Scene, rules: dict[str, NDArray[np.float64]]) -> Scene:
    """A scene with attributes at whole multiples of the step sizes of rules."""

    def work(start: int) -> Scene:
        part = scene.between(start, min(start + _AT_ONCE, scene.count))
        none = np.zeros(part.count, np.uint8)
        return _to_steps(part, wanted_steps(part, StepSizes(none, none, rules, (SH_RATIO,) * 3)))

    done = run_all(work, range(0, scene.count, _AT_ONCE))
    planes: dict[str, Any] = {
        g: np.concatenate([getattr(part, g) for part in done], axis=1) for g in GROUPS
    }
    return replace(scene, **planes)


def _to_steps(scene: Scene, steps: AttributeSteps) -> Scene:
    """A scene with attributes at whole multiples of their step sizes."""

    def rounded(values: NDArray, step: NDArray) -> NDArray[np.float32]:
        return (step * np.rint(values / step)).astype(np.float32)

    def coloured(values: NDArray, step: NDArray) -> NDArray[np.float32]:
        return from_ycocg(rounded(to_ycocg(values), step).astype(np.float64))

    f_rest = scene.f_rest.reshape(3, len(scene.f_rest) // 3, scene.count).copy()
    for band, step in zip(sh_bands(f_rest.shape[1]), steps.f_rest, strict=False):
        f_rest[:, band] = coloured(f_rest[:, band], step)
    norm = np.sqrt(np.sum(scene.rot**2, axis=0))
    return replace(
        scene,
        positions=rounded(scene.positions, steps.positions),
        f_dc=coloured(scene.f_dc, steps.f_dc),
        f_rest=f_rest.reshape(scene.f_rest.shape),
        opacity=rounded(scene.opacity, steps.opacity),
        log_scale=rounded(scene.log_scale, steps.log_scale),
        rot=rounded(scene.rot / norm, steps.rot),
    )

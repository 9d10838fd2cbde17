"""Choose the coarseness of a scene without cameras, by rendering it before and after quantisation.

The rules of profiles `l`, `m` and `s` set the ratios of step sizes, but not the visible error,
which depends on the scene's contrast and on how much of each Gaussian is visible. So small crops
(windows) are rendered from likely camera positions, with the original and with quantised
attributes. Pixel size matters little: twice the width changes the PSNR by 0.2 dB.

Other formats than `.egs` add an error of their own: the Gaussians in the crops are also written in
the format, as a scene of their own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.codecs.adaptive.step_conversion import wanted_steps
from gs_codec.codecs.adaptive.step_sizes import SH_RATIO, StepSizes, blind_coefficients
from gs_codec.codecs.interchange import decoded_as_packed
from gs_codec.coding.axes import sort_axes
from gs_codec.coding.ycocg import round_colours
from gs_codec.config import ADAPTIVE_PROFILES, EGS, Config, options_of
from gs_codec.guidance.windows import (
    MOST_SHOWN,
    Part,
    Windows,
    choose_windows,
    cleaned,
    draw_parts,
    error_factors,
    find_shown,
    parts_of,
    sample_of,
)
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.threads import run_all
from gs_codec.scene import GROUPS, Scene, sh_bands

#: Use this quantile of the windows' errors. A few windows contribute most of the error, so the mean
#: is uncertain.
_QUANTILE = 0.8

#: Target mean squared error, for views that lose 0.05 dB at 30 dB: 49.4 dB.
WANTED = 1.16e-5

#: Ratio of the error at `_QUANTILE` to the mean error of held-out views. With it, 17 scenes (real,
#: generated, and trained on generated pictures) come out at 47.6 to 52.3 dB.
_ABOVE_MEAN = 1.4 / 1.16

#: The same for scenes without SH-AC, whose cameras cannot be estimated. From positions spread
#: around the scene, errors are 1/1.75 to 1/1.1 of those from cameras (14 scenes).
_ABOVE_MEAN_SPREAD = _ABOVE_MEAN / 1.45

#: Exponent of the error as a function of the step size.
POWER = 1.76

#: Measure again only if the step sizes changed by more than this, in octaves.
_NEAR = 0.25

#: Round the result to a multiple of this, in octaves.
_OCTAVE = 1 / 16

#: Maximum octaves by which a format's own rounding makes steps finer; up to 0.5 for a `.sog`. It
#: seems to need more if the format clips values, such as small scales in an `.spz`, which no step
#: size mends.
_MOST_BY_FORMAT = 1.0

#: Maximum distance from the profile's step sizes, in octaves.
_FARTHEST = 2.0

#: Number of Gaussians quantised at once.
_AT_ONCE = 1 << 13

#: Quantises the Gaussians of all crops with the step sizes of rules.
_Round = Callable[[dict[str, NDArray[np.float64]]], Scene]


def calibrated(
    scene: Scene,
    config: Config,
    progress: Progress | None = None,
    windows: Windows | None = None,
) -> Config:
    """The configuration with the coarseness at which views of `m` lose 0.05 dB at 30 dB.

    Profiles `l` and `s` change by the same factor. The coarseness does not change for fewer than
    5,000 Gaussians, or if too little is visible. `windows` are the windows of the scene, if already
    chosen. For other formats than `.egs`, the scene must be clean.
    """
    plain = replace(scene, extra={})
    sample = sample_of(plain)
    choosing = (windows or choose_windows(sample, scene.count)).choosing
    return calibrated_by(sample, choosing, plain, find_shown(plain, choosing), config, progress)


def calibrated_by(
    sample: Scene,
    windows: Sequence[Camera],
    scene: Scene,
    shown: Sequence[NDArray[np.int64]],
    config: Config,
    progress: Progress | None = None,
) -> Config:
    """Like `calibrated`; `shown` has the indices of the Gaussians in each window."""
    chosen = [
        (window, own)
        for window, own in zip(windows, shown, strict=True)
        if 0 < len(own) <= MOST_SHOWN
    ]
    if not chosen:
        return config
    parts = parts_of([window for window, _ in chosen], [len(own) for _, own in chosen])
    index = np.concatenate([own for _, own in chosen])
    with np.errstate(all="ignore"):
        taken = scene.take(index)
        empty = {group: np.empty_like(getattr(taken, group)) for group in GROUPS}
        plain: _Round = partial(_round, taken, replace(taken, **empty))
        last = plain if config.format == EGS else partial(_as_packed, scene, index, config)
        octaves = _octaves(taken, parts, cleaned(sample), (plain, last), progress)
    return replace(config, coarseness=_in_range(config.coarseness * 2.0**octaves))


def mean_error(errors: Sequence[float] | NDArray[np.float64], scene: Scene) -> float:
    """Estimate the mean squared error of views from the errors of a scene's windows."""
    has_ac = any(row.any() for row in scene.f_rest)  # reads one row of most scenes
    above_mean = _ABOVE_MEAN if has_ac else _ABOVE_MEAN_SPREAD
    return float(np.quantile(errors, _QUANTILE)) / above_mean


def wanted_error(config: Config) -> float:
    """Target mean squared error of views for the coarseness of a configuration."""
    fineness = config.adaptive_profile().fineness / ADAPTIVE_PROFILES["m"].fineness
    return WANTED * fineness**POWER


def finer(config: Config, error: float) -> Config:
    """The configuration with finer steps, predicted to multiply the error by `error`."""
    return replace(config, coarseness=_in_range(config.coarseness * error ** (1 / POWER)))


def _in_range(coarseness: float) -> float:
    bounds = options_of(Config)["coarseness"]
    return min(max(coarseness, bounds.low), bounds.high)


def _octaves(
    shown: Scene,
    parts: list[Part],
    sample: Scene,
    roundings: tuple[_Round, _Round],
    progress: Progress | None,
) -> float:
    """Log2 of the coarseness that `m` needs, measured once or twice."""
    advance = step_counter(progress, "calibrate", 1 + len(roundings))
    drawn = draw_parts(shown, parts)
    factors = error_factors([left for _, left in drawn])
    advance()
    if factors is None:
        return 0.0
    telling = [
        (part, colour, factor)
        for part, (colour, _), factor in zip(parts, drawn, factors, strict=True)
        if factor
    ]
    _, scales, _ = sort_axes(sample.log_scale, sample.rot)
    octaves = 0.0
    for rounding in roundings:
        rules = blind_coefficients(scales, ADAPTIVE_PROFILES["m"].fineness * 2.0**octaves)
        rounded = draw_parts(rounding(rules), [part for part, *_ in telling])
        errors = [
            factor * np.mean((before - after) ** 2, dtype=np.float64)
            for (_, before, factor), (after, _) in zip(telling, rounded, strict=True)
        ]
        step = math.log2(WANTED / max(mean_error(errors, sample), 1e-12)) / POWER
        if rounding is not roundings[0] and step < -_MOST_BY_FORMAT:
            break
        octaves = min(max(octaves + step, -_FARTHEST), _FARTHEST)
        advance()
        if abs(step) < _NEAR and roundings[-1] is roundings[0]:
            break
    return _OCTAVE * round(octaves / _OCTAVE)


def _round(scene: Scene, out: Scene, rules: dict[str, NDArray[np.float64]]) -> Scene:
    """Fill and return `out`: attributes of a scene at whole multiples of the steps of rules."""

    def work(start: int) -> None:
        part = scene.between(start, min(start + _AT_ONCE, scene.count))
        steps = wanted_steps(part, _steps_of(part.count, rules))
        norm = np.sqrt(np.sum(part.rot**2, axis=0))
        for group, values in {
            "positions": part.positions,
            "opacity": part.opacity,
            "log_scale": part.log_scale,
            "rot": part.rot / norm,
        }.items():
            step = getattr(steps, group)
            getattr(out, group)[:, start : start + part.count] = step * np.rint(values / step)
        round_colours(scene.f_dc[:, None], range(1), start, steps.f_dc, out.f_dc[:, None])
        f_rest, rounded = (of.f_rest.reshape(3, -1, of.count) for of in (scene, out))
        for band, step in zip(sh_bands(f_rest.shape[1]), steps.f_rest, strict=False):
            round_colours(f_rest, band, start, step, rounded)

    run_all(work, range(0, scene.count, _AT_ONCE))
    return out


def _as_packed(
    scene: Scene, index: NDArray[np.int64], config: Config, rules: dict[str, NDArray[np.float64]]
) -> Scene:
    """Some Gaussians of a scene, which may repeat, as decoded from a file of just these."""
    once, places = np.unique(index, return_inverse=True)
    return decoded_as_packed(scene.take(once), config, _steps_of(len(once), rules)).take(places)


def _steps_of(count: int, rules: dict[str, NDArray[np.float64]]) -> StepSizes:
    none = np.zeros(count, np.uint8)
    return StepSizes(none, none, rules, (SH_RATIO,) * 3)

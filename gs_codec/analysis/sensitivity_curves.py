"""Measure how errors of one attribute reduce the quality of views (paper, Section 3.3).

Errors are given in one of two scales. ``deviation`` is ours: the root mean square error in standard
deviations of the channel. ``mean`` is the paper's: the mean squared error of the attribute over the
attribute's mean. Positions and SH-AC have means of about zero, so we take the mean of the
magnitudes, over all stored values of the attribute (logits, log-scales); this is our reading of the
paper. The quotient is not dimensionless: with positions it depends on the scene's unit and origin.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.codecs.entropygs.section import channel_order
from gs_codec.codecs.entropygs.symbols import fit_channel
from gs_codec.config import Config
from gs_codec.metrics.image_quality import psnr
from gs_codec.rendering.renderer import render
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene

ErrorScale = Literal["deviation", "mean"]

#: Description of the numbers of each scale.
SCALES: dict[ErrorScale, str] = {
    "deviation": "root mean square, in standard deviations of the channel",
    "mean": "mean square over the attribute's mean magnitude",
}

#: Noise levels: root mean square errors, in standard deviations of the channel.
LEVELS = (1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0)

#: PSNR at which attributes are ranked, in dB.
THRESHOLD = 40.0

#: Attributes by the name of their group in a scene.
ATTRIBUTES = {
    "positions": "positions",
    "f_dc": "SH-DC",
    "f_rest": "SH-AC",
    "opacity": "opacity",
    "log_scale": "scaling",
    "rot": "rotation",
}

# Cap, because the PSNR of equal images is infinite.
_HIGHEST = 120.0


@dataclass(frozen=True)
class Curve:
    """Quality of views against the error of one attribute, in the scale of `SensitivityCurves`.

    Attributes
    ----------
    attribute : str
    errors : tuple of float
        The error of noise at each of `LEVELS`; in the scale ``mean`` all 0 if the attribute is
        constant.
    psnr : tuple of float
        Mean PSNR at each of `LEVELS`, dB, relative to views of the unchanged scene; at most 120.
    tolerance : float or None
        The error at which PSNR falls to `THRESHOLD`; None if PSNR stays above it, the lowest of
        `errors` if it is always below.
    tolerance_of_range : float or None
        The same error as root mean square relative to the channel's range, from lowest to highest
        value; in either scale.
    profile_error : float
        The quantisation error of the paper's profile; in the scale ``mean``, the error of noise at
        the same level in standard deviations.
    """

    attribute: str
    errors: tuple[float, ...]
    psnr: tuple[float, ...]
    tolerance: float | None
    tolerance_of_range: float | None
    profile_error: float


@dataclass(frozen=True)
class SensitivityCurves:
    """Sensitivity curves of the attributes of a scene, and the views used."""

    cameras: tuple[Camera, ...]
    profile: str
    seed: int
    scale: ErrorScale
    curves: tuple[Curve, ...]

    def ranked(self) -> list[Curve]:
        """The curves, most sensitive first; curves that stay above `THRESHOLD` come last."""
        return sorted(
            self.curves, key=lambda c: (math.inf if c.tolerance is None else c.tolerance, c.psnr)
        )

    def as_dict(self) -> dict:
        """Convert for JSON."""
        return {
            "views": [camera.name for camera in self.cameras],
            "width": self.cameras[0].width,
            "height": self.cameras[0].height,
            "noise": "uniform",
            "levels_in_standard_deviations": LEVELS,
            "error_scale": self.scale,
            "error": SCALES[self.scale],
            "threshold_psnr": THRESHOLD,
            "profile": self.profile,
            "seed": self.seed,
            "curves": {curve.attribute: asdict(curve) for curve in self.curves},
            "most_sensitive_first": [c.attribute for c in self.ranked()],
        }


def measure_sensitivity(
    scene: Scene,
    cameras: Sequence[Camera],
    config: Config,
    seed: int,
    scale: ErrorScale = "deviation",
    progress: Progress | None = None,
) -> SensitivityCurves:
    """Add noise to one attribute at a time, render, and compare with the unchanged scene.

    The noise is uniform, like the error of a quantiser, and independent for each value. Relative
    to the channel's standard deviation it is equal in all channels of an attribute. All values of
    the scene must be finite; `config` is a paper profile, whose errors are marked on the curves.
    The noise is the same in either scale.
    """
    groups = [group for group in ATTRIBUTES if len(getattr(scene, group))]
    advance = step_counter(progress, "sensitivity", len(groups) * len(LEVELS))
    original = _views(scene, cameras)
    curves = []
    for group in groups:
        planes = getattr(scene, group)
        deviations = planes.std(axis=1, dtype=np.float64)
        noise = _noise(deviations, planes.shape[1], seed)
        qualities = []
        for level in LEVELS:
            # Overflowing values become infinite; such Gaussians are not drawn.
            with np.errstate(over="ignore"):
                noisy = replace(scene, **{group: planes + np.float32(level) * noise})
            qualities.append(_quality(_views(noisy, cameras), original))
            advance()
        curves.append(_curve(scene, group, tuple(qualities), deviations, config, scale))
    return SensitivityCurves(tuple(cameras), config.profile, seed, scale, tuple(curves))


def _noise(deviations: NDArray[np.float64], count: int, seed: int) -> NDArray[np.float32]:
    """Uniform noise ``(C, N)`` with the given standard deviations ``(C,)``."""
    noise = np.random.default_rng(seed).random((len(deviations), count), np.float32)
    noise -= np.float32(0.5)
    with np.errstate(over="ignore"):
        noise *= (math.sqrt(12) * deviations).astype(np.float32)[:, None]
    return noise


def _views(scene: Scene, cameras: Sequence[Camera]) -> list[NDArray[np.float32]]:
    def draw(camera: Camera) -> NDArray[np.float32]:
        return np.clip(render(scene, camera, device="cpu").colour, 0.0, 1.0)

    return run_all(draw, cameras)


def _quality(views: list[NDArray], original: list[NDArray]) -> float:
    pairs = zip(views, original, strict=True)
    return float(np.mean([min(psnr(a, b), _HIGHEST) for a, b in pairs]))


def _curve(
    scene: Scene,
    group: str,
    qualities: tuple[float, ...],
    deviations: NDArray[np.float64],
    config: Config,
    scale: ErrorScale,
) -> Curve:
    planes = getattr(scene, group)
    varying = deviations > 0
    depths = config.resolved_depths()
    errors = [
        fit_channel(planes[i], group, depths[stream])[0].step / math.sqrt(12) / deviations[i]
        for owner, i, stream in channel_order(len(scene.f_rest) // 3)
        if owner == group and varying[i]
    ]
    ranges = np.ptp(planes[varying].astype(np.float64), axis=1)
    share = float(np.mean(deviations[varying] / ranges)) if varying.any() else 0.0
    profile_level = float(np.sqrt(np.mean(np.square(errors)))) if errors else 0.0
    unit = _error_over_mean(planes, deviations)

    def scaled(level: float) -> float:
        return level if scale == "deviation" else unit * level**2

    tolerance = level_at(THRESHOLD, qualities)
    return Curve(
        ATTRIBUTES[group],
        tuple(scaled(level) for level in LEVELS),
        qualities,
        None if tolerance is None else scaled(tolerance),
        None if tolerance is None else tolerance * share,
        scaled(profile_level),
    )


def _error_over_mean(planes: NDArray[np.float32], deviations: NDArray[np.float64]) -> float:
    """Mean squared error of an attribute ``(C, N)`` over its mean magnitude, with noise of level 1.

    It grows with the square of the level. If all values are zero, there is no noise, and the result
    is 0.
    """
    magnitude = float(np.abs(planes).mean(dtype=np.float64))
    return float(np.square(deviations).mean()) / magnitude if magnitude else 0.0


def level_at(quality: float, qualities: tuple[float, ...]) -> float | None:
    """The level at which a curve first falls to a quality, interpolated in log(level)."""
    if qualities[0] < quality:
        return LEVELS[0]
    for i, (above, below) in enumerate(zip(qualities, qualities[1:], strict=False)):
        if above >= quality > below:
            part = (above - quality) / (above - below)
            return float(LEVELS[i] ** (1 - part) * LEVELS[i + 1] ** part)
    return None

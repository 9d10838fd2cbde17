"""Step sizes of every attribute of every Gaussian, camera-guided or camera-free.

A parameter of sensitivity s with step size d adds the error s d^2 / 12, and halving d costs one
bit. So the total error at a given size is smallest if all parameters add equal errors. The class of
a Gaussian covers most of the differences in sensitivity; a rule predicts the rest from attributes
that are decoded earlier. FORMAT.md, section "Notes on our encoder".

Without cameras, log2 of a step size is log2 of the profile's fineness, minus a constant, minus a
linear function of min(logit, 0) and of the log-scales relative to the scene's median. The
coefficients are rounded from gamma regressions on rendered sensitivities of five scenes (six for
turns; LAB_NOTEBOOK.md). The constants are adjusted so that a bit saves about the same error in
every attribute. The lower sensitivity of turns between two axes of similar length is not fitted:
see `rotation`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.lattice import (
    LARGEST,
    RULE_FRACTION_BITS,
    StepRule,
    to_fixed,
)
from gs_codec.codecs.adaptive.rotation import TURN_RULES, likeness
from gs_codec.coding.exact_math import combine, fitting
from gs_codec.scene import SH_C0

#: Number of classes; limited, so that Gaussians hardly visible in these views are not too coarse in
#: others.
_CLASSES = 9

#: Log2 of the coarsest step sizes: of logits, log-scales, sines of half angles, and colours.
COARSEST = {"opacity": 1, "scaling": 1, "rotation": 1, "colour": 2}

#: Share of Gaussians that are more sensitive than the finest class.
_FINEST = 1e-4

#: Sensitivities below this quantile are raised to it.
_LEAST_SEEN = 0.02

#: Share of Gaussians whose step sizes may be coarser than wanted.
_COARSER = 1e-3

#: Octaves by which steps are finer than sensitivities suggest. Sensitivities hold for small changes
#: and ignore the refit. Chosen on bonsai and mouse so that a bit saves about the same error
#: everywhere.
_FINER = {
    "opacity": -0.4,
    **{f"scale_{k}": 0.25 for k in range(3)},
    **dict.fromkeys(TURN_RULES, 0.25),
    "position": 0.1,
}

#: Approximate size of the sample that rules are fitted to.
_SAMPLE = 20_000

#: Rounds of fitting all rules.
_ROUNDS = 4

#: Number of iterations to fit one rule.
_TURNS = 12

#: Largest coefficient of opacity or of a scale in a rule, in units of 1 / 2**16; its product with a
#: value has 53 bits.
MAX_SLOPE = (1 << 22) - 1

#: Indices of the features (1, min(logit, 0), longest, middle, shortest log-scale) that each rule
#: uses.
_FEATURES = {
    "opacity": [0],
    "scale_0": [0, 1],
    "scale_1": [0, 1, 2],
    "scale_2": [0, 1, 2, 3],
    **{turn: [0, 1, 2, 3, 4] for turn in TURN_RULES},
    "position": [0, 1, 2, 3, 4],
    "colour": [0, 1, 2, 3, 4],
}

#: The rules of each group of the shape.
SHAPE_RULES = {
    "opacity": ("opacity",),
    "scaling": ("scale_0", "scale_1", "scale_2"),
    "rotation": TURN_RULES,
}

#: Log2 of the SH-DC change per unit of colour.
_BY_COLOUR = math.log2(1 / SH_C0)

#: Rows: a constant; then octaves per unit of opacity (below 0.5) and of each scale, longest first.
_LEVELS = {
    "opacity": (-3.0,),
    "scale_0": (-0.45, 0.75),
    "scale_1": (-2.75, 0.75, 0.625),
    "scale_2": (-4.25, 0.75, 0.375, 0.375),
    "turn_0": (-3.0, 0.75, 0.0, 1.125, -0.25),
    "turn_1": (-3.5, 0.75, 1.25, -0.25, -0.25),
    "turn_2": (-3.75, 0.75, 1.25, -0.5, -0.125),
    "position": (-2.875, 0.75, 0.125, -0.375, -0.25),
    "colour": (-1.0 - _BY_COLOUR, 0.75, 0.5, 0.125, -0.125),
}

#: A scene is flat (2DGS) if the median difference of its shortest and middle log-scale exceeds
#: this.
_FLAT = 4.0

#: Features whose relative difference is below this count as linearly dependent. The two shortest
#: scales of flat Gaussians differ only by rounding, and a fit must not depend on that.
_ALIKE = 1e-4

#: Flat Gaussians are coded as if that difference were this.
_THICKNESS = 3.0

#: Ratio of the SH-AC step size to the SH-DC step size.
SH_RATIO = 2.0**-0.25


class Sensitivity(NamedTuple):
    """Squared error in views per squared change of an attribute, float64.

    Summed over views, pixels and colours, with image values 0-1. The errors of Gaussians and
    attributes are assumed to add up.

    Attributes
    ----------
    positions : ndarray, shape (N,)
        Per scene unit; mean of the three axes.
    log_scale : ndarray, shape (3, N)
        Per unit of the natural logarithm.
    rot : ndarray, shape (3, N)
        Per radian of a turn about each of the Gaussian's own axes.
    opacity : ndarray, shape (N,)
        Per unit of the logit.
    colour : ndarray, shape (N,)
        Per unit (0-1) of one colour channel: the sum of (alpha T)^2.
    """

    positions: NDArray[np.float64]
    log_scale: NDArray[np.float64]
    rot: NDArray[np.float64]
    opacity: NDArray[np.float64]
    colour: NDArray[np.float64]


@dataclass(frozen=True)
class StepSizes:
    """Classes and coefficients that determine the step sizes of a scene.

    Attributes
    ----------
    shape_class, colour_class : ndarray, shape (N,), uint8
        Octaves above the finest step size.
    coefficients : dict of str to ndarray, shape (5,)
        ``log2(step) = class + coefficients @ features`` for each rule; for turns, `likeness` is
        added.
    sh_ratios : tuple of three float
        Ratio of the step size of each SH-AC band to that of SH-DC.
    """

    shape_class: NDArray[np.uint8]
    colour_class: NDArray[np.uint8]
    coefficients: dict[str, NDArray[np.float64]]
    sh_ratios: tuple[float, float, float] = (1.0, 1.0, 1.0)


def features(opacity: NDArray, scales: NDArray) -> NDArray[np.float64]:
    """Features ``(5, N)`` of the rules, from opacity logits ``(N,)`` and log-scales ``(3, N)``."""
    return np.stack([np.ones(len(opacity)), np.minimum(opacity, 0), *scales])


def fit_step_sizes(
    sensitivity: Sensitivity, opacity: NDArray, scales: NDArray
) -> Callable[[float], StepSizes]:
    """Choose step sizes with which each parameter of each Gaussian adds about the same error.

    Parameters
    ----------
    sensitivity : Sensitivity
        Its log-scales are in the order of `scales`.
    opacity, scales : ndarray, shape (N,) and (3, N)
        Logits; log-scales, descending.

    Returns
    -------
    callable
        A function from the squared error that a parameter may add (summed like sensitivities) to
        step sizes.
    """
    known = features(opacity, scales)
    alike = likeness(to_fixed(scales, LARGEST)[0])
    shape = {
        "opacity": sensitivity.opacity,
        **{f"scale_{k}": sensitivity.log_scale[k] for k in range(3)},
        # The sines of half angles are coded (factor 4); `likeness` is excluded from the fit.
        **dict(zip(TURN_RULES, sensitivity.rot * 4.0 ** (1 + alike), strict=True)),
        "position": sensitivity.positions,
    }
    # Gaussians that hardly any view sees would distort the fit, and any step size suits them.
    shape = {name: np.maximum(s, _least(s)) for name, s in shape.items()}
    some = slice(None, None, max(1, len(opacity) // _SAMPLE))
    offsets = _fit_offsets({name: s[some] for name, s in shape.items()}, known[:, some])
    shape_class, finest = _classify(_level(shape, offsets, known))
    # SH_C0 is the colour change per unit of SH-DC; for a unit of SH-AC it is the RMS change.
    by_sh = SH_C0**2 * sensitivity.colour
    colour = 0.5 * np.log2(np.maximum(by_sh, _least(by_sh)))
    colour_class, finest_colour = _classify(colour)

    def adding(error: float) -> StepSizes:
        wanted, first = 0.5 * math.log2(12 * error), np.eye(5)[0]
        coefficients = {
            name: (wanted - finest - _FINER.get(name, 0.0)) * first - row
            for name, row in offsets.items()
        }
        coefficients["colour"] = (wanted - finest_colour) * first
        return StepSizes(shape_class, colour_class, coefficients)

    return adding


def _classify(level: NDArray[np.float64]) -> tuple[NDArray[np.uint8], float]:
    """Class of each Gaussian, and the level of the finest class."""
    finest = float(np.quantile(level, 1 - _FINEST))
    return np.clip(np.round(finest - level), 0, _CLASSES - 1).astype(np.uint8), finest


def _least(sensitivity: NDArray[np.float64]) -> float:
    return max(float(np.quantile(sensitivity, _LEAST_SEEN)), 1e-12)


def _fit_offsets(
    shape: dict[str, NDArray[np.float64]], known: NDArray[np.float64]
) -> dict[str, NDArray[np.float64]]:
    """Fit log2 of the root of the sensitivity, minus the Gaussian's level, to the features."""
    level = np.mean([0.5 * np.log2(s) for s in shape.values()], axis=0)
    offsets: dict[str, NDArray[np.float64]] = {}
    for _ in range(_ROUNDS):
        for name, s in shape.items():
            offsets[name] = np.zeros(5)
            use = _FEATURES[name]
            offsets[name][use] = 0.5 / math.log(2) * _fit_mean(known[use], s * 4.0**-level)
        level = _level(shape, offsets, known)
    return offsets


def _level(
    shape: dict[str, NDArray[np.float64]],
    offsets: dict[str, NDArray[np.float64]],
    known: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Level of each Gaussian: log2 of the root of its mean sensitivity, minus the offsets."""
    return 0.5 * np.log2(
        np.mean([s * 4.0 ** -combine(offsets[name], known) for name, s in shape.items()], axis=0)
    )


def _fit_mean(known: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Coefficients c with ``exp(c @ known)`` the mean of `values` (gamma regression)."""
    fits = fitting(known, _ALIKE)
    fitted = np.sum(fits * np.log(values), axis=1)
    for _ in range(_TURNS):
        expected = np.exp(np.clip(combine(fitted, known), -60, 60))
        # Damped and clipped, because a few values are thousands of times the mean.
        excess = np.clip(values / expected - 1, -1, 8)
        fitted = fitted + 0.7 * np.sum(fits * excess, axis=1)
    return fitted


def finest_step(wanted: NDArray[np.float64], lowest: float, highest: float) -> float:
    """Log2 of the finest step size; only a small share of the wanted ones (log2) is below it."""
    finest = float(np.quantile(wanted, _COARSER)) if wanted.size else highest
    return min(max(finest, lowest), highest)


def make_rule(
    coefficients: NDArray[np.float64], unit: float, coarsest: float, thirds: bool = False
) -> StepRule:
    """The rule for ``log2(step) = class + coefficients @ features``, in integers.

    `unit` and `coarsest` are log2 of the unit and of the largest step size. With `thirds`, a shift
    is a third of an octave.
    """
    factor = 3 if thirds else 1
    numbers = [_fixed(factor * (coefficients[0] - unit) + 0.5, (1 << 31) - 1)]
    numbers += [_fixed(factor * c, MAX_SLOPE) for c in coefficients[1:]]
    scales = (numbers[2], numbers[3], numbers[4])
    return StepRule(numbers[0], numbers[1], scales, max(math.floor(factor * (coarsest - unit)), 0))


def _fixed(number: float, largest: int) -> int:
    return min(max(round(number * (1 << RULE_FRACTION_BITS)), -largest), largest)


def blind_coefficients(
    scales: NDArray[np.float64], fineness: float
) -> dict[str, NDArray[np.float64]]:
    """``log2(step) = coefficients @ features`` for each rule, camera-free.

    ``scales (3, N)`` are log-scales, descending; `fineness` is a factor on all step sizes.
    """
    octave = math.log(2)
    # The thickness of flat Gaussians (2DGS) is invisible, so their rules start from a nominal
    # thickness.
    flat = scales.size > 0 and float(np.median(scales[1] - scales[2])) > _FLAT
    if flat:
        scales = np.stack([scales[0], scales[1], scales[1] - _THICKNESS])
    middle = float(np.median(scales.mean(axis=0))) / octave if scales.size else 0.0
    coefficients = {}
    for name, (constant, *slopes) in _LEVELS.items():
        row = np.zeros(5)
        row[1 : 1 + len(slopes)] = -np.array(slopes) / octave
        row[0] = math.log2(fineness) - constant + middle * sum(slopes[1:])
        if flat:
            row[[0, 3, 4]] += row[4] * np.array([-_THICKNESS, 1.0, -1.0])
        coefficients[name] = row
    for turn in TURN_RULES:
        coefficients[turn][0] -= 1.0  # half angles are coded
    coefficients["position"][0] += middle
    return coefficients


def expected_sensitivity(opacity: NDArray, scales: NDArray) -> Sensitivity:
    """Sensitivities of the camera-free rules, up to a factor; log-scales ``(3, N)`` descend."""
    known = features(opacity, scales)
    rules = blind_coefficients(scales.astype(np.float64), 1.0)
    found = {name: 4.0 ** np.clip(-combine(row, known), -99, 99) for name, row in rules.items()}
    alike = likeness(to_fixed(scales, LARGEST)[0])
    return Sensitivity(
        found["position"],
        np.stack([found[f"scale_{k}"] for k in range(3)]),
        np.stack([found[turn] for turn in TURN_RULES]) * 4.0 ** -(1 + alike),
        found["opacity"],
        found["colour"] / SH_C0**2,
    )

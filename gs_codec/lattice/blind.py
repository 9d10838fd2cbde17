"""Steps without views: what opacity and size tell of how much is seen.

Without cameras, log2 of a step size is log2 of the profile's fineness, minus a constant, minus a
linear function of min(logit, 0) and of the log-scales relative to the scene's median. The numbers
are rounded from gamma regressions on rendered sensitivities of five scenes (RESULTS.md), with the
constants moved so that a bit saves about the same error wherever it is spent.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gs_codec.scene import SH_C0

#: SH-DC for a unit of colour.
_BY_COLOUR = math.log2(1 / SH_C0)

#: Constant; then octaves per octave of opacity (where it is low) and of each scale, longest
#: first.
_LEVELS = {
    "opacity": (-3.0,),
    "scale_0": (-0.45, 0.75),
    "scale_1": (-2.75, 0.75, 0.625),
    "scale_2": (-4.25, 0.75, 0.375, 0.375),
    "rotation": (-4.0, 0.75, 1.375, -0.375, -0.375),
    "position": (-2.875, 0.75, 0.125, -0.375, -0.25),
    "colour": (-1.0 - _BY_COLOUR, 0.75, 0.5, 0.125, -0.125),
}

#: Ratio of the step sizes of SH-AC to those of SH-DC.
SH_RATIO = 2.0**-0.25


def blind_coefficients(
    scales: NDArray[np.float64], fineness: float
) -> dict[str, NDArray[np.float64]]:
    """``log2(step) = coefficients @ features`` for each rule; see `fit.features`.

    Parameters
    ----------
    scales : ndarray, shape (3, N)
        Log-scales, descending.
    fineness : float
        Factor on all step sizes.
    """
    octave = math.log(2)
    middle = float(np.median(scales.mean(axis=0))) / octave if scales.size else 0.0
    coefficients = {}
    for name, (constant, *slopes) in _LEVELS.items():
        row = np.zeros(5)
        row[1 : 1 + len(slopes)] = -np.array(slopes) / octave
        row[0] = math.log2(fineness) - constant + middle * sum(slopes[1:])
        coefficients[name] = row
    coefficients["rotation"][0] -= 1.0  # the quaternion's vector has half the angle
    coefficients["position"][0] += middle
    return coefficients

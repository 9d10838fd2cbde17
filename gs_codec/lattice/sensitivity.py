"""How much views change with each attribute of each Gaussian."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Sensitivity(NamedTuple):
    """Squared error that views gain for a squared unit of change of an attribute, float64.

    Summed over views, pixels and colours, with image values 0-1. The errors of Gaussians and
    attributes are assumed to add up.

    Attributes
    ----------
    positions : ndarray, shape (N,)
        Mean of the three axes, for a scene unit.
    log_scale : ndarray, shape (3, N)
        Natural logarithm.
    rot : ndarray, shape (N,)
        Mean of the Gaussian's three axes, turned by a radian.
    opacity : ndarray, shape (N,)
        Logit.
    colour : ndarray, shape (N,)
        One colour channel, 0-1: the sum of (alpha T)^2.
    """

    positions: NDArray[np.float64]
    log_scale: NDArray[np.float64]
    rot: NDArray[np.float64]
    opacity: NDArray[np.float64]
    colour: NDArray[np.float64]

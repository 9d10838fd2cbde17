"""Steps from what is decoded already: a rule is a linear function in integers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.kernels import kernel
from gs_codec.lattice.fixed import PLACES

#: Fraction bits of a rule's numbers.
RULE_PLACES = 16

#: A step size is at most its unit times 2 to this power.
MAX_SHIFT = 31


@dataclass(frozen=True)
class StepRule:
    """``shift = class + intercept + opacity * min(logit, 0) + sum of scale_k * log_scale_k``.

    Rounded down and clamped to 0 to `limit`. `intercept`, `opacity` and `scales` are in units of
    1 / 2**16; the intercept includes a half where shifts should be rounded to nearest.
    """

    intercept: int
    opacity: int = 0
    scales: tuple[int, int, int] = (0, 0, 0)
    limit: int = MAX_SHIFT

    def shifts(
        self,
        classes: NDArray[np.integer],
        weight: int,
        opacity: NDArray[np.int64],
        scales: NDArray[np.int64],
    ) -> NDArray[np.int64]:
        """Shifts ``(n,)``.

        Parameters
        ----------
        classes : ndarray, shape (n,)
            How many octaves coarser than the finest a Gaussian is.
        weight : int
            Shift that one class adds, 1 or 3.
        opacity, scales : ndarray, shape (n,) and (3, n), int64
            Fixed-point values; those that are not decoded yet have a coefficient of 0.
        """
        numbers = np.array([self.intercept, self.opacity, *self.scales], np.int64)
        out = np.empty(len(classes), np.int64)
        _shifts(numbers, self.limit, weight, classes, opacity, scales, out)
        return out


@kernel
def _shifts(numbers, limit, weight, classes, opacity, scales, out):
    for i in range(len(out)):
        total = numbers[0] + ((weight * np.int64(classes[i])) << RULE_PLACES)
        total += (numbers[1] * min(opacity[i], 0)) >> PLACES
        for k in range(3):
            total += (numbers[2 + k] * scales[k, i]) >> PLACES
        out[i] = min(max(total >> RULE_PLACES, 0), limit)

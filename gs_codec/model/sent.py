"""Tables sent as they are: counts rounded to a short mantissa."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gs_codec.model.table import FrequencyTable, normalise

#: Bit length of the largest weight.
MAX_EXPONENT = 32
MAX_MANTISSA = 15


@dataclass(frozen=True)
class SentModel:
    """Weights ``(A,)`` below 2**32 whose bits after the first `mantissa` + 1 are 0."""

    kind: ClassVar[str] = "table"
    weights: NDArray[np.int64]
    mantissa: int
    precision: int

    @classmethod
    def fit(cls, histogram: NDArray[np.int64], mantissa: int, precision: int) -> SentModel:
        """Counts rounded to `mantissa` bits after the leading one."""
        excess = max(int(histogram.max()).bit_length() - MAX_EXPONENT + 1, 0)
        counts = np.where(histogram > 0, np.maximum(histogram >> excess, 1), 0)
        lengths = np.frexp(counts.astype(np.float64))[1]
        shifts = np.maximum(lengths - 1 - mantissa, 0)
        weights = (counts + ((1 << shifts) >> 1)) >> shifts << shifts
        return cls(weights, mantissa, precision)

    def frequencies(self, alphabet: int) -> FrequencyTable:
        """Table of ``alphabet`` symbols; those of weight 0 cannot occur."""
        return normalise(self.weights, self.precision)

    def describe(self) -> dict[str, int]:
        """Symbols in use and bits of the mantissas, for reports."""
        return {"symbols": int(np.count_nonzero(self.weights)), "mantissa": self.mantissa}

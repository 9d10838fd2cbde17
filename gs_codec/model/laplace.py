"""Laplace distribution of SH-AC symbols (paper, Section 4.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gs_codec.model.table import FrequencyTable, normalise


@dataclass(frozen=True)
class LaplaceModel:
    """Laplace distribution centred on the middle symbol ``A / 2``, edge bins open.

    Parameters
    ----------
    decay : int
        ``exp(-1 / (2 b))`` in 1/65536, b the scale in symbols; 1-65535.
    precision : int
        Base-2 logarithm of the table's sum.
    """

    kind: ClassVar[str] = "laplace"
    decay: int
    precision: int

    @classmethod
    def fit(cls, scale: float, precision: int) -> LaplaceModel:
        """Model of mean absolute deviation `scale`, in symbols."""
        decay = math.exp(-0.5 / max(scale, 1e-3))
        return cls(min(max(round(65536 * decay), 1), 65535), precision)

    def frequencies(self, alphabet: int) -> FrequencyTable:
        """Table of ``alphabet`` symbols, by integer arithmetic alone (FORMAT.md, "Laplace")."""
        middle = alphabet // 2
        tails = []
        tail = self.decay << 15
        for _ in range(middle + 1):
            tails.append(tail)
            tail = tail * self.decay * self.decay >> 32
        below = [tails[middle - symbol] for symbol in range(1, middle + 1)]
        below += [(1 << 32) - tails[symbol - middle - 1] for symbol in range(middle + 1, alphabet)]
        edges = np.array([0, *below, 1 << 32], np.int64)
        return normalise(np.maximum(np.diff(edges), 1), self.precision)

    def describe(self) -> dict[str, float]:
        """Parameters in symbols, for reports."""
        return {"scale": -0.5 / math.log(self.decay / 65536)}

"""Curves of rate over quality, and their difference at equal quality."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Curve:
    """Log2 of bits over PSNR between measured points, by pchip as in Bjontegaard's measure.

    Attributes
    ----------
    psnr : ndarray, shape (P,)
        dB, ascending.
    log_bits : ndarray, shape (P,)
        Log2 of bits a Gaussian.
    """

    psnr: NDArray[np.float64]
    log_bits: NDArray[np.float64]

    @classmethod
    def through(cls, points: Iterable[tuple[float, float]]) -> Curve:
        """Through points of (PSNR, bits); of those of one PSNR, that of the fewest bits."""
        best: dict[float, float] = {}
        for psnr, bits in points:
            best[psnr] = min(bits, best.get(psnr, np.inf))
        psnrs = np.array(sorted(best), np.float64)
        return cls(psnrs, np.log2(np.array([best[psnr] for psnr in psnrs], np.float64)))

    @classmethod
    def through_lines(cls, lines: Iterable[dict[str, Any]]) -> Curve:
        """Through result lines; those of equal views, which have no PSNR, are left out."""
        points = [(line["mean"]["psnr"], line["bits_per_gaussian"]) for line in lines]
        return cls.through((psnr, bits) for psnr, bits in points if psnr is not None)

    @property
    def range(self) -> tuple[float, float]:
        """Lowest and highest PSNR; (inf, -inf) without points."""
        return float(self.psnr.min(initial=np.inf)), float(self.psnr.max(initial=-np.inf))

    def bits_at(self, psnr: float) -> float | None:
        """Bits at a PSNR, or None outside the range."""
        low, high = self.range
        if not low <= psnr <= high:
            return None
        if low == high:
            return float(2 ** self.log_bits[0])
        return float(2 ** self._interpolator()(psnr))

    def mean_log_bits(self, low: float, high: float) -> float:
        """Mean of log2 of bits over a part of the range."""
        return float(self._interpolator().integrate(low, high)) / (high - low)

    def _interpolator(self):
        from scipy.interpolate import PchipInterpolator

        return PchipInterpolator(self.psnr, self.log_bits)


@dataclass(frozen=True)
class Rate:
    """Percent of bits over a reference, mean over the PSNR from `low` to `high` dB."""

    percent: float
    low: float
    high: float


def bd_rate(reference: Curve, tested: Curve) -> Rate | None:
    """Bits that `tested` takes over `reference`, over the PSNR that both have; None without any.

    Bjontegaard's measure (VCEG-M33); negative where bits are saved.
    """
    low = max(reference.range[0], tested.range[0])
    high = min(reference.range[1], tested.range[1])
    if low >= high:
        return None
    factor = 2 ** (tested.mean_log_bits(low, high) - reference.mean_log_bits(low, high))
    return Rate(100 * (factor - 1), low, high)

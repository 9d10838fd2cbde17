"""Curves of rate over quality, and their difference at equal quality."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np


class Curve:
    """Log2 of bits over PSNR between measured points, by pchip as in Bjontegaard's measure.

    Parameters
    ----------
    points : iterable of tuple of two float
        PSNR in dB, and bits for each Gaussian; of points of one PSNR the smallest counts.
    """

    def __init__(self, points: Iterable[tuple[float, float]]) -> None:
        best: dict[float, float] = {}
        for psnr, bits in points:
            best[psnr] = min(bits, best.get(psnr, np.inf))
        self._psnr = np.array(sorted(best), np.float64)
        self._log_bits = np.log2([best[psnr] for psnr in sorted(best)])

    @property
    def range(self) -> tuple[float, float]:
        """Lowest and highest PSNR; (inf, -inf) without points."""
        return self._psnr.min(initial=np.inf), self._psnr.max(initial=-np.inf)

    def bits_at(self, psnr: float) -> float | None:
        """Bits at a PSNR, or None outside the range."""
        low, high = self.range
        if not low <= psnr <= high:
            return None
        if low == high:
            return float(2 ** self._log_bits[0])
        return float(2 ** self._interpolator()(psnr))

    def mean_log_bits(self, low: float, high: float) -> float:
        """Mean of log2 of bits over a part of the range."""
        return float(self._interpolator().integrate(low, high)) / (high - low)

    def _interpolator(self):
        from scipy.interpolate import PchipInterpolator

        return PchipInterpolator(self._psnr, self._log_bits)


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

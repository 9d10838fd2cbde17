"""Curves of rate over quality, and what one saves over another at equal quality."""

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
        """Through result lines, but for those of equal views, which have no PSNR."""
        points = [(line["mean"]["psnr"], line["bits_per_gaussian"]) for line in lines]
        return cls.through((psnr, bits) for psnr, bits in points if psnr is not None)

    @property
    def range(self) -> tuple[float, float]:
        """Lowest and highest PSNR; (inf, -inf) where there are no points."""
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


def common_range(first: Curve, second: Curve) -> tuple[float, float] | None:
    """Lowest and highest PSNR that both curves have, or None where they do not overlap."""
    low = max(first.range[0], second.range[0])
    high = min(first.range[1], second.range[1])
    return (low, high) if low < high else None


def bd_rate(reference: Curve, tested: Curve) -> float | None:
    """Percent of bits that `tested` takes over `reference`, mean over the PSNR both have.

    Bjontegaard's measure (VCEG-M33); negative where bits are saved, None without overlap.
    """
    common = common_range(reference, tested)
    if common is None:
        return None
    return 100 * (2 ** (tested.mean_log_bits(*common) - reference.mean_log_bits(*common)) - 1)

"""Result lines of the suite, by kind and scene; curves that compare them at equal quality."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gs_codec.bench.side_by_side import is_ours
from gs_codec.config import LOSSLESS, PROFILES
from gs_codec.runtime.optional import needed

Line = dict[str, Any]


class Curve:
    """Log2 of bits as a function of PSNR, interpolated by pchip as in Bjontegaard's measure.

    Parameters
    ----------
    points : iterable of tuple of two float
        PSNR in dB, and bits per Gaussian; of points with equal PSNR, the smallest is used.
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
        """Bits at a PSNR; None outside the range."""
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
        interpolate = needed("scipy.interpolate", "curves over PSNR")
        return interpolate.PchipInterpolator(self._psnr, self._log_bits)


@dataclass(frozen=True)
class Rate:
    """Percentage of bits relative to a reference, averaged over PSNR from `low` to `high` dB."""

    percent: float
    low: float
    high: float


def bd_rate(reference: Curve, tested: Curve) -> Rate | None:
    """Bits of `tested` relative to `reference`, over their common PSNR range; None without one.

    Bjontegaard's measure (VCEG-M33); negative if bits are saved.
    """
    low = max(reference.range[0], tested.range[0])
    high = min(reference.range[1], tested.range[1])
    if low >= high:
        return None
    factor = 2 ** (tested.mean_log_bits(low, high) - reference.mean_log_bits(low, high))
    return Rate(100 * (factor - 1), low, high)


@dataclass(frozen=True)
class Results:
    """Lines of a run of the suite, complete or partial."""

    lines: Sequence[Line]

    def of(self, kind: str, scene: str | None = None) -> list[Line]:
        """Lines of a kind, for one scene or all; without absent codecs."""
        return [
            line
            for line in self.lines
            if line.get("kind") == kind
            and "absent" not in line
            and scene in (None, line.get("scene"))
        ]

    def first(self, kind: str, scene: str | None = None) -> Line:
        """The first of these lines; empty if there is none."""
        return next(iter(self.of(kind, scene)), {})

    @property
    def scenes(self) -> list[str]:
        """Names of the scenes, those with photographs first."""
        found = dict.fromkeys(line["scene"] for line in self.of("beside") + self.of("point"))
        return sorted(found, key=lambda scene: not self.has_photographs(scene))

    @property
    def absent(self) -> list[str]:
        """Distinct reasons why codecs could not be measured."""
        found = [str(line["absent"]) for line in self.lines if "absent" in line]
        return list(dict.fromkeys(found))

    def has_photographs(self, scene: str) -> bool:
        """Whether codecs of a scene have a delta-PSNR."""
        return any(delta_of(line) is not None for line in self.of("beside", scene))

    def points(self, scene: str, curve: str) -> list[Line]:
        """Points of a curve, in ascending order of bits."""
        found = [line for line in self.of("point", scene) if line["curve"] == curve]
        return sorted(found, key=lambda line: line["bits_per_gaussian"])

    def curve(self, scene: str, name: str) -> Curve:
        """The curve through these points."""
        return curve_of(self.points(scene, name))

    def bits_at_quality(self, line: Line, curve: str) -> str:
        """Bits of a curve at a codec's PSNR; an upper bound if even the coarsest point is better.

        Empty for our own profiles except the paper's, and if the curve ends below that PSNR.
        """
        codec, psnr = line["codec"], psnr_of(line)
        if psnr is None or (is_ours(codec) and codec not in PROFILES):
            return ""
        drawn = self.curve(line["scene"], curve)
        low, _ = drawn.range
        bits = drawn.bits_at(psnr)
        if bits is None and psnr < low < math.inf:
            return f"≤ {drawn.bits_at(low):.1f}"
        return "" if bits is None else f"{bits:.1f}"

    def lossless_bits(self, line: Line) -> str:
        """Bits of our lossless profile, if another codec is lossless; otherwise empty."""
        ours = [x for x in self.of("beside", line["scene"]) if x["codec"] == LOSSLESS]
        if not ours or not is_exact(line) or line["codec"] == LOSSLESS:
            return ""
        return f"{ours[0]['bits_per_gaussian']:.1f} (`{LOSSLESS}`)"


def curve_of(lines: Iterable[Line]) -> Curve:
    """The curve through result lines, without those of equal views, which have no PSNR."""
    seen = [line for line in lines if psnr_of(line) is not None]
    return Curve((line["mean"]["psnr"], line["bits_per_gaussian"]) for line in seen)


def psnr_of(line: Line) -> float | None:
    """PSNR against the scene's own views; None if unknown or if views are equal."""
    return line.get("mean", {}).get("psnr")


def is_exact(line: Line) -> bool:
    """Whether the decoded scene's views equal its own."""
    return "mean" in line and psnr_of(line) is None


def delta_of(line: Line) -> float | None:
    """Delta-PSNR against photographs, if there are any."""
    return line.get("delta", {}).get("psnr")

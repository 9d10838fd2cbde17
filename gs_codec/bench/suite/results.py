"""Result lines of the suite: found by kind and scene; curves that compare them at equal quality."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gs_codec.bench.side_by_side import is_ours
from gs_codec.config import LOSSLESS, PROFILES
from gs_codec.runtime.lazy import needed

Line = dict[str, Any]


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
        interpolate = needed("scipy.interpolate", "curves over PSNR")
        return interpolate.PchipInterpolator(self._psnr, self._log_bits)


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


@dataclass(frozen=True)
class Results:
    """Lines of a run of the suite, or of a part of it."""

    lines: Sequence[Line]

    def of(self, kind: str, scene: str | None = None) -> list[Line]:
        """Lines of a kind, of one scene or of all; without absent codecs."""
        return [
            line
            for line in self.lines
            if line.get("kind") == kind
            and "absent" not in line
            and scene in (None, line.get("scene"))
        ]

    def first(self, kind: str, scene: str | None = None) -> Line:
        """The first of such lines; empty if there is none."""
        return next(iter(self.of(kind, scene)), {})

    @property
    def scenes(self) -> list[str]:
        """Names of the scenes, those with photographs first."""
        found = dict.fromkeys(line["scene"] for line in self.of("beside") + self.of("point"))
        return sorted(found, key=lambda scene: not self.has_photographs(scene))

    @property
    def absent(self) -> list[str]:
        """Reasons why codecs could not be measured; each once."""
        found = [str(line["absent"]) for line in self.lines if "absent" in line]
        return list(dict.fromkeys(found))

    def has_photographs(self, scene: str) -> bool:
        """Whether codecs of a scene have a delta-PSNR."""
        return any(delta_of(line) is not None for line in self.of("beside", scene))

    def points(self, scene: str, curve: str) -> list[Line]:
        """Points of a curve, fewest bits first."""
        found = [line for line in self.of("point", scene) if line["curve"] == curve]
        return sorted(found, key=lambda line: line["bits_per_gaussian"])

    def curve(self, scene: str, name: str) -> Curve:
        """The curve through such points."""
        return curve_of(self.points(scene, name))

    def bits_at_quality(self, line: Line, curve: str) -> str:
        """Bits of a curve at a codec's PSNR; at most so many if even its coarsest point is better.

        Empty for our own profiles but the paper's, and where the curve ends below that PSNR.
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
        """Bits of our lossless profile beside another codec that is exact; else empty."""
        ours = [x for x in self.of("beside", line["scene"]) if x["codec"] == LOSSLESS]
        if not ours or not is_exact(line) or line["codec"] == LOSSLESS:
            return ""
        return f"{ours[0]['bits_per_gaussian']:.1f} (`{LOSSLESS}`)"


def curve_of(lines: Iterable[Line]) -> Curve:
    """The curve through result lines; those of equal views, which have no PSNR, are left out."""
    seen = [line for line in lines if psnr_of(line) is not None]
    return Curve((line["mean"]["psnr"], line["bits_per_gaussian"]) for line in seen)


def psnr_of(line: Line) -> float | None:
    """PSNR against the scene's own views; None if there is none or views are equal."""
    return line.get("mean", {}).get("psnr")


def is_exact(line: Line) -> bool:
    """Whether the decoded scene's views equal its own."""
    return "mean" in line and psnr_of(line) is None


def delta_of(line: Line) -> float | None:
    """Delta-PSNR against photographs, if there are any."""
    return line.get("delta", {}).get("psnr")

"""Where a codec stands by its quality: an axis for decibels of either kind."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from gs_codec.bench.suite.results import Line, delta_of, is_exact, psnr_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Losses that are about as far apart as they look: the axis is logarithmic beyond the first.
_LOSSES = (0.0, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
_FINEST = 0.03


@dataclass(frozen=True)
class QualityAxis:
    """Delta-PSNR against photographs, its losses on a logarithmic axis, or PSNR against the
    scene's own views; up is better.
    """  # noqa: D205

    by_photographs: bool

    def value(self, line: Line) -> float | None:
        """Decibels of a result line; None where there are none, or views are equal."""
        return delta_of(line) if self.by_photographs else psnr_of(line)

    def place(self, decibels: float) -> float:
        """Where such decibels are on the axis."""
        if not self.by_photographs:
            return decibels
        return math.copysign(math.log10(1 + abs(decibels) / _FINEST), decibels)

    def places(self, lines: Sequence[Line]) -> list[float | None]:
        """Where lines are; those with equal views in a band above all others."""
        found = [self.value(line) for line in lines]
        measured = [
            self.place(value)
            for value, line in zip(found, lines, strict=True)
            if value is not None and not is_exact(line)
        ]
        above = self.exact(measured)
        return [
            above if is_exact(line) else None if value is None else self.place(value)
            for value, line in zip(found, lines, strict=True)
        ]

    def exact(self, places: Sequence[float]) -> float:
        """Where the band of equal views is, above all of these."""
        if not places:
            return 0.0
        top = max([*places, 0.0] if self.by_photographs else places)
        return top + max(0.16 * (top - min(places)), 0.15)

    def dress(self, axis: Axes, places: Sequence[float], exact: bool) -> None:
        """Limits, ticks and title of the axis for what is at these places."""
        low, top = min(places, default=0.0), max(places, default=1.0)
        margin = max(0.09 * (top - low), 0.1)
        axis.set_ylim(low - margin, top + margin)
        if self.by_photographs:
            both = [*(-loss for loss in _LOSSES), *_LOSSES[1:]]
            shown = [x for x in both if low - margin < self.place(x) < top + margin]
            ticks, texts = [self.place(x) for x in shown], [f"{x:+g}" if x else "0" for x in shown]
        else:
            ticks = [float(tick) for tick in axis.get_yticks() if tick < top + margin]
            ticks = [tick for tick in ticks if tick > low - margin]
            texts = [f"{tick:g}" for tick in ticks]
        if exact:
            ticks, texts = self._with_exact(axis, places, ticks, texts)
        axis.set_yticks(ticks, texts)
        against = "delta-PSNR, photographs" if self.by_photographs else "PSNR against own views"
        axis.set_ylabel(f"{against}, dB")

    def _with_exact(
        self, axis: Axes, places: Sequence[float], ticks: list[float], texts: list[str]
    ) -> tuple[list[float], list[str]]:
        top = max(places)
        others = [place for place in places if place < top]
        if self.by_photographs:
            others.append(0.0)
        below = max(others, default=top - 1)
        border = (top + below) / 2
        axis.axhspan(border, axis.get_ylim()[1], color="#f3f6f6", zorder=0)
        kept = [(tick, text) for tick, text in zip(ticks, texts, strict=True) if tick < border]
        return [*(tick for tick, _ in kept), top], [*(text for _, text in kept), "equal"]


def beats(first: tuple[float, ...], second: tuple[float, ...]) -> bool:
    """Whether a point is as small as another everywhere, and smaller somewhere."""
    return first != second and all(a <= b for a, b in zip(first, second, strict=True))


def on_front(points: Sequence[tuple[float, ...]]) -> list[bool]:
    """Which points no other beats."""
    return [not any(beats(other, point) for other in points) for point in points]

"""Result lines of the suite, found by kind and scene."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from gs_codec.bench.curves import Curve

Line = dict[str, Any]

#: Curves of ours, in the order they are shown in.
CURVES = ("by attributes", "by views")


@dataclass(frozen=True)
class Results:
    """Lines of a run of the suite, or of a part of it."""

    lines: Sequence[Line]

    def of(self, kind: str, scene: str | None = None) -> list[Line]:
        """Lines of a kind, of one scene or of all; without those of what is absent."""
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
        """Names of the scenes in the order of the lines; scaling has scenes of its own."""
        kinds = ("scaling", "growth", "machine", "paper", "skipped")
        found = [line for line in self.lines if line.get("kind") not in kinds]
        return list(dict.fromkeys(line["scene"] for line in found if "scene" in line))

    @property
    def absent(self) -> list[str]:
        """What could not be measured, and why; each once."""
        found = [str(line["absent"]) for line in self.lines if "absent" in line]
        return list(dict.fromkeys(found))

    def codecs(self, scene: str) -> list[Line]:
        """What was measured beside each other, pruned scenes after the others."""
        return self.of("beside", scene) + self.of("pruned", scene)

    def codec(self, scene: str, name: str) -> Line:
        """The line of one of these; empty if there is none."""
        return next((line for line in self.codecs(scene) if line["codec"] == name), {})

    def title(self, scene: str) -> str:
        """Name, size and SH degree of a scene."""
        line = self.first("scene", scene)
        if not line:
            return scene
        return f"{scene}: {line['gaussians']:,} Gaussians, SH degree {line['sh_degree']}"

    def by_photographs(self, scene: str) -> bool:
        """Whether codecs of a scene have a delta-PSNR."""
        return any(delta_of(line) is not None for line in self.codecs(scene))

    def points(self, scene: str, curve: str) -> list[Line]:
        """Points of a curve, fewest bits first."""
        found = [line for line in self.of("point", scene) if line["curve"] == curve]
        return sorted(found, key=lambda line: line["bits_per_gaussian"])

    def bits_at_most(self, scene: str, curve: str, psnr: float) -> float | None:
        """Bits of a curve's point that is better than this quality, where it has one."""
        points = Curve.through_lines(self.points(scene, curve))
        low, _ = points.range
        return points.bits_at(low) if psnr < low < math.inf else None


def finite(value: Any) -> float | None:
    """A number, or None for what is none: missing, infinite or not a number."""
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def psnr_of(line: Line) -> float | None:
    """PSNR against the scene's own views; None where there is none or views are equal."""
    return finite(line.get("mean", {}).get("psnr"))


def is_exact(line: Line) -> bool:
    """Whether the decoded scene's views equal its own."""
    return "mean" in line and psnr_of(line) is None


def delta_of(line: Line) -> float | None:
    """Delta-PSNR against photographs, where there are any."""
    return finite(line.get("delta", {}).get("psnr"))


def median_of(spread: Any) -> float | None:
    """The median of repeated measurements."""
    return finite(spread.get("median")) if isinstance(spread, dict) else finite(spread)

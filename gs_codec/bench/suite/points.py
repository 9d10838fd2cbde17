"""Points of rate over quality: our profiles and the paper's, and steps beyond them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from gs_codec.bench.beside import GUIDED, is_ours
from gs_codec.bench.curves import Curve
from gs_codec.bench.rendered import measure_quality
from gs_codec.bench.suite.scenes import MeasuredScene
from gs_codec.config import DEPTH_GROUPS, LATTICE_PROFILES, MAX_DEPTH, PROFILES, Config
from gs_codec.preparation.steps import Plan

#: Names of curves: the paper's profiles, and ours without cameras and with.
PAPER, FREE, CAMERA_GUIDED = "paper", "camera-free", "camera-guided"

#: How far curves are continued beyond their profiles: factors of our steps, bits of the paper's.
_FACTORS = (2.0, 4.0)
_BITS = (1, 2)


@dataclass
class _Ladder:
    """Profiles of a curve, finest first, and its points that are measured so far.

    Attributes
    ----------
    curve : str
    plan : Plan or None
        Views of a camera-guided curve.
    named : list of (str, Config)
        The profiles themselves.
    finer, coarser : list of (str, Config)
        Not measured yet; nearest first.
    points : dict of str to dict
        Result lines by the names of the points.
    """

    curve: str
    plan: Plan | None
    named: list[tuple[str, Config]]
    finer: list[tuple[str, Config]]
    coarser: list[tuple[str, Config]]
    points: dict[str, dict[str, Any]] = field(default_factory=dict)

    def named_psnr(self) -> list[float]:
        """PSNR of the profiles themselves."""
        found = [self.points[name]["mean"]["psnr"] for name, _ in self.named]
        return [psnr for psnr in found if psnr is not None]


def measure_points(
    measured: MeasuredScene, config: Config, guided: bool, beside: Sequence[dict[str, Any]]
) -> Iterator[dict[str, Any]]:
    """Result lines of the points of each curve.

    Curves are continued until they reach each other's profiles and the quality of every codec
    `beside`: the paper's by a bit more or less of each depth, ours by half or twice the steps.

    Parameters
    ----------
    measured : MeasuredScene
    config : Config
        What profiles have in common.
    guided : bool
        Whether there is a camera-guided curve.
    beside : sequence of dict
        Lines of `measure_beside`; profiles among them are not measured again.
    """
    paper, ours = _paper_ladder(config), [_own_ladder(config, FREE, None)]
    if guided:
        ours.append(_own_ladder(config, CAMERA_GUIDED, measured.plan))
    known = {line["codec"]: line for line in beside if "mean" in line}
    others = [line["mean"]["psnr"] for codec, line in known.items() if not is_ours(codec)]
    wanted = [psnr for psnr in others if psnr is not None]

    def measure(ladder: _Ladder, point: str, chosen: Config) -> dict[str, Any]:
        line = known.get(point if ladder.plan is None else f"{point}{GUIDED}")
        if line is None:
            views = (measured.cameras, measured.truth)
            line = measure_quality(measured.scene, measured.name, *views, chosen, ladder.plan)
        line = line | {"kind": "point", "curve": ladder.curve, "point": point}
        ladder.points[point] = line
        return line

    def extend(ladder: _Ladder, wanted: Sequence[float]) -> Iterator[dict[str, Any]]:
        for steps, beyond in ((ladder.finer, False), (ladder.coarser, True)):
            while steps and _is_beyond(ladder, wanted, beyond):
                yield measure(ladder, *steps.pop(0))

    for ladder in (paper, *ours):
        for point, chosen in ladder.named:
            yield measure(ladder, point, chosen)
    for ladder in ours:
        yield from extend(ladder, [*paper.named_psnr(), *wanted])
    yield from extend(paper, [*(psnr for own in ours for psnr in own.named_psnr()), *wanted])


def _is_beyond(ladder: _Ladder, wanted: Sequence[float], below: bool) -> bool:
    """Whether a wanted quality is above all points of a curve, or below."""
    low, high = Curve.through_lines(ladder.points.values()).range
    if below:
        return min(wanted, default=math.inf) < low
    return max(wanted, default=-math.inf) > high


def _paper_ladder(config: Config) -> _Ladder:
    def shifted(profile: str, bits: int) -> Config:
        depths = PROFILES[profile]
        changed = {g: min(max(depths[g] + bits, 1), MAX_DEPTH[g]) for g in DEPTH_GROUPS}
        return replace(config, profile=profile, depths=changed)

    finest, *_, coarsest = PROFILES
    return _Ladder(
        PAPER,
        None,
        [(name, replace(config, profile=name, depths={})) for name in PROFILES],
        [(f"{finest} + {bits} bits", shifted(finest, bits)) for bits in _BITS],
        [(f"{coarsest} - {bits} bits", shifted(coarsest, -bits)) for bits in _BITS],
    )


def _own_ladder(config: Config, curve: str, plan: Plan | None) -> _Ladder:
    def scaled(profile: str, factor: float) -> Config:
        return replace(config, profile=profile, depths={}, coarseness=factor)

    finest, *_, coarsest = LATTICE_PROFILES
    return _Ladder(
        curve,
        plan,
        [(name, scaled(name, 1.0)) for name in LATTICE_PROFILES],
        [(f"{finest}, steps / {factor:g}", scaled(finest, 1 / factor)) for factor in _FACTORS],
        [(f"{coarsest}, steps x {factor:g}", scaled(coarsest, factor)) for factor in _FACTORS],
    )

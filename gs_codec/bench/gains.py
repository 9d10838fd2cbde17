"""What profiles ``l``, ``m``, ``s`` save over the paper's at equal quality, on each scene."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gs_codec.bench.beside import is_ours
from gs_codec.bench.curves import Curve, bd_rate, common_range
from gs_codec.bench.rendered import measure_quality
from gs_codec.config import DEPTH_GROUPS, LATTICE_PROFILES, MAX_DEPTH, PROFILES, Config
from gs_codec.preparation.pipeline import Plan
from gs_codec.rendering.camera import Camera
from gs_codec.scene import Scene

#: How far curves are drawn beyond their profiles, to where the other's are: factors of steps.
_FACTORS = (2.0, 4.0)
#: The same for the paper's: bits of every depth.
_BITS = (1, 2)


@dataclass
class _Ladder:
    """A kind of profiles, finest first, and what was measured of them.

    Attributes
    ----------
    curve : str
        What the kind is called in results.
    plan : Plan or None
        What profiles that go by views look at.
    named : tuple of (str, Config)
    finer, coarser : list of (str, Config)
        Not measured yet; nearest first.
    lines : dict of str to dict
        Result lines by name.
    """

    curve: str
    plan: Plan | None
    named: tuple[tuple[str, Config], ...]
    finer: list[tuple[str, Config]]
    coarser: list[tuple[str, Config]]
    lines: dict[str, dict[str, Any]] = field(default_factory=dict)

    @property
    def points(self) -> Curve:
        """The curve through what was measured."""
        return Curve.through_lines(self.lines.values())

    def named_psnr(self) -> dict[str, float]:
        """PSNR of the profiles themselves."""
        psnr = {name: self.lines[name]["mean"]["psnr"] for name, _ in self.named}
        return {name: value for name, value in psnr.items() if value is not None}


def measure_gains(
    scene: Scene,
    name: str,
    cameras: Sequence[Camera],
    truth: Path | None,
    config: Config,
    plan: Plan | None,
    beside: Iterable[dict[str, Any]] = (),
) -> Iterator[dict[str, Any]]:
    """Points of the curves of a scene, then the bits saved where they can be compared.

    `config` gives what profiles have in common; without a `plan` there is no curve by views.
    Quality is PSNR against the scene's own views. Where curves do not reach each other's profiles
    they are continued, the paper's by a bit more or less of each depth, ours by half or twice the
    steps. Profiles among `beside`, lines of `measure_beside`, are taken from there, and curves are
    continued to the quality of all else there.
    """
    paper = _paper_ladder(config)
    ours = [_own_ladder(config, "by attributes", None)]
    if plan is not None:
        ours.append(_own_ladder(config, "by views", plan))
    known = {line["codec"]: line for line in beside if line["kind"] == "beside" and "mean" in line}
    others = [line["mean"]["psnr"] for codec, line in known.items() if not is_ours(codec)]
    wanted = [psnr for psnr in others if psnr is not None]

    def measure(ladder: _Ladder, label: str, chosen: Config) -> dict[str, Any]:
        codec = label if ladder.plan is None else f"{label}, by views"
        if codec in known:
            line = _as_rendered(known[codec], chosen, ladder.plan is not None)
        else:
            line = measure_quality(scene, name, cameras, truth, chosen, ladder.plan)
        ladder.lines[label] = line | {"kind": "point", "curve": ladder.curve, "point": label}
        return ladder.lines[label]

    def extend(ladder: _Ladder, wanted: Sequence[float]) -> Iterator[dict[str, Any]]:
        while ladder.finer and max(wanted, default=-math.inf) > ladder.points.range[1]:
            yield measure(ladder, *ladder.finer.pop(0))
        while ladder.coarser and min(wanted, default=math.inf) < ladder.points.range[0]:
            yield measure(ladder, *ladder.coarser.pop(0))

    for ladder in (paper, *ours):
        for label, chosen in ladder.named:
            yield measure(ladder, label, chosen)
    for ladder in ours:
        yield from extend(ladder, [*paper.named_psnr().values(), *wanted])
    named = [psnr for ladder in ours for psnr in ladder.named_psnr().values()]
    yield from extend(paper, [*named, *wanted])
    for ladder in ours:
        yield from _gains(name, paper, ladder)


def _as_rendered(line: dict[str, Any], config: Config, by_views: bool) -> dict[str, Any]:
    """What `measure_quality` would say of a profile that was measured beside others."""
    same = ("scene", "gaussians", "bits_per_gaussian", "ratio")
    quality = ("views", "mean", "worst_psnr", "truth", "delta")
    return {
        "profile": config.profile,
        "by_views": by_views,
        "encode_seconds": line["encode_seconds"]["median"],
        **{name: line[name] for name in (*same, *quality) if name in line},
    }


def _paper_ladder(config: Config) -> _Ladder:
    def shifted(profile: str, bits: int) -> Config:
        depths = PROFILES[profile]
        changed = {g: min(max(depths[g] + bits, 1), MAX_DEPTH[g]) for g in DEPTH_GROUPS}
        return replace(config, profile=profile, depths=changed)

    finest, *_, coarsest = PROFILES
    return _Ladder(
        "paper",
        None,
        tuple((name, replace(config, profile=name, depths={})) for name in PROFILES),
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
        tuple((name, scaled(name, 1.0)) for name in LATTICE_PROFILES),
        [(f"{finest}, steps / {factor:g}", scaled(finest, 1 / factor)) for factor in _FACTORS],
        [(f"{coarsest}, steps x {factor:g}", scaled(coarsest, factor)) for factor in _FACTORS],
    )


def _gains(scene: str, paper: _Ladder, ours: _Ladder) -> Iterator[dict[str, Any]]:
    """What a curve saves over the paper's at each profile, and all in all; None out of range."""
    identity = {"scene": scene, "curve": ours.curve}
    reference, tested = paper.points, ours.points
    for profile, psnr in (paper.named_psnr() | ours.named_psnr()).items():
        bits = [curve.bits_at(psnr) for curve in (reference, tested)]
        saving = None if None in bits else 100 * (1 - bits[1] / bits[0])  # type: ignore[operator]
        yield {
            "kind": "gain",
            **identity,
            "at": profile,
            "psnr": psnr,
            "paper_bits_per_gaussian": bits[0],
            "bits_per_gaussian": bits[1],
            "saving_percent": saving,
        }
    yield {
        "kind": "bd-rate",
        **identity,
        "range": common_range(reference, tested),
        "percent": bd_rate(reference, tested),
    }

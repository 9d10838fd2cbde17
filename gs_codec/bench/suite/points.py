"""Rate-quality points: our profiles and the paper's, and coarser or finer ones."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from gs_codec.bench.measured_scenes import MeasuredScene
from gs_codec.bench.side_by_side import GUIDED, camera_free, guided, is_ours, measure_alternating
from gs_codec.bench.suite.results import curve_of
from gs_codec.config import ADAPTIVE_PROFILES, DEPTH_GROUPS, MAX_DEPTH, PROFILES, Config
from gs_codec.runtime.wording import counted

#: Names of curves: the paper's profiles, ours camera-free, and ours camera-guided.
PAPER = "paper"
FREE = "camera-free"
CAMERA_GUIDED = "camera-guided"


def measure_points(
    measured: MeasuredScene, config: Config, with_cameras: bool, baselines: Sequence[dict[str, Any]]
) -> Iterator[dict[str, Any]]:
    """Result lines of the points of each curve.

    Curves are extended, by at most two points, until they cover each other's profiles and the
    quality of every codec in `baselines`: the paper's by one bit more or less of each depth, ours
    by half or double step sizes. `config` has the common options; `baselines` are lines of
    `measure_alternating`, whose profiles are not measured again. The camera-guided curve is
    included if `with_cameras`.
    """
    ours = [FREE, CAMERA_GUIDED] if with_cameras else [FREE]
    known = {line["codec"]: line for line in baselines if "mean" in line}
    others = [line["mean"]["psnr"] for codec, line in known.items() if not is_ours(codec)]
    found: dict[str, dict[str, dict[str, Any]]] = {curve: {} for curve in (PAPER, *ours)}

    def measure(curve: str, point: str, chosen: Config) -> dict[str, Any]:
        by_cameras = curve == CAMERA_GUIDED
        line = known.get(f"{point}{GUIDED}" if by_cameras else point)
        if line is None:
            codec = guided(chosen, measured.plan) if by_cameras else camera_free(chosen)
            [line] = measure_alternating(measured, [replace(codec, name=point, once=True)], 1)
        found[curve][point] = line | {"kind": "point", "curve": curve, "point": point}
        return found[curve][point]

    def extend(curve: str, wanted: Sequence[float | None]) -> Iterator[dict[str, Any]]:
        psnrs = [psnr for psnr in wanted if psnr is not None]
        for step in (1, 2, -1, -2):
            low, high = curve_of(found[curve].values()).range
            finer, coarser = max(psnrs, default=-math.inf) > high, min(psnrs, default=low) < low
            if finer if step > 0 else coarser:
                yield measure(curve, *_beyond(curve, config, step))

    def profiles(curve: str) -> list[float | None]:
        return [found[curve][name]["mean"]["psnr"] for name in _profiles(curve)]

    for curve in found:
        for name in _profiles(curve):
            yield measure(curve, name, replace(config, profile=name, depths={}))
    for curve in ours:
        yield from extend(curve, [*profiles(PAPER), *others])
    yield from extend(PAPER, [*(psnr for curve in ours for psnr in profiles(curve)), *others])


def _profiles(curve: str) -> Sequence[str]:
    """Profiles that are points of a curve, finest first."""
    return list(PROFILES if curve == PAPER else ADAPTIVE_PROFILES)


def _beyond(curve: str, config: Config, step: int) -> tuple[str, Config]:
    """Name and configuration of a point finer than all profiles, or coarser if `step` < 0."""
    profile = _profiles(curve)[0 if step > 0 else -1]
    if curve == PAPER:
        depths = PROFILES[profile]
        changed = {g: min(max(depths[g] + step, 1), MAX_DEPTH[g]) for g in DEPTH_GROUPS}
        name = f"{profile} {'+' if step > 0 else '-'} {counted(abs(step), 'bit')}"
        return name, replace(config, profile=profile, depths=changed)
    name = f"{profile}, steps {'/' if step > 0 else 'x'} {2 ** abs(step)}"
    return name, replace(config, profile=profile, depths={}, coarseness=2.0**-step)

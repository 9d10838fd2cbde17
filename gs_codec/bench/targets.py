"""Files of wanted sizes and qualities beside the profiles: whether they are met, at what cost."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from gs_codec.bench.curves import Curve
from gs_codec.bench.rendered import measure_quality, rendered_quality
from gs_codec.codec import decode_scene
from gs_codec.config import LATTICE_PROFILES, Config, Target
from gs_codec.errors import InvalidInput
from gs_codec.io.ply import vertex_rows
from gs_codec.planned import encode_goal
from gs_codec.preparation.pipeline import Plan
from gs_codec.rendering.camera import Camera
from gs_codec.scene import Scene

#: Times smaller than the PLY, and dB that views may lose.
RATIOS = (12.5, 25.0, 50.0)
DROPS = (0.03, 0.1, 0.5)

#: What is met with pruning too.
_PRUNED = (Target(ratio=50.0, allow_prune=True), Target(psnr_drop=0.5, allow_prune=True))


def measure_targets(
    scene: Scene,
    name: str,
    cameras: Sequence[Camera],
    truth: Path | None,
    config: Config,
    plan: Plan,
) -> Iterator[dict[str, Any]]:
    """Result lines of the profiles, then of targets, by attributes and by the views of a plan.

    Each line of a target has the bits that profiles take at its quality, as far as their curve
    goes; one that is out of reach has what was said of it. Losses are measured against photographs
    if there are any.
    """
    if truth is not None:
        plan = replace(plan, photographs=truth)
    ratios = [Target(ratio=ratio) for ratio in RATIOS]
    by_views = [*ratios, *(Target(psnr_drop=drop) for drop in DROPS), *_PRUNED]
    for curve, used, wishes in (("by attributes", None, ratios), ("by views", plan, by_views)):
        lines = [
            measure_quality(scene, name, cameras, truth, replace(config, profile=profile), used)
            for profile in LATTICE_PROFILES
        ]
        yield from (line | {"kind": "profile", "curve": curve} for line in lines)
        profiles = Curve.through_lines(lines)
        for wish in wishes:
            kind = curve + (", pruned" if wish.allow_prune else "")
            try:
                line = _measure(
                    scene, name, cameras, truth, replace(config, profile="m"), wish, used
                )
            except InvalidInput as refused:
                yield {
                    "kind": "refused",
                    "scene": name,
                    "curve": kind,
                    "target": _plain(wish),
                    "message": str(refused),
                }
                continue
            psnr = line["mean"]["psnr"]
            yield line | {
                "curve": kind,
                "profiles_bits_per_gaussian": None if psnr is None else profiles.bits_at(psnr),
            }


def _measure(
    scene: Scene,
    name: str,
    cameras: Sequence[Camera],
    truth: Path | None,
    config: Config,
    target: Target,
    plan: Plan | None,
) -> dict[str, Any]:
    ply_bytes = vertex_rows(scene).nbytes
    start = time.perf_counter()
    data, report = encode_goal(scene, scene, ply_bytes, config, target, plan)
    seconds = time.perf_counter() - start
    rate = report.rate
    assert rate is not None
    return {
        "kind": "target",
        "scene": name,
        "target": _plain(target),
        "limit_bytes": target.limit(scene.count, ply_bytes),
        "file_bytes": len(data),
        "psnr_drop": rate.psnr_drop,
        "predicted_bytes": rate.predicted_bytes,
        "predicted_drop": rate.predicted_drop,
        "coarseness": rate.coarseness,
        "pruned": rate.pruned,
        "encodings": rate.encodings,
        "encode_seconds": seconds,
        "gaussians": scene.count,
        "bits_per_gaussian": 8 * len(data) / max(scene.count, 1),
        "ratio": ply_bytes / len(data),
        **rendered_quality(scene, decode_scene(data), cameras, truth),
    }


def _plain(target: Target) -> dict[str, Any]:
    return {k: v for k, v in vars(target).items() if v is not None}

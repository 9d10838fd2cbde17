"""Pruning rules side by side, and what preparation followed by coding gains and costs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from gs_codec.codec import decode_scene, encode_scene
from gs_codec.config import LATTICE_PROFILES, Config
from gs_codec.io.ply import vertex_rows
from gs_codec.planned import guide_of
from gs_codec.preparation.pipeline import Plan, choose_views, prepare_scene
from gs_codec.preparation.report import PrepareReport
from gs_codec.preparation.steps import Steps
from gs_codec.preparation.targets import draw_targets
from gs_codec.rendering.cameras import find_cameras
from gs_codec.scene import Scene

#: Percentages pruned by both rules (the paper removes 65 to 66), and along the frontier.
PRUNED = (30.0, 50.0, 66.0)
FRONTIER = (0.0, 30.0, 50.0, 65.0)

#: Strengths of SH compaction along the frontier.
STRENGTHS = (0.0, 1e-5, 6e-5)


def measure_pruning(scene: Scene, name: str, plan: Plan) -> Iterator[dict[str, Any]]:
    """Quality after pruning by leave-one-out error and by LightGaussian's importance.

    By leave-one-out error in as many ``auto`` views of the same size too.
    """
    views = choose_views(scene, plan)
    drawn = views.renders
    cameras = find_cameras("auto", scene, width=drawn.cameras[0].width, auto=len(drawn.cameras))
    auto = views._replace(renders=draw_targets(scene, cameras, plan.background), photographs=None)
    for percent in PRUNED:
        rules = {
            "leave-one-out": (Steps(prune_loo=percent), views),
            "leave-one-out, auto views": (Steps(prune_loo=percent), auto),
            "importance": (Steps(prune_importance=percent), views),
        }
        for rule, (steps, seen) in rules.items():
            pruned, report = prepare_scene(scene, replace(plan, steps=steps), views=seen)
            yield {
                "kind": "pruning",
                "scene": name,
                "rule": rule,
                "percent": percent,
                "gaussians": pruned.count,
                "seconds": report.steps[-1].seconds,
                **_quality(report),
            }


def measure_frontier(
    scene: Scene, name: str, plan: Plan, config: Config
) -> Iterator[dict[str, Any]]:
    """Size and quality of the coded scene, by leave-one-out fraction and compaction strength."""
    ply_bytes = vertex_rows(scene).nbytes
    views = choose_views(scene, plan)
    before = views.held_out.quality(scene)
    # Profiles that go by views compact and refit by themselves.
    by_views = config.profile in LATTICE_PROFILES
    for percent in FRONTIER:
        pruned, _ = prepare_scene(scene, replace(plan, steps=Steps(prune_loo=percent)), views=views)
        for strength in STRENGTHS[:1] if by_views else STRENGTHS:
            refit = 6 if not by_views and (percent or strength) else 0
            steps = Steps(compact_sh=strength, refit_colour=refit)
            prepared, _ = prepare_scene(pruned, replace(plan, steps=steps), views=views)
            guide = guide_of(prepared, plan, config, targets=views.renders)
            data, _ = encode_scene(prepared, config, guide=guide)
            after = views.held_out.quality(decode_scene(data))
            yield {
                "kind": "frontier",
                "scene": name,
                "profile": config.profile,
                "percent": percent,
                "strength": strength,
                "gaussians": prepared.count,
                "file_bytes": len(data),
                "ratio": ply_bytes / len(data),
                "quality": after.as_dict(),
                "delta": after.over(before).as_dict(),
            }


def _quality(report: PrepareReport) -> dict[str, Any]:
    before, after = report.steps[0].quality, report.steps[-1].quality
    return {"quality": after.as_dict(), "delta": after.over(before).as_dict()}

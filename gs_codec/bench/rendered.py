"""Quality of rendered views after coding."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from gs_codec.bench.measure import sizes
from gs_codec.codecs import decode_scene
from gs_codec.config import Config
from gs_codec.formats.ply import vertex_rows
from gs_codec.guidance.planned import encode_planned
from gs_codec.metrics.views import compare_views
from gs_codec.preparation.steps import Plan
from gs_codec.rendering.camera import Camera
from gs_codec.scene import Scene


def measure_quality(
    scene: Scene,
    name: str,
    cameras: Sequence[Camera],
    truth: Path | None,
    config: Config,
    plan: Plan | None = None,
) -> dict[str, Any]:
    """PSNR and SSIM of the decoded scene's views against the scene's own, and the paper's deltas.

    `truth` is the folder of the ground-truth images, without which there are no deltas. With a
    `plan`, encoding is guided by its views.
    """
    start = time.perf_counter()
    data, _ = encode_planned(scene, config, plan)
    seconds = time.perf_counter() - start
    return {
        "kind": "rendered",
        "scene": name,
        "profile": config.profile,
        "camera_guided": plan is not None,
        "encode_seconds": seconds,
        **sizes(scene, data, vertex_rows(scene).nbytes),
        **rendered_quality(scene, decode_scene(data), cameras, truth),
    }


def rendered_quality(
    scene: Scene, decoded: Scene, cameras: Sequence[Camera], truth: Path | None
) -> dict[str, Any]:
    """Fields of a result line on the decoded scene's views; PSNR of equal ones is None."""
    comparison = compare_views(scene, decoded, cameras, truth, device="cpu")
    mean = comparison.mean
    result: dict[str, Any] = {
        "views": len(comparison.views),
        "mean": mean.between.as_dict(),
        "worst_psnr": comparison.worst.between.as_dict()["psnr"],
    }
    if mean.first and mean.delta:
        result |= {"truth": asdict(mean.first), "delta": asdict(mean.delta)}
    return result

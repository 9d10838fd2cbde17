"""The paper's ablation: size and quality after each step of preparation and of coding."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from gs_codec.ablation import coding_steps
from gs_codec.codec import encode_scene
from gs_codec.config import Config
from gs_codec.preparation.pipeline import Plan, prepare_scene
from gs_codec.preparation.steps import Steps
from gs_codec.scene import Scene

#: Percent pruned as the paper does: by importance, and along each axis, and colours refitted in
#: place of its optimisation, which trains.
STEPS = Steps(prune_importance=66.0, prune_geometry=0.2, refit_colour=6)


def measure_ablation(
    scene: Scene, name: str, config: Config, plan: Plan, truth: Path | None
) -> Iterator[dict[str, Any]]:
    """A result line for each step; quality is against photographs, or the scene's own views."""
    chosen = replace(plan, steps=STEPS, photographs=truth)
    prepared, report = prepare_scene(scene, chosen)
    data, encoded = encode_scene(prepared, config)
    held_out = report.views.held_out
    steps = (*report.steps, *coding_steps(prepared, config, data, encoded, held_out))
    for step in steps:
        yield {
            "kind": "ablation",
            "scene": name,
            "profile": config.profile,
            "step": step.name,
            "gaussians": step.count,
            "file_bytes": step.size_bytes,
            "photographs": held_out.photographs,
            "quality": step.quality.as_dict(),
            "delta": step.quality.over(steps[0].quality).as_dict(),
            "seconds": step.seconds,
        }

"""Profile `m` by views after pruning: what is gained where fewer Gaussians will do."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from gs_codec.bench.beside import Turns, few_of, our_codec, result_line
from gs_codec.bench.rendered import rendered_quality
from gs_codec.codec import encode_scene
from gs_codec.config import Config
from gs_codec.io.ply import read_ply, write_ply
from gs_codec.planned import guide_of
from gs_codec.preparation.pipeline import Plan, prepare_scene
from gs_codec.preparation.steps import Steps
from gs_codec.rendering.camera import Camera
from gs_codec.scene import Scene

#: Percent pruned by leave-one-out error, as the README has it.
PERCENTS = (39.0, 58.8)

#: Most views to prune and to encode by.
VIEWS = 128


def measure_pruned(
    scene: Scene,
    name: str,
    config: Config,
    plan: Plan,
    cameras: Sequence[Camera],
    truth: Path | None,
) -> Iterator[dict[str, Any]]:
    """A result line for each share pruned, with the fields of those of `measure_beside`.

    Each is encoded once, from the PLY, pruning included; ``kept`` is what is left of ``gaussians``.
    """
    codec = our_codec(config)
    with tempfile.TemporaryDirectory() as folder:
        ply = Path(folder) / "scene.ply"
        write_ply(ply, scene)
        for percent in PERCENTS:
            turns = Turns()
            chosen = replace(plan, steps=Steps(prune_loo=percent), views=VIEWS)
            turns.data, _ = _encode(few_of(scene), config, chosen)  # compiles
            codec.decode(turns.data)
            start = time.perf_counter()
            turns.data, kept = _encode(read_ply(ply, config.extra), config, chosen)
            turns.encode.append(time.perf_counter() - start)
            start = time.perf_counter()
            decoded = codec.decode(turns.data)
            turns.decode.append(time.perf_counter() - start)
            named = replace(codec, name=f"{config.profile}, {percent:g} % pruned")
            yield {
                **result_line(scene, name, named, turns, ply.stat().st_size),
                "kind": "pruned",
                "kept": kept,
                **rendered_quality(scene, decoded, cameras, truth),
            }


def _encode(scene: Scene, config: Config, plan: Plan) -> tuple[bytes, int]:
    """The file of what is left of a scene, and how many Gaussians that are."""
    pruned, report = prepare_scene(scene, plan)
    guide = guide_of(pruned, plan, config, targets=report.views.renders)
    return encode_scene(pruned, config, guide=guide)[0], pruned.count

"""The suite: every measurement of every scene, in one run."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from gs_codec import paper
from gs_codec.bench.measure import machine
from gs_codec.bench.suite.options import GROUPS, Options
from gs_codec.bench.suite.scenes import describe_scenes, open_scene
from gs_codec.bench.suite.stages import STAGES, STAGES_OF_LARGEST


def run_suite(
    options: Options, command: str, tell: Callable[[str], None]
) -> Iterator[dict[str, Any]]:
    """Result lines as they are measured; numbers that are none or infinite are None.

    Parameters
    ----------
    options : Options
    command : str
        How to run the same again; it stands among the lines.
    tell : callable
        Is told what is measured next.

    Raises
    ------
    InvalidInput
        If a scene, cameras or photographs cannot be used; before anything is measured.
    """
    scenes = describe_scenes(options.scenes, options.width)
    return (_finite(line) for line in _measure(options, command, tell, scenes))


def _measure(
    options: Options, command: str, tell: Callable[[str], None], scenes: dict[Path, dict[str, Any]]
) -> Iterator[dict[str, Any]]:
    yield machine() | {
        "seed": options.seed,
        "repeats": options.repeats,
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "command": command,
    }
    yield from paper_lines()
    for group in GROUPS:
        if group in options.skip:
            yield {"kind": "skipped", "group": group}
    yield from scenes.values()
    # The smallest first: what does not end there need not be tried on the others.
    *others, largest = sorted(scenes, key=lambda path: scenes[path]["gaussians"])
    found: list[dict[str, Any]] = []
    for path in (*others, largest):
        measured = open_scene(path, options.width)
        for stage in STAGES + (STAGES_OF_LARGEST if path == largest else ()):
            if not options.wants(*stage.groups) or (stage.photographs and measured.truth is None):
                continue
            tell(f"{measured.name}: {stage.title}")
            for line in stage.measure(measured, options, found):
                found.append(line)
                yield line


def paper_lines() -> Iterator[dict[str, Any]]:
    """What the paper publishes: run times by device, entropies by group, the ablation by step."""
    for device, seconds in paper.SECONDS.items():
        yield {"kind": "paper", "gaussians": paper.MEAN_GAUSSIANS, "device": device, **seconds}
    for group, percent in paper.OVERHEAD_PERCENT.items():
        entropy = paper.ENTROPY_BITS[group]
        yield {
            "kind": "paper", "group": group, "overhead_percent": percent, "entropy_bits": entropy,
        }  # fmt: skip
    for step, (psnr, megabytes) in paper.ABLATION.items():
        yield {"kind": "paper", "step": step, "psnr": psnr, "megabytes": megabytes}


def _finite(value: Any) -> Any:
    """A result as JSON can hold it, which knows neither infinity nor NaN."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

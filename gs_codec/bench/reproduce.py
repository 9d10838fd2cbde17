"""The paper's experiment on given scenes: its pipeline step by step, then its three profiles."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from gs_codec.analysis.entropy import entropy_by_group
from gs_codec.bench.host import machine
from gs_codec.bench.measured_scenes import MeasuredScene, cameras_of, check_names, open_with_cameras
from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.codecs.entropygs import paper
from gs_codec.config import DEPTH_GROUPS, PROFILES, Config
from gs_codec.metrics.image_quality import LPIPS_VARIABLE, Quality
from gs_codec.pages.tables import Table, escaped, number
from gs_codec.plan import Plan
from gs_codec.preparation.pipeline import prepare_scene
from gs_codec.preparation.prepare_report import PrepareReport, StepReport, coding_steps
from gs_codec.presets import PRESETS
from gs_codec.report import Progress
from gs_codec.runtime.wording import counted
from gs_codec.scene import Scene

Line = dict[str, Any]

_PRESET = PRESETS["entropygs"]

#: Quality metrics by title: key in result lines, and number of digits.
_METRICS = {"PSNR dB": ("psnr", 2), "SSIM": ("ssim", 4), "LPIPS": ("lpips", 4)}

#: Number of timed runs of the codec; the median counts.
_REPEATS = 3

_INTRODUCTION = (
    "The preset `entropygs` on each scene, next to the figures published for "
    "EntropyGS (arXiv 2508.10227; means over Mip-NeRF 360, on other machines). PSNR is that of "
    "held-out views, against photographs if a scene has any, otherwise against its own renders. "
    f"LPIPS is measured if {LPIPS_VARIABLE} names weights. Ratios are relative to the PLY, in the "
    "ablation to its floats."
)


def open_scenes(paths: Sequence[Path]) -> list[MeasuredScene]:
    """Scenes with the cameras and photographs next to them.

    Raises InvalidInput if a scene, cameras or photographs cannot be used, or two scenes have one
    name.
    """
    check_names(paths)
    return [open_with_cameras(path, None) for path in paths]


def reproduce(
    scenes: Sequence[MeasuredScene],
    iterations: int,
    folder: Path,
    command: str,
    progress: Progress,
) -> Iterator[Line]:
    """Result lines: the machine, then for each scene its steps, models and profiles.

    Refinement saves its state in `folder`, and resumes from there.
    """
    yield machine() | {"command": command, "iterations": iterations}
    steps = replace(_PRESET.steps, refine=iterations)
    for measured in scenes:
        lpips = os.environ.get(LPIPS_VARIABLE) or None
        plan = Plan(
            steps,
            cameras_of(measured.path),
            measured.truth,
            checkpoint=folder / f"{measured.name}.checkpoint",
        )
        advance = partial(_advance, progress, measured.name)
        prepared, report = prepare_scene(measured.scene, plan, advance)
        for step in report.steps:
            yield _step_line(measured, step, None, report)
        original = report.views.held_out.quality(measured.scene, lpips=lpips)
        for profile in PROFILES:
            yield from _profile_lines(measured, prepared, profile, report, original, lpips)


def _advance(progress: Progress, name: str, stage: str, done: int, total: int) -> None:
    progress(f"{name}: {stage}", done, total)


def _profile_lines(
    measured: MeasuredScene,
    scene: Scene,
    profile: str,
    prepared: PrepareReport,
    original: Quality,
    lpips: str | None,
) -> Iterator[Line]:
    """Results of a profile on a prepared scene, relative to the original's quality."""
    config = replace(_PRESET.config, profile=profile)
    seconds: dict[str, list[float]] = {"encode": [], "decode": []}
    for _ in range(_REPEATS):
        start = time.perf_counter()
        data, report = encode_scene(scene, config)
        middle = time.perf_counter()
        decode_scene(data)
        seconds["encode"].append(middle - start)
        seconds["decode"].append(time.perf_counter() - middle)
    steps = coding_steps(scene, config, data, report, prepared.views.held_out, lpips)
    for step in steps:
        yield _step_line(measured, step, profile, prepared)
    quality = steps[-1].quality
    yield {
        "kind": "profile",
        "scene": measured.name,
        "profile": profile,
        "input_bytes": measured.path.stat().st_size,
        "output_bytes": report.file_bytes,
        "geometry": "gpcc" if "gpcc" in report.section_bytes else "octree",
        "seconds": {name: median(runs) for name, runs in seconds.items()},
        "models": entropy_by_group(report),
        "quality": quality.as_dict(),
        "delta": quality.over(original).as_dict(),
    }


def _step_line(
    measured: MeasuredScene, step: StepReport, profile: str | None, report: PrepareReport
) -> Line:
    """A row of the ablation; with `profile`, a row of coding."""
    return {
        "kind": "step",
        "scene": measured.name,
        "profile": profile,
        "step": step.name,
        "gaussians": step.count,
        "bytes": step.size_bytes,
        # For refinement, including the time before it was resumed from a checkpoint.
        "seconds": step.details.get("seconds", step.seconds),
        "photographs": report.views.held_out.photographs,
        **step.quality.as_dict(),
    }


def tables_of(lines: Sequence[Line]) -> str:
    """A page of the paper's tables in Markdown, next to the published figures."""
    host = next(line for line in lines if line["kind"] == "machine")
    scenes = list(dict.fromkeys(line["scene"] for line in lines if "scene" in line))
    parts = ["# EntropyGS reproduced", _INTRODUCTION]
    for title, table in (
        ("Overhead of the models over Shannon entropy (Table 1; `paper-m`)", _overheads),
        ("Bits of each group (Table 2)", _depths),
        ("Size and quality", _results),
        ("Seconds", _seconds),
        ("Ablation", _ablation),
    ):
        parts += [f"## {title}", table(lines, scenes).markdown()]
    facts = (host["command"], counted(host["iterations"], "iteration"), host["processor"])
    return "\n\n".join([*parts, ", ".join(map(escaped, facts))]) + "\n"


def _of(lines: Sequence[Line], kind: str, scene: str) -> list[Line]:
    return [line for line in lines if line["kind"] == kind and line["scene"] == scene]


def _overheads(lines: Sequence[Line], scenes: Sequence[str]) -> Table:
    rows = []
    for scene in scenes:
        known = next(x for x in _of(lines, "profile", scene) if x["profile"] == "paper-m")["models"]
        for name, key, digits in (
            ("overhead %", "parametric_overhead_percent", 2), ("bits", "bits_per_symbol", 3),
        ):  # fmt: skip
            cells = [
                f"{known[g][key]:.{digits}f}" if g in known else "" for g in paper.ENTROPY_BITS
            ]
            rows.append([f"{escaped(scene)}, {name}", *cells])
    rows.append(["*the paper, overhead %*", *(f"{x:.2f}" for x in paper.OVERHEAD_PERCENT.values())])
    rows.append(["*the paper, bits*", *(f"{x:.3f}" for x in paper.ENTROPY_BITS.values())])
    return Table(["", *paper.ENTROPY_BITS], rows)


def _depths(_: Sequence[Line], __: Sequence[str]) -> Table:
    rows = [
        [f"`{profile}`", *(str(Config(profile).resolved_depths()[group]) for group in DEPTH_GROUPS)]
        for profile in PROFILES
    ]
    return Table(["", *DEPTH_GROUPS], rows)


def _results(lines: Sequence[Line], scenes: Sequence[str]) -> Table:
    rows = []
    for scene in scenes:
        for line in _of(lines, "profile", scene):
            rows.append([
                escaped(scene), f"`{line['profile']}`", f"{line['output_bytes'] / 1e6:.2f}",
                f"{line['input_bytes'] / line['output_bytes']:.1f}x", line["geometry"],
                *(
                    number(line[kind][metric], f"{sign}.{digits}f")
                    for metric, digits in _METRICS.values()
                    for kind, sign in (("quality", ""), ("delta", "+"))
                ),
            ])  # fmt: skip
    (psnr, size), (first, whole) = paper.ABLATION["geometry coding"], paper.ABLATION["original"]
    rows.append([
        "*the paper, its mean scene*", "M", f"{size}", f"{whole / size:.1f}x", "gpcc",
        f"{psnr:.2f}", f"{psnr - first:+.2f}", "", "", "", "",
    ])  # fmt: skip
    known = (label for name in _METRICS for label in (name, f"delta-{name.split()[0]}"))
    return Table(["scene", "profile", "MB", "ratio", "geometry", *known], rows, left=(0, 1))


def _delta(psnr: float, before: float | None) -> str:
    """A difference in dB; empty if the PSNR before is unknown, as for equal images."""
    return "" if before is None else f"{psnr - before:+.2f}"


def _seconds(lines: Sequence[Line], scenes: Sequence[str]) -> Table:
    rows = []
    for scene in scenes:
        for line in _of(lines, "profile", scene):
            cells = [f"{line['seconds'][way]:.2f}" for way in ("encode", "decode")]
            rows.append([escaped(scene), f"`{line['profile']}`", *cells])
    for name, known in paper.SECONDS.items():
        cells = [f"{known[way]}" for way in ("encode", "decode")]
        rows.append([f"*the paper, {paper.MEAN_GAUSSIANS / 1e6:.2f} M, {name}*", "", *cells])
    return Table(["scene", "profile", "encode", "decode"], rows, left=(0, 1))


def _ablation(lines: Sequence[Line], scenes: Sequence[str]) -> Table:
    rows = []
    for scene in scenes:
        steps = [x for x in _of(lines, "step", scene) if x["profile"] in (None, "paper-m")]
        first = steps[0]
        for step in steps:
            psnr, known = step["psnr"], paper.ABLATION.get(step["step"])
            rows.append([
                escaped(scene) if step is first else "", step["step"], f"{step['gaussians']:,}",
                f"{step['bytes'] / 1e6:.2f}", f"{first['bytes'] / step['bytes']:.1f}x",
                number(psnr, ".2f"),
                "" if psnr is None else _delta(psnr, first["psnr"]), f"{step['seconds']:.0f}",
                *_published(known),
            ])  # fmt: skip
    columns = ["scene", "step", "Gaussians", "MB", "ratio", "PSNR dB", "delta-PSNR", "s"]
    return Table([*columns, "*paper: ratio*", "*delta-PSNR*"], rows, left=(0, 1))


def _published(known: tuple[float, float] | None) -> list[str]:
    """The paper's compression ratio and loss after a step."""
    if known is None:
        return ["", ""]
    (first, whole), (psnr, size) = paper.ABLATION["original"], known
    return [f"{whole / size:.1f}x", f"{psnr - first:+.2f}"]

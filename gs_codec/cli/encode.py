"""``gs-codec encode``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from gs_codec import paper
from gs_codec.cli import coding, goal, steps
from gs_codec.cli.given import refuse_given
from gs_codec.cli.output import (
    SCENES_PIPED,
    print_json,
    print_status,
    print_table,
    print_text,
    progress_bar,
    size_text,
)
from gs_codec.cli.resources import MaxBytes, MaxMemory, Overwrite, Threads, parse_memory
from gs_codec.cli.streams import piped
from gs_codec.config import LATTICE_PROFILES
from gs_codec.report import EncodeReport


def command(
    ctx: typer.Context,
    source: Annotated[Path, typer.Argument(metavar="IN", help=SCENES_PIPED)],
    target: Annotated[
        Path, typer.Argument(metavar="OUT", help="File to write, an .egs; - is stdout.")
    ],
    profile: coding.Profile = "m",
    depth: coding.Depth = None,
    nonfinite: coding.Nonfinite = "error",
    extra: coding.Extra = "error",
    keep_order: coding.KeepOrder = False,
    geometry: coding.Geometry = "octree",
    tmc3: coding.Coder = None,
    verify: coding.Verify = True,
    target_size: goal.TargetSize = None,
    target_ratio: goal.TargetRatio = None,
    target_bpg: goal.TargetBits = None,
    max_psnr_drop: goal.MaxPsnrDrop = None,
    allow_prune: goal.AllowPrune = False,
    threads: Threads = None,
    max_memory: MaxMemory = None,
    max_bytes: MaxBytes = None,
    overwrite: Overwrite = False,
    json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Print bytes and entropy of each stream, too.")
    ] = False,
    prune_geometry: steps.PruneGeometry = 0.0,
    prune_importance: steps.PruneImportance = 0.0,
    prune_loo: steps.PruneLoo = 0.0,
    max_drop: steps.MaxDrop = None,
    optimise: steps.Optimise = 0,
    compact_sh: steps.CompactSh = 0.0,
    refit_colour: steps.RefitColour = 0,
    rectify: steps.Rectify = False,
    cameras: steps.EncodeCameras = None,
    against_gt: steps.AgainstGt = None,
    views: steps.Views = 64,
    width: steps.ViewWidth = None,
    background: steps.Backdrop = "black",
    report: steps.Report = None,
    checkpoint: steps.Checkpoint = None,
) -> None:
    """Encode a scene to an .egs file, prepared or as it is."""
    if json:
        refuse_given(ctx, ["verbose"], "has no effect: --json has it anyway")
    plan, config = steps.plan_of(ctx, locals()), coding.config_of(ctx, locals())
    wanted = goal.goal_of(target_size, target_ratio, target_bpg, max_psnr_drop, allow_prune)
    from gs_codec.files import comes_compressed, encode_file, source_bytes

    with piped(source, target, ".egs") as (file, out):
        with progress_bar() as progress:
            done = encode_file(
                file, out, config, progress, plan, report, wanted, parse_memory(max_memory),
                overwrite, max_bytes,
            )  # fmt: skip
        _say_what_changed(done, profile in LATTICE_PROFILES)
        size, compressed = source_bytes(file), comes_compressed(file)
        if json:
            print_json(
                {"input": str(source), "output": str(target), "profile": profile}
                | asdict(done)
                | {"input_bytes": size, "file_bytes": done.file_bytes}
            )
        else:
            _print_report(size, compressed, target, done)
            if verbose:
                _print_streams(done, profile in LATTICE_PROFILES)


def _say_what_changed(report: EncodeReport, lattices: bool) -> None:
    if report.dropped:
        print_status(f"dropped {report.dropped:,} Gaussians with NaN or infinity")
    if report.zero_quaternions:
        print_status(f"replaced {report.zero_quaternions:,} zero quaternions by the identity")
    if lattices and report.rectified:
        print_status(f"values beyond 400, moved to 400: {report.rectified:,}")


def _print_report(size: int, compressed: bool, target: Path, report: EncodeReport) -> None:
    count = max(report.count, 1)
    beside = " than the floats" if compressed else ""
    ratio = (report.raw_bytes if compressed else size) / report.file_bytes
    print_text(
        f"{target}: {report.count:,} Gaussians, {size_text(size)} -> "
        f"{size_text(report.file_bytes)}, {ratio:.2f} times smaller{beside}, "
        f"{8 * report.file_bytes / count:.1f} bits per Gaussian, "
        f"{sum(report.seconds.values()):.2f} s"
    )
    if report.rate is not None:
        goal.print_rate(report.rate)


def _print_streams(report: EncodeReport, lattices: bool) -> None:
    if lattices:
        _print_lattices(report)
        return
    count = max(report.count, 1)
    print_table(
        ["stream", "bytes", "bits/Gaussian", "entropy", "parametric", "paper", "models"],
        [_stream_row(name, size, report) for name, size in report.section_bytes.items()],
    )
    if report.costs:
        print_text(
            f"entropy-coded streams with states and models: {report.entropy_overhead:.3%} over "
            "Shannon entropy (parametric: models alone, without sent tables)"
        )
    if report.rectified:
        values = sum(cost.stream.startswith("sh") for cost in report.costs) * count
        print_text(
            f"SH-AC rectified to their Laplace range: {report.rectified:,} values"
            f" ({report.rectified / values:.3%})"
        )


def _print_lattices(report: EncodeReport) -> None:
    """Sizes beside entropies; nothing published compares with these."""
    count, rows = max(report.count, 1), []
    for name, size in report.section_bytes.items():
        entropies = [cost.shannon_bits for cost in report.costs if cost.stream == name]
        entropy = f"{sum(entropies) / count:.3f}" if entropies else ""
        rows.append([name, f"{size:,}", f"{8 * size / count:.3f}", entropy])
    print_table(["stream", "bytes", "bits/Gaussian", "entropy"], rows)
    print_text(
        f"entropy-coded streams with states and tables: {report.entropy_overhead:.3%} over "
        "Shannon entropy"
    )


def _stream_row(name: str, size: int, report: EncodeReport) -> list[str]:
    """Bytes and bits; entropy, and what the parametric models cost over it here and there."""
    count = max(report.count, 1)
    costs = [cost for cost in report.costs if cost.stream == name]
    row = [name, f"{size:,}", f"{8 * size / count:.3f}"]
    if not costs:
        return [*row, "", "", "", ""]
    entropy = sum(cost.shannon_bits for cost in costs)
    over = sum(cost.parametric_bits for cost in costs) / entropy - 1 if entropy else 0.0
    published = paper.OVERHEAD_PERCENT.get("sh-ac" if name.startswith("sh") else name)
    stated = "" if published is None else f"+{published:.2f}%"
    kinds = [cost.model for cost in costs]
    models = ", ".join(f"{kinds.count(kind)} {kind}" for kind in sorted(set(kinds)))
    return [*row, f"{entropy / count:.3f}", f"+{over:.2%}", stated, models]

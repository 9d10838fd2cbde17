"""``gs-codec batch``."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

import typer

from gs_codec.cli import coding, goal, steps
from gs_codec.cli.batch_progress import watching
from gs_codec.cli.output import print_json, print_text, size_text
from gs_codec.cli.resources import MaxBytes, Overwrite, Threads
from gs_codec.errors import InvalidInput


def command(
    ctx: typer.Context,
    source: Annotated[
        str,
        typer.Argument(
            metavar="SRC", help="A folder, or a glob in quotes ('in/**/*.ply'); or a URL."
        ),
    ],
    target: Annotated[
        str, typer.Argument(metavar="DST", help="Folder for the same tree of .egs files; or a URL.")
    ],
    profile: coding.Profile = "m",
    jobs: Annotated[
        int | None,
        typer.Option("--jobs", "-j", help="Scenes at once.", show_default="all processors"),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Leave out what the report has and is unchanged.")
    ] = False,
    report: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="Lines of JSON, one for each scene.",
            show_default="DST/report.jsonl; here, if DST is a URL",
        ),
    ] = None,
    on_error: Annotated[
        str, typer.Option(help="After a scene that failed: continue or stop.")
    ] = "continue",
    dask: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Use a Dask scheduler's workers, or local ones."),
    ] = None,
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
    max_bytes: MaxBytes = None,
    overwrite: Overwrite = False,
    json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
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
) -> None:
    """Encode a folder of scenes, each as `encode` would; exit status 1 if any failed."""
    if resume and overwrite:
        raise InvalidInput("--overwrite: --resume replaces what has changed, expected one of them")
    config = coding.config_of(ctx, locals())
    # A plan has these of one scene; the report here is another.
    plan = steps.plan_of(ctx, locals() | {"report": None, "checkpoint": None})
    wanted = goal.goal_of(target_size, target_ratio, target_bpg, max_psnr_drop, allow_prune)
    from gs_codec.batch.redaction import redact_process
    from gs_codec.batch.run import Batch, run_batch
    from gs_codec.batch.scenes import Options

    options = Options(config, plan, wanted, max_bytes)
    batch = Batch(source, target, options, jobs, resume, report, on_error, dask, overwrite)  # type: ignore[arg-type]
    redact_process()
    with watching() as watcher:
        summary = run_batch(batch, watcher)
    if json:
        print_json(asdict(summary))
    else:
        print_text(_summed_up(summary))
    if summary.failed:
        raise typer.Exit(1)


def _summed_up(summary: Any) -> str:
    text = f"{summary.done:,} scene{'s' * (summary.done != 1)} encoded"
    if summary.skipped:
        text += f", {summary.skipped:,} complete before"
    if summary.failed:
        text += f", {summary.failed:,} failed"
    if summary.not_started:
        text += f", {summary.not_started:,} not started"
    if summary.output_bytes:
        text += (
            f"; {size_text(summary.input_bytes)} -> {size_text(summary.output_bytes)}, "
            f"{summary.input_bytes / summary.output_bytes:.2f} times smaller"
        )
    return f"{text}; {summary.seconds:.2f} s; {summary.report}"

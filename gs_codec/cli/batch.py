"""``gs-codec batch``."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

import typer

from gs_codec.cli.asked import Asked, config_of, plan_of, takes, target_of
from gs_codec.cli.batch_progress import watching
from gs_codec.cli.encode import CODING, EXPERT
from gs_codec.cli.output import print_json, print_text, smaller
from gs_codec.errors import InvalidInput


@takes(*CODING, "json", expert=EXPERT)
def command(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SRC", help="A folder, or a glob in quotes ('in/**/*.ply'); or a URL."
        ),
    ],
    target: Annotated[
        str, typer.Argument(metavar="DST", help="Folder for the same tree of .egs files; or a URL.")
    ],
    asked: Asked,
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
) -> None:
    """Encode a folder of scenes, each as `encode` would; exit status 1 if any failed."""
    if resume and asked["overwrite"]:
        raise InvalidInput("--overwrite: --resume replaces what has changed, expected one of them")
    plan, config, rate = plan_of(asked), config_of(asked), target_of(asked)
    if plan is not None or rate is not None:
        asked.refuse(["max_memory"], "not with views, preparation, or a target to meet")
    from gs_codec.batch.redaction import redact_process
    from gs_codec.batch.run import Batch, run_batch
    from gs_codec.batch.scenes import Options

    options = Options(config, plan, rate, asked["max_bytes"], asked["max_memory"])
    batch = Batch(
        source, target, options, jobs, resume, report, on_error, dask, asked["overwrite"],  # type: ignore[arg-type]
    )  # fmt: skip
    redact_process()
    with watching() as watcher:
        summary = run_batch(batch, watcher)
    if asked["json"]:
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
        text += f"; {smaller(summary.input_bytes, summary.output_bytes, summary.ratio)}"
    return f"{text}; {summary.seconds:.2f} s; {summary.report}"

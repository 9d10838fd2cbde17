"""``gs-codec batch``."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)

from gs_codec.cli.documents import print_document
from gs_codec.cli.encode import ACTIONS, CODING, EXPERT
from gs_codec.cli.options import completion
from gs_codec.cli.output import (
    is_quiet,
    loss_text,
    print_problem,
    print_status,
    print_text,
    progress_lines,
    smaller,
)
from gs_codec.cli.typed import Typed, takes
from gs_codec.cli.typed_request import action_plan, config_of, request_of
from gs_codec.encoding.combinations import refuse_coding
from gs_codec.errors import InvalidInput, printable
from gs_codec.files.suffixes import PLAIN
from gs_codec.report import bits_per_gaussian
from gs_codec.runtime.wording import counted


@takes(
    *CODING,
    "dask",
    "json",
    expert=EXPERT,
    without=["checkpoint", "target_bitrate"],
    actions=ACTIONS,
    actions_hidden=True,
)
def command(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SRC", help="Folder, quoted glob ('in/**/*.ply') or URL of the scenes."
        ),
    ],
    target: Annotated[
        str, typer.Argument(metavar="DST", help="Folder or URL for the outputs, in the same tree.")
    ],
    typed: Typed,
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs",
            "-j",
            metavar="N",
            help="Number of scenes at once.",
            show_default="all processors",
        ),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Skip unchanged scenes that the report lists as done.")
    ] = False,
    report: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="File for the report, one line of JSON per scene.",
            show_default="DST/report.jsonl; ./report.jsonl if DST is a URL",
        ),
    ] = None,
    on_error: Annotated[
        str,
        typer.Option(
            metavar="continue|stop",
            help="Continue or stop after a scene fails.",
            autocompletion=completion(("continue", "stop")),
        ),
    ] = "continue",
) -> None:
    """Encode or convert every scene in a folder, like `encode` and `convert`.

    The exit status is 1 if a scene failed.
    """
    if resume and typed["overwrite"]:
        raise InvalidInput("--overwrite and --resume cannot be combined")
    from gs_codec.batch.run import Batch, run_batch
    from gs_codec.batch.scene_tasks import Options
    from gs_codec.runtime.redaction import redact_process, without_secrets

    plain = typed["format"] if f".{typed['format']}" in PLAIN else None
    if plain is None:
        options = Options(**vars(request_of(typed)))
    else:
        refuse_coding(typed, plain, None)
        options = Options(
            config_of(typed), action_plan(typed), actions=tuple(typed.actions),
            max_memory=typed["max_memory"], max_bytes=typed["max_bytes"], plain=plain,
        )  # fmt: skip
    batch = Batch(
        source, target, options, jobs, resume, report, on_error, typed["dask"], typed["overwrite"],  # type: ignore[arg-type]
    )  # fmt: skip
    redact_process()
    with _watching("encode" if plain is None else "convert") as watcher:
        summary = run_batch(batch, watcher)
    if typed["json"]:
        print_document(
            input=without_secrets(source), output=without_secrets(target), format=options.format,
            profile=options.config.profile if plain is None else None,
            bits_per_gaussian=bits_per_gaussian(summary.output_bytes, summary.gaussians),
            **asdict(summary),
        )  # fmt: skip
    else:
        print_text(_summed_up(summary, "encoded" if plain is None else "converted"))
    if summary.failed:
        raise typer.Exit(1)


def _summed_up(summary: Any, done: str) -> str:
    text = f"{counted(summary.done, 'scene')} {done}"
    if summary.skipped:
        text += f", {summary.skipped:,} already done"
    if summary.failed:
        text += f", {summary.failed:,} failed"
    if summary.not_started:
        text += f", {summary.not_started:,} not started"
    if summary.output_bytes:
        text += f"; {smaller(summary.input_bytes, summary.output_bytes, summary.ratio or 0)}"
    return f"{text}; {summary.seconds:.2f} s; {summary.report}"


@contextmanager
def _watching(work: str) -> Iterator[Any]:
    """A watcher that shows events on stderr: bars on a terminal, lines otherwise.

    `work` is the verb of the messages: encode or convert.
    """
    if is_quiet() or not sys.stderr.isatty():
        yield _Lines(work)
        return
    console = Console(stderr=True, emoji=False, highlight=False, markup=False, soft_wrap=True)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeElapsedColumn(), console=console, transient=True) as bars:
        yield _Bars(work, bars)


class _Lines:
    """A line for each finished scene, and for the current stage if it takes long."""

    def __init__(self, work: str) -> None:
        self._work = work
        self._total, self._count = 0, 0
        self._told = progress_lines(time.monotonic)

    def begun(self, total: int, skipped: int, report: str) -> None:
        """See `Watcher.begun`."""
        self._total = total
        done = f", {skipped:,} already done" if skipped else ""
        self.said(f"scenes to {self._work}: {total:,}{done}; report: {report}")

    def started(self, task: Any) -> None:
        """See `Watcher.started`."""

    def stage(self, task: Any, stage: str, done: int, total: int) -> None:
        """See `Watcher.stage`."""
        self._told(f"{task.name}: {stage}", done, total)

    def ended(self, task: Any, record: Any) -> None:
        """See `Watcher.ended`."""
        self._count += 1
        for warning in record.warnings:
            self.complained(f"warning: {warning}")
        place = f"[{self._count}/{self._total}] "
        if record.error is not None:
            self.complained(f"{place}error: {record.error['text']}")
            return
        sizes = smaller(record.input_bytes, record.output_bytes, record.ratio or 0)
        lost = (record.rendered and f"; views lose {loss_text(record.rendered['loss'])}") or ""
        self.said(f"{place}{task.name}: {counted(record.gaussians, 'Gaussian')}, {sizes}{lost}")

    def said(self, text: str) -> None:
        """See `Watcher.said`."""
        print_status(text)

    def complained(self, text: str) -> None:
        """A warning or an error, which is always printed."""
        print_problem(text)


class _Bars(_Lines):
    """Lines above a total progress bar and one bar for the stage of each running scene."""

    def __init__(self, work: str, bars: Progress) -> None:
        super().__init__(work)
        self._bars, self._whole, self._running = bars, TaskID(0), dict[str, TaskID]()

    def begun(self, total: int, skipped: int, report: str) -> None:
        """See `Watcher.begun`."""
        super().begun(total, skipped, report)
        self._whole = self._bars.add_task("scenes", total=total)

    def started(self, task: Any) -> None:
        """See `Watcher.started`."""
        if task.name not in self._running:
            self._running[task.name] = self._bars.add_task(printable(task.name), total=None)

    def stage(self, task: Any, stage: str, done: int, total: int) -> None:
        """See `Watcher.stage`."""
        self.started(task)  # on another machine, which sends no start event
        text = printable(f"{task.name}: {stage}")
        self._bars.update(self._running[task.name], description=text, completed=done, total=total)

    def ended(self, task: Any, record: Any) -> None:
        """See `Watcher.ended`."""
        if task.name in self._running:
            self._bars.remove_task(self._running.pop(task.name))
        super().ended(task, record)
        self._bars.advance(self._whole)

    def complained(self, text: str) -> None:
        """See `_Lines.complained`."""
        self.said(text)

    def said(self, text: str) -> None:
        """See `Watcher.said`."""
        self._bars.console.print(printable(text))

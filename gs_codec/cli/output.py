"""Output of the commands: results on stdout, status and progress on stderr."""

from __future__ import annotations

import logging
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TextIO

from gs_codec.errors import printable
from gs_codec.format_table import read_names
from gs_codec.report import NOT_MEASURED, Progress, RenderedLoss
from gs_codec.runtime.wording import as_typed, listed, log_warnings, size_text

if TYPE_CHECKING:
    from gs_codec.pages.tables import Table

#: Seconds between progress lines if stderr is not a terminal.
SECONDS_A_LINE = 10

#: Description of the scenes that commands read.
SCENES = f"A scene: {listed(read_names())}."
SCENES_PIPED = f"{SCENES[:-1]}; - is stdin."


class _Loudness:
    """How much the running command prints; see `set_loudness`."""

    results = status = True
    verbose = False


def set_loudness(quiet: bool = False, verbose: bool = False, results: bool = True) -> None:
    """Set how much is printed: `quiet` hides status and progress, and results unless wanted."""
    _Loudness.status, _Loudness.verbose = not quiet, verbose
    _Loudness.results = results or not quiet
    logging.getLogger("gs_codec").setLevel(logging.DEBUG if verbose else logging.NOTSET)
    _show_waits(not quiet)


def is_quiet() -> bool:
    """Whether status and progress are hidden."""
    return not _Loudness.status


def is_verbose() -> bool:
    """Whether times and memory are printed."""
    return _Loudness.verbose


def print_text(*lines: str) -> None:
    """Print lines of results on stdout."""
    for line in lines if _Loudness.results else ():
        print(printable(line))


def print_status(text: str) -> None:
    """Print a line on stderr, unless the command is quiet."""
    if _Loudness.status:
        print_problem(text)


def print_problem(text: str) -> None:
    """Always print a line on stderr: an error or a warning."""
    print(printable(text), file=sys.stderr)


class _Lines(logging.Formatter):
    """One-line messages."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802
        return printable(as_typed(super().formatMessage(record)))


def log_to_stderr(program: str) -> None:
    """Print warnings of the library as lines on stderr."""
    handler = logging.StreamHandler()
    handler.setFormatter(_Lines(f"{program}: %(levelname)s: %(message)s"))
    for level in (logging.WARNING, logging.INFO, logging.DEBUG):
        logging.addLevelName(level, logging.getLevelName(level).lower())
    logging.basicConfig(handlers=[handler], level=logging.WARNING)
    _show_waits(True)
    log_warnings()


def _show_waits(shown: bool) -> None:
    """Show or hide messages about what takes long: compiling kernels, and refinement."""
    shown = shown and os.environ.get("GS_CODEC_PROGRESS") != "0"
    for module in ("runtime.compiling", "preparation.optimise"):
        logger = logging.getLogger(f"gs_codec.{module}")
        logger.setLevel(logging.INFO if shown else logging.WARNING)


def print_table(table: Table, file: TextIO | None = None) -> None:
    """Print a table, on stdout unless a file is given."""
    if _Loudness.results if file is None else _Loudness.status:
        print(table.text(), file=file)


def bars(counts: Sequence[int]) -> str:
    """A histogram in one line, one character per bin; only a count of 0 is blank."""
    ramp, most = _ramp(), max(counts, default=0)
    # Rounded up, in integers.
    return "".join(ramp[-(-count * (len(ramp) - 1) // most) if count else 0] for count in counts)


def _ramp() -> str:
    """Characters from empty to full that stdout can show."""
    blocks = " ▁▂▃▄▅▆▇█"
    try:
        blocks.encode(sys.stdout.encoding or "ascii")
    except UnicodeEncodeError:
        return " .:-=+*#"
    return blocks


def print_prepared(prepared: dict[str, Any]) -> None:
    """Print what preparation removed, and its ablation table, on stdout."""
    from gs_codec.preparation.prepare_report import ablation_table

    for reason, number in prepared["removed"].items():
        if number:
            print_text(f"pruned by {reason}: {number:,} of {prepared['input_gaussians']:,}")
    print_table(ablation_table(prepared))


def print_rendered(loss: RenderedLoss | None, views: str = "rendered views") -> None:
    """Print the loss in rendered views on stdout; `views` describes the views."""
    if loss is None:
        print_text(NOT_MEASURED)
        return
    text = (
        f"{views}: {loss.psnr:.1f} dB against the original, "
        f"a loss of {'about ' if loss.loss >= 0.01 else ''}{loss_text(loss.loss)} at 30 dB; "
        f"95th percentile of crops {loss_text(loss.worst)}"
    )
    if loss.away is not None:
        text += f"; away from the cameras {loss_text(loss.away)}"
    print_text(text)
    if loss.remedy is not None:
        print_text(
            f"step sizes {loss.remedy}, finer than at first, because rendered views lost too much"
        )


def loss_text(loss: float) -> str:
    """A loss of rendered views with its unit."""
    return f"{loss:.2f} dB" if loss >= 0.01 else "less than 0.01 dB"


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """Show progress on stderr while the block runs: bars on a terminal, otherwise lines."""
    if not (_Loudness.status and sys.stderr.isatty()):
        yield progress_lines(time.monotonic)
        return
    from rich import progress as rich
    from rich.console import Console

    columns = (
        rich.TextColumn("{task.description}"),
        rich.BarColumn(),
        rich.TaskProgressColumn(),
        rich.TimeElapsedColumn(),
        rich.TextColumn("left"),
        rich.TimeRemainingColumn(),
    )
    with rich.Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, Any] = {}

        def update(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield update


def progress_lines(clock: Callable[[], float]) -> Progress:
    """A callback that prints the progress of a stage, at most every `SECONDS_A_LINE` seconds."""
    start = last = clock()
    began: dict[str, tuple[float, int]] = {}

    def update(stage: str, done: int, total: int) -> None:
        nonlocal last
        now = clock()
        since, first = began.setdefault(stage, (now, done))
        if now - last >= SECONDS_A_LINE:
            last = now
            line = f"{stage}: {done:,} of {total:,} after {now - start:.0f} s"
            if first < done < total:
                left = (now - since) / (done - first) * (total - done)
                line += f", {left:.0f} s left" if left < 120 else f", {left / 60:.0f} min left"
            print_status(line)

    return update


def smaller(before: int, after: int, ratio: float) -> str:
    """Two sizes and their ratio, which is relative to the floats if inputs were compressed.

    There is no ratio if the output is floats, or nearly as large.
    """
    if ratio < 1.05:
        return f"{size_text(before)} -> {size_text(after)}"
    basis = " relative to the floats" if abs(ratio * after - before) >= 1 else ""
    return f"{size_text(before)} -> {size_text(after)} ({ratio:.2f}x{basis})"

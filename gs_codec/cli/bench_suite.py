"""``gs-codec bench suite``."""

from __future__ import annotations

import json
import shlex
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from gs_codec.bench.suite.options import GROUPS, Options
from gs_codec.cli.bench_tables import (
    EQUAL_COLUMNS,
    GAIN_COLUMNS,
    equal_rows,
    gain_row,
    print_absent,
)
from gs_codec.cli.output import print_status, print_table, print_text
from gs_codec.cli.resources import Overwrite, Threads
from gs_codec.io.atomic import check_folder, check_writable, make_folder


def command(
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for suite.jsonl, report.html, pictures.")
    ],
    scenes: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="SCENE...",
            help="3DGS .ply files; cameras.json and images beside one are its views.",
            show_default=False,
        ),
    ] = None,
    repeats: Annotated[int, typer.Option(help="Timed runs; medians are reported.", min=1)] = 3,
    threads: Threads = None,
    width: Annotated[
        int | None,
        typer.Option(
            help="Width of the views, pixels.", show_default="the cameras', or the photographs'"
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the jitter in tiled scenes.", min=0)] = 0,
    skip: Annotated[
        list[str] | None,
        typer.Option(metavar="GROUP", help=f"Leave out, repeatedly: {', '.join(GROUPS)}."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Measure scenes in all that `bench` has, other codecs too, and report on them.

    Ten minutes for each 100,000 Gaussians, or so; suite.jsonl has what there is at any moment.
    """
    options = Options(tuple(scenes or ()), repeats, threads, width, seed, frozenset(skip or ()))
    check_folder(out, overwrite)
    lines = _measure(options, out)
    _print_tables(lines)
    print_status(f"report: {out / 'report.html'}")


def _measure(options: Options, out: Path) -> list[dict[str, Any]]:
    """Measure and report; lines are on stdout and in the file as soon as they are there."""
    from gs_codec.analysis.figure import new_figure
    from gs_codec.bench.suite.run import run_suite

    new_figure(1, 1)  # without matplotlib there is no report: refused before the work
    target = make_folder(out) / "suite.jsonl"
    check_writable(target)
    start = time.monotonic()

    def tell(stage: str) -> None:
        minutes, seconds = divmod(round(time.monotonic() - start), 60)
        print_status(f"{minutes:3}:{seconds:02} {stage}")

    lines = []
    measuring = run_suite(options, _typed(options, out), tell)
    with open(target, "w", encoding="utf-8") as file:
        for line in measuring:
            text = json.dumps(line, allow_nan=False)
            print(text, file=file, flush=True)
            print_text(text)
            lines.append(line)
    tell("report")
    from gs_codec.bench.suite.report import write_report

    write_report(lines, out)
    tell("done")
    return lines


def _typed(options: Options, out: Path) -> str:
    """The command that measures the same."""
    words = ["gs-codec", "bench", "suite", *map(str, options.scenes), "--out", str(out)]
    words += ["--repeats", str(options.repeats), "--seed", str(options.seed)]
    for name in ("threads", "width"):
        if (value := getattr(options, name)) is not None:
            words += [f"--{name}", str(value)]
    return shlex.join(
        words + [word for group in sorted(options.skip) for word in ("--skip", group)]
    )


def _print_tables(lines: list[dict[str, Any]]) -> None:
    """Bits at equal quality beside other codecs', and BD-rates over the paper's profiles."""
    if rows := equal_rows(lines):
        print_table(EQUAL_COLUMNS, rows, sys.stderr)
    if rates := [gain_row(line) for line in lines if line["kind"] == "bd-rate"]:
        print_table(GAIN_COLUMNS, rates, sys.stderr)
    print_absent(lines)

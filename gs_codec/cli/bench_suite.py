"""``gs-codec bench suite``."""

from __future__ import annotations

import json
import shlex
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from gs_codec.cli.bench_tables import print_absent
from gs_codec.cli.options import Overwrite, Threads
from gs_codec.cli.output import print_status, print_text
from gs_codec.runtime.atomic import check_folder, check_writable, make_folder


def command(
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for suite.jsonl, report.md, pictures.")
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
    skip: Annotated[
        list[str] | None,
        typer.Option(
            metavar="GROUP",
            help="Leave out, repeatedly: codecs, curves, memory, scaling, peers, guided, pruned.",
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Measure scenes in full, other codecs too, and write a report.

    Ten minutes for each 100,000 Gaussians, or so; suite.jsonl has all lines measured so far.
    """
    from gs_codec.analysis.plots import new_figure
    from gs_codec.bench.suite.report import write_report
    from gs_codec.bench.suite.run import Options, run_suite

    options = Options(tuple(scenes or ()), repeats, threads, width, frozenset(skip or ()))
    check_folder(out, overwrite)
    new_figure(1, 1)  # without matplotlib there is no report: refused before the work
    start = time.monotonic()

    def tell(stage: str) -> None:
        minutes, seconds = divmod(round(time.monotonic() - start), 60)
        print_status(f"{minutes:3}:{seconds:02} {stage}")

    target, lines = make_folder(out) / "suite.jsonl", []
    check_writable(target)
    measuring = run_suite(options, shlex.join(["gs-codec", *sys.argv[1:]]), tell)
    with open(target, "w", encoding="utf-8") as file:
        for line in measuring:
            text = json.dumps(line, allow_nan=False)
            print(text, file=file, flush=True)
            print_text(text)
            lines.append(line)
    tell("report")
    write_report(lines, out)
    print_absent(lines)
    print_status(f"report: {out / 'report.md'}")

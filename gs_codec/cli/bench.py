"""``gs-codec bench``: subcommands ``run``, ``peers``, ``suite``, ``paper``, ``losses``."""

from __future__ import annotations

import json
import re
import shlex
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from gs_codec.cli.action_options import InOrder
from gs_codec.cli.command import Shown
from gs_codec.cli.output import print_status, print_table, print_text, progress_bar
from gs_codec.cli.typed import Typed, takes
from gs_codec.config import PROFILE_CHOICES, PROFILES_SHOWN, Config
from gs_codec.errors import InvalidInput
from gs_codec.pages.tables import Table
from gs_codec.plan import CAMERAS
from gs_codec.presets import PRESETS
from gs_codec.runtime.atomic import check_folder, check_writable, make_folder, write_files
from gs_codec.runtime.optional import check_installed


def print_codecs(lines: list[dict[str, Any]]) -> None:
    """Print the table of each scene, as in the suite's report, and absent codecs, on stderr."""
    from gs_codec.bench.suite.results import Results
    from gs_codec.bench.suite.suite_tables import codec_table

    results = Results(lines)
    for scene in results.scenes:
        table = codec_table(results, scene)
        _print_plain(table._replace(columns=[f"{scene}: codec", *table.columns[1:]]))
    if any(line.get("own_process") for line in lines):
        print_status("* a separate program: its times include its start")
    for reason in results.absent:
        print_status(reason)


def _print_plain(table: Table) -> None:
    """Print a Markdown table without its markup, on stderr."""
    rows = [[re.sub(r"[`\\]|\*\*", "", cell) for cell in row] for row in table.rows]
    print_table(table._replace(rows=rows), sys.stderr)


def _typed() -> str:
    """The command as it was typed."""
    return shlex.join(["gs-codec", *sys.argv[1:]])


def _written(lines: Iterator[dict[str, Any]], target: Path) -> Iterator[dict[str, Any]]:
    """Yield result lines, after writing each to a file as JSON."""
    with open(target, "w", encoding="utf-8") as file:
        for line in lines:
            print(json.dumps(line, allow_nan=False), file=file, flush=True)
            yield line


def _printed(lines: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """The result lines, each printed as JSON immediately."""
    printed = []
    for line in lines:
        print_text(json.dumps(line))
        sys.stdout.flush()
        printed.append(line)
    return printed


_Codecs = Annotated[
    list[str] | None,
    typer.Option(
        "--codec",
        metavar="TEXT",
        help="Also measure a codec given as 'NAME: ENCODE; DECODE', two shell commands with {in} "
        "and {out}; may be repeated.",
    ),
]


@takes("threads", "width", "overwrite")
def measure_suite(
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for suite.jsonl, report.md and pictures.")
    ],
    typed: Typed,
    scenes: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="SCENE...",
            help="3DGS .ply files, with cameras.json and images in the same folder; with "
            "--dataset, the folder of its models.",
            show_default=False,
        ),
    ] = None,
    dataset: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Measure the INRIA trainer's models of a dataset (mipnerf360, tanksandtemples, "
            "deepblending), and list published results of other methods.",
        ),
    ] = None,
    gt_images: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of the dataset's photographs, DIR/SCENE/images; by default they are in "
            "the folder of each model.",
        ),
    ] = None,
    codec: _Codecs = None,
    repeats: Annotated[
        int, typer.Option(metavar="N", help="Timed runs; medians are reported.", min=1)
    ] = 3,
    skip: Annotated[
        list[str] | None,
        typer.Option(
            metavar="GROUP",
            help="Group to skip (codecs, curves, memory, geometry, scaling, device, peers, guided, "
            "pruned, refined); may be repeated.",
        ),
    ] = None,
) -> None:
    """Measure scenes with all profiles and other codecs, and write a report.

    It takes about ten minutes per 100,000 Gaussians, and the same again
    for refinement. suite.jsonl has all lines measured so far. With --dataset,
    only codecs are measured, and results are also written as the CSV files of
    the survey 3DGS.zip.
    """
    from gs_codec.bench.peers import own_peers
    from gs_codec.bench.suite.datasets import DATASETS, dataset_table
    from gs_codec.bench.suite.measurements import Options, run_suite
    from gs_codec.bench.suite.results import Results
    from gs_codec.bench.suite.suite_report import write_report

    if dataset is None and gt_images is not None:
        raise InvalidInput("--gt-images needs --dataset")
    if dataset is not None and len(scenes or ()) != 1:
        raise InvalidInput(f"--dataset {dataset}: expected one folder, that of its models")
    options = Options(
        tuple(scenes or ()), repeats, typed["threads"], typed["width"], frozenset(skip or ()),
        dataset, gt_images, own_peers(codec or ()),
    )  # fmt: skip
    check_folder(out, typed["overwrite"])
    check_installed("matplotlib", "plots")
    start = time.monotonic()

    def announce(stage: str) -> None:
        minutes, seconds = divmod(round(time.monotonic() - start), 60)
        print_status(f"{minutes:3}:{seconds:02} {stage}")

    measuring = run_suite(options, _typed(), announce)  # opens the scenes
    target = make_folder(out) / "suite.jsonl"
    check_writable(target)
    lines = _printed(_written(measuring, target))
    announce("report")
    write_report(lines, out)
    print_codecs(lines)
    if dataset is not None:
        _print_plain(dataset_table(Results(lines), DATASETS[dataset]))
    print_status(f"report: {out / 'report.md'}")


@takes("refine", "threads", "overwrite", refine=PRESETS["entropygs"].steps.refine)
def measure_paper(
    scenes: Annotated[
        list[Path],
        typer.Argument(
            metavar="SCENE...",
            help="3DGS .ply files, with cameras.json and images in the same folder.",
        ),
    ],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for paper.jsonl, paper.md and checkpoints.")
    ],
    typed: Typed,
) -> None:
    """Reproduce the paper's experiment: run preset entropygs and print the paper's tables.

    Refinement takes most of the time; with --overwrite it resumes from
    checkpoints in DIR.
    """
    from gs_codec.bench.reproduce import open_scenes, reproduce, tables_of
    from gs_codec.runtime.threads import using_threads

    check_folder(out, typed["overwrite"])
    with using_threads(typed["threads"]), progress_bar() as progress:
        measured = open_scenes(scenes)
        target = make_folder(out) / "paper.jsonl"
        check_writable(target)
        measuring = reproduce(measured, typed["refine"], out, _typed(), progress)
        lines = list(_written(measuring, target))
    page = tables_of(lines)
    write_files(out, {"paper.md": page.encode("utf-8", "backslashreplace")})
    print_text(*page.splitlines())


@takes("threads")
def measure_captures(
    scenes: Annotated[
        list[Path],
        typer.Argument(
            metavar="SCENE...",
            help="3DGS .ply files; cameras.json in the same folder marks some cameras as test.",
        ),
    ],
    typed: Typed,
) -> None:
    """Measure the loss of profile m in held-out views: without, with estimated, with given cameras.

    JSON lines go to stdout, a Markdown table to stderr. Losses are for a
    scene that matches its photographs to 30 dB.
    """
    from gs_codec.bench.losses import loss_table, measure_losses
    from gs_codec.runtime.threads import using_threads

    with using_threads(typed["threads"]), progress_bar() as progress:
        lines = _printed(measure_losses(scenes, progress))
    for text in loss_table(lines):
        print_status(text)


class _Group(Shown, TyperGroup):
    """The subcommands; anything else gives one error that lists them."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if args and args[0] not in self.commands:
            names = ", ".join(self.commands)
            raise InvalidInput(f"bench {args[0]}: expected a subcommand, one of {names}")
        return super().resolve_command(ctx, args)


app = typer.Typer(
    cls=_Group,
    help="Measure time, size, error, memory and rendered quality; print JSON lines.",
    no_args_is_help=True,
    add_completion=False,
)


@takes(
    "threads", "gt_images", "width", "extra", "depth", "models", "laplace_scales", "coder"
)  # fmt: skip
def measure(
    scenes: Annotated[list[Path], typer.Argument(metavar="SCENE...", help="3DGS .ply files.")],
    typed: Typed,
    profile: Annotated[
        list[str] | None,
        typer.Option(
            "--profile",
            "-p",
            metavar="NAME",
            help=f"Profile: {PROFILES_SHOWN}; may be repeated.",
            show_default="all profiles",
        ),
    ] = None,
    tile: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Repeat each scene in jittered tiles, up to this number of Gaussians.",
            min=1,
        ),
    ] = None,
    repeats: Annotated[
        int, typer.Option(metavar="N", help="Timed runs; medians are reported.", min=1)
    ] = 5,
    cameras: Annotated[
        str | None, typer.Option(metavar="C", help=f"Also measure rendered quality: {CAMERAS}")
    ] = None,
    codec: _Codecs = None,
) -> None:
    """Measure scenes one by one; JSON lines go to stdout, a table to stderr."""
    if cameras is None:
        typed.refuse(("gt_images", "width"), "needs --cameras")
    configs = [typed.build(Config, profile=name) for name in profile or PROFILE_CHOICES]
    from gs_codec.bench.measure import measure_scenes
    from gs_codec.bench.peers import own_peers

    views, peers = (cameras, typed["gt_images"], typed["width"]), typed.command == "peers"
    own = own_peers(codec or ())
    print_codecs(_printed(measure_scenes(scenes, configs, tile, repeats, *views, peers, own)))


for _name, _help in (
    ("run", "Measure each profile: time, size, entropy, error, memory, quality."),
    ("peers", "Compare profiles with spz, splat-transform, pcodec, zstd and codecs of your own."),
):
    app.command(_name, cls=InOrder, help=_help)(measure)
app.command("suite", cls=InOrder)(measure_suite)
app.command("paper", cls=InOrder)(measure_paper)
app.command("losses", cls=InOrder)(measure_captures)

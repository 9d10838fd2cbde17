"""``gs-codec bench``: subcommands ``run``, ``peers`` and ``suite``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from gs_codec.cli import bench_suite
from gs_codec.cli.bench_tables import COLUMNS, add_to_rows, print_absent
from gs_codec.cli.coding import Depth, Extra, parse_depths
from gs_codec.cli.given import is_given, refuse_given
from gs_codec.cli.output import print_table, print_text
from gs_codec.cli.resources import Threads
from gs_codec.cli.views import CAMERAS, Width
from gs_codec.config import PROFILE_CHOICES, Config
from gs_codec.errors import InvalidInput


class _Group(TyperGroup):
    """The subcommands; anything else in their place is one error that names them."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if args and args[0] not in self.commands:
            names = ", ".join(self.commands)
            raise InvalidInput(f"bench {args[0]}: expected a subcommand, one of {names}")
        return super().resolve_command(ctx, args)


app = typer.Typer(
    cls=_Group,
    help="Measure time, size, error, memory and rendered quality; JSON lines on stdout.",
    no_args_is_help=True,
    add_completion=False,
)


@app.command("peers", help="Measure profiles beside spz, splat-transform, pcodec and zstd.")
@app.command("run", help="Measure each profile: time, size, entropy, error, memory, quality.")
def measure(
    ctx: typer.Context,
    scenes: Annotated[list[Path], typer.Argument(metavar="SCENE...", help="3DGS .ply files.")],
    profile: Annotated[
        list[str] | None,
        typer.Option("--profile", "-p", help="May be repeated.", show_default="all profiles"),
    ] = None,
    depth: Depth = None,
    tile: Annotated[
        int | None, typer.Option(help="Tile each scene, jittered, to this many Gaussians.", min=1)
    ] = None,
    repeats: Annotated[int, typer.Option(help="Timed runs; medians are reported.", min=1)] = 5,
    threads: Threads = None,
    cameras: Annotated[
        str | None, typer.Option(metavar="C", help=f"Measure rendered quality too: {CAMERAS}")
    ] = None,
    against_gt: Annotated[
        Path | None,
        typer.Option(metavar="IMAGES", help="Ground-truth images of these cameras."),
    ] = None,
    width: Width = None,
    extra: Extra = "error",
) -> None:
    """Measure scenes one by one; lines on stdout, a table of them on stderr."""
    if not is_given(ctx, "cameras"):
        refuse_given(ctx, ("against_gt", "width"), "needs --cameras")
    configs = [
        Config(name, parse_depths(depth or []), "error", extra, threads)  # type: ignore[arg-type]
        for name in profile or PROFILE_CHOICES
    ]
    from gs_codec.bench.runs import run_peers, run_profiles

    run = run_peers if ctx.info_name == "peers" else run_profiles
    rows: dict[str, list[str]] = {}
    lines = []
    for line in run(scenes, configs, tile, repeats, cameras, against_gt, width):
        print_text(json.dumps(line))
        add_to_rows(rows, line)
        lines.append(line)
    print_table(COLUMNS, list(rows.values()), sys.stderr)
    print_absent(lines)


app.command("suite")(bench_suite.command)

"""``gs-codec bench``: subcommands ``run``, ``peers`` and ``suite``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from gs_codec.cli import bench_suite
from gs_codec.cli.asked import Asked, takes
from gs_codec.cli.bench_tables import COLUMNS, add_to_rows, print_absent
from gs_codec.cli.options import OPTIONS
from gs_codec.cli.output import print_table, print_text
from gs_codec.config import PROFILE_CHOICES, Config
from gs_codec.errors import InvalidInput
from gs_codec.preparation.steps import CAMERAS

#: What `--set` does not take here: only depths are of interest for every profile.
_UNUSED = set(OPTIONS) - {"depth"}


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


@takes("threads", "gt_images", "width", "extra", expert=(Config,), without=_UNUSED)
def measure(
    scenes: Annotated[list[Path], typer.Argument(metavar="SCENE...", help="3DGS .ply files.")],
    asked: Asked,
    profile: Annotated[
        list[str] | None,
        typer.Option("--profile", "-p", help="May be repeated.", show_default="all profiles"),
    ] = None,
    tile: Annotated[
        int | None, typer.Option(help="Tile each scene, jittered, to this many Gaussians.", min=1)
    ] = None,
    repeats: Annotated[int, typer.Option(help="Timed runs; medians are reported.", min=1)] = 5,
    cameras: Annotated[
        str | None, typer.Option(metavar="C", help=f"Measure rendered quality too: {CAMERAS}")
    ] = None,
) -> None:
    """Measure scenes one by one; lines on stdout, a table of them on stderr."""
    if cameras is None:
        asked.refuse(("gt_images", "width"), "needs --cameras")
    configs = [asked.build(Config, profile=name) for name in profile or PROFILE_CHOICES]
    from gs_codec.bench.runs import run_peers, run_profiles

    run = run_peers if asked.command == "peers" else run_profiles
    views = (cameras, asked["gt_images"], asked["width"])
    rows: dict[str, list[str]] = {}
    lines = []
    for line in run(scenes, configs, tile, repeats, *views):
        print_text(json.dumps(line))
        add_to_rows(rows, line)
        lines.append(line)
    print_table(COLUMNS, list(rows.values()), sys.stderr)
    print_absent(lines)


for _name, _help in (
    ("run", "Measure each profile: time, size, entropy, error, memory, quality."),
    ("peers", "Measure profiles beside spz, splat-transform, pcodec and zstd."),
):
    app.command(_name, help=_help, epilog=measure.epilog)(measure)
app.command("suite")(bench_suite.command)

"""``gs-codec convert``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gs_codec.cli import coding
from gs_codec.cli.given import refuse_given
from gs_codec.cli.output import (
    SCENES_PIPED,
    print_json,
    print_status,
    print_text,
    progress_bar,
    size_text,
)
from gs_codec.cli.resources import MaxBytes, Overwrite, Threads
from gs_codec.cli.streams import piped_source

if TYPE_CHECKING:
    from gs_codec.conversion import ConvertReport


def command(
    ctx: typer.Context,
    source: Annotated[Path, typer.Argument(metavar="IN", help=SCENES_PIPED)],
    target: Annotated[
        Path, typer.Argument(metavar="OUT", help="File to write: .ply, .egs or .splat.")
    ],
    extra: coding.Extra = "keep",
    nonfinite: coding.Nonfinite = "error",
    coordinates: Annotated[
        str,
        typer.Option(
            metavar="[FROM:]TO",
            help="Where x, y and z point in OUT: RDF is right, down, forward, as in PLY files; "
            "'keep' is as in IN. FROM is for an IN that does not state its own, or a wrong one.",
        ),
    ] = "RDF",
    profile: coding.Profile = "m",
    depth: coding.Depth = None,
    keep_order: coding.KeepOrder = False,
    threads: Threads = None,
    max_bytes: MaxBytes = None,
    overwrite: Overwrite = False,
    json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """Convert a scene to another format, and say what that loses; profiles are for an .egs."""
    config = coding.config_of(ctx, locals())
    if target.suffix.lower() != ".egs":
        of_coding = ("keep_order", "profile", "depth")
        refuse_given(ctx, of_coding, f"has no effect on {target}, expected an .egs")
    from gs_codec.conversion import convert_file

    with piped_source(source) as file, progress_bar() as progress:
        done = convert_file(file, target, config, coordinates, progress, overwrite, max_bytes)
    _say_what_changed(done)
    if json:
        print_json({"input": str(source), "output": str(target), **asdict(done)})
    else:
        print_text(
            f"{target}: {done.count:,} Gaussians, SH degree {done.sh_degree}, "
            f"{size_text(done.file_bytes)}, {sum(done.seconds.values()):.2f} s"
        )


def _say_what_changed(done: ConvertReport) -> None:
    if done.dropped:
        print_status(f"dropped {done.dropped:,} Gaussians with NaN or infinity")
    if done.turned_from:
        print_status(f"coordinates turned from {done.turned_from} to {done.coordinates}")
    else:
        print_status(f"coordinates {done.coordinates}, as they were")

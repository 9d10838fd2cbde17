"""``gs-codec decode``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from gs_codec.cli.output import print_json, print_text, progress_bar, size_text


def command(
    source: Annotated[Path, typer.Argument(metavar="IN", help="An .egs file.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="Scene to write, a .ply.")],
    threads: Annotated[
        int | None,
        typer.Option(help="Worker threads.", min=1, max=256, show_default="all processors"),
    ] = None,
    max_bytes: Annotated[
        int | None,
        typer.Option(help="Largest decoded size.", show_default="1 GiB or 1000 times the file"),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """Decode an .egs file to a PLY that other 3DGS tools open."""
    from gs_codec.files import decode_file

    with progress_bar(not json) as progress:
        report = decode_file(source, target, threads, max_bytes, progress)
    size = target.stat().st_size
    if json:
        print_json(
            {"input": str(source), "output": str(target), "output_bytes": size, **asdict(report)}
        )
    else:
        print_text(
            f"{target}: {report.count:,} Gaussians, SH degree {report.sh_degree}, "
            f"{size_text(size)}, {sum(report.seconds.values()):.2f} s"
        )

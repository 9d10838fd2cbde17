"""``gs-codec verify``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from gs_codec.cli.asked import Asked, takes
from gs_codec.cli.output import print_json, print_text, progress_bar, size_text
from gs_codec.cli.streams import piped_source


@takes("threads", "max_memory", "max_bytes", "tmc3", "json")
def command(
    source: Annotated[Path, typer.Argument(metavar="FILE", help="An .egs file; - is stdin.")],
    asked: Asked,
) -> None:
    """Check every checksum of an .egs file and decode all of it, writing nothing."""
    from gs_codec.codecs.slabs import verify_file

    with piped_source(source) as file, progress_bar() as progress:
        report = verify_file(
            file, asked["threads"], asked["max_bytes"], progress, asked["tmc3"], asked["max_memory"]
        )
    if asked["json"]:
        print_json({"input": str(source), **asdict(report)})
    else:
        print_text(
            f"{source}: sound, {size_text(report.file_bytes)}, {report.sections:,} sections, "
            f"{report.count:,} Gaussians, {report.blocks:,} blocks, SH degree "
            f"{report.sh_degree}, profile {report.profile}, {report.seconds:.2f} s"
        )

"""``gs-codec convert``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gs_codec.cli.asked import Asked, config_of, refuse_coding, takes
from gs_codec.cli.options import WRITTEN_SHOWN
from gs_codec.cli.output import (
    SCENES_PIPED,
    print_json,
    print_status,
    print_text,
    progress_bar,
    size_text,
)
from gs_codec.cli.streams import piped_source
from gs_codec.config import Config
from gs_codec.files.suffixes import PLAIN, known_suffix

if TYPE_CHECKING:
    from gs_codec.files.conversion import ConvertReport


@takes(
    "extra", "nonfinite", "profile", "threads", "max_bytes", "overwrite", "json",
    expert=(Config,), without=("format",), extra="keep",
)  # fmt: skip
def command(
    source: Annotated[Path, typer.Argument(metavar="IN", help=SCENES_PIPED)],
    target: Annotated[Path, typer.Argument(metavar="OUT", help=f"File to write: {WRITTEN_SHOWN}.")],
    asked: Asked,
    coordinates: Annotated[
        str,
        typer.Option(
            metavar="[FROM:]TO",
            help="Where x, y and z point in OUT: RDF is right, down, forward, as in PLY files; "
            "'keep' is as in IN. FROM is for an IN that does not state its own, or a wrong one.",
        ),
    ] = "RDF",
) -> None:
    """Convert a scene to another format, and report what that loses."""
    if (suffix := known_suffix(target)) in PLAIN:
        refuse_coding(asked, suffix[1:], target)
    config = config_of(asked, target)
    from gs_codec.files.conversion import convert_file

    with piped_source(source) as file, progress_bar() as progress:
        done = convert_file(
            file, target, config, coordinates, progress=progress, max_bytes=asked["max_bytes"],
            overwrite=asked["overwrite"],
        )  # fmt: skip
    _say_what_changed(done)
    if asked["json"]:
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

"""``gs-codec convert``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gs_codec.cli.action_options import say_what_was_done
from gs_codec.cli.documents import print_document
from gs_codec.cli.options import WRITTEN_SHOWN
from gs_codec.cli.output import (
    SCENES_PIPED,
    print_rendered,
    print_status,
    print_text,
    progress_bar,
)
from gs_codec.cli.streams import is_stdout, piped
from gs_codec.cli.typed import Typed, takes
from gs_codec.cli.typed_request import action_plan, config_of
from gs_codec.config import Config
from gs_codec.edit.actions import KINDS
from gs_codec.encoding.combinations import refuse_coding
from gs_codec.errors import InvalidInput
from gs_codec.files.suffixes import LEVELLED, PLAIN, format_name, known_suffix
from gs_codec.plan import CAMERAS, Plan
from gs_codec.report import bits_per_gaussian, lacks_loss
from gs_codec.runtime.wording import counted, listed, size_text

if TYPE_CHECKING:
    from gs_codec.files.conversion import ConvertReport


@takes(
    "extra", "nonfinite", "profile", "format", "lod_levels", "threads", "max_memory", "max_bytes",
    "overwrite", "json", expert=(Config, Plan), actions=tuple(KINDS),
    hidden=["input_format"],
    without=("cameras", "gt_images", "checkpoint", "device"), extra="keep", format="ply",
)  # fmt: skip
def command(
    sources: Annotated[
        list[Path], typer.Argument(metavar="IN", help=f"{SCENES_PIPED} Several are merged.")
    ],
    target: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            help=f"File to write: {WRITTEN_SHOWN}; streamed: {listed(LEVELLED)}; - is stdout.",
        ),
    ],
    typed: Typed,
    coordinates: Annotated[
        str,
        typer.Option(
            metavar="[FROM:]TO",
            help="Coordinate system of OUT: RDF (right, down, forward, as in PLY files), RUB, ..., "
            "or keep (that of IN); FROM sets that of IN, if it is missing or wrong.",
        ),
    ] = "RDF",
    at: Annotated[
        str | None,
        typer.Option(
            metavar="LON,LAT,HEIGHT",
            help="Place of the origin of 3D Tiles, degrees and metres; right is east, forward "
            "north.",
        ),
    ] = None,
    level: Annotated[
        int,
        typer.Option(metavar="N", min=0, help="Coarser level to read of an .egs or 3D Tiles."),
    ] = 0,
    cameras: Annotated[
        str | None,
        typer.Option(
            metavar="C", help=f"Views for --remove-floaters, --gaussians and --keep: {CAMERAS}"
        ),
    ] = None,
) -> None:
    """Convert, merge and edit scenes in any format, and report every loss."""
    suffix = f".{typed['format']}" if is_stdout(target) else known_suffix(target)
    if not suffix:
        from gs_codec.egs.frame_sections import is_sequence

        if moving := next(filter(is_sequence, sources), None):
            raise InvalidInput(f"{moving} is a sequence: `decode` writes its frames to a folder")
    if suffix in PLAIN:
        refuse_coding(typed, suffix[1:], target)
    config, plan = config_of(typed, target), action_plan(typed)
    from gs_codec.files.conversion import convert_file
    from gs_codec.formats.registry import scene_files
    from gs_codec.runtime.mapped import total_bytes

    with piped(sources, target, suffix, typed["input_format"]) as (files, out):
        with progress_bar() as progress:
            done = convert_file(
                files, out, config, coordinates, actions=typed.actions, plan=plan,
                progress=progress, max_memory=typed["max_memory"], max_bytes=typed["max_bytes"],
                overwrite=typed["overwrite"], by_profile=typed.has("profile", "coarseness"),
                at=_place(at), level=level,
            )  # fmt: skip
        _say_what_changed(done)
        profile = None if suffix in PLAIN else config.profile
        if typed["json"]:
            inputs = [str(source) for source in sources]
            shown = asdict(done)
            print_document(
                input=inputs if len(inputs) > 1 else inputs[0], output=str(target),
                input_bytes=sum(total_bytes(scene_files(file)) for file in files),
                profile=profile, format=format_name(suffix),
                bits_per_gaussian=bits_per_gaussian(done.file_bytes, done.count),
                stages=shown.pop("seconds"), **shown,
            )  # fmt: skip
        else:
            print_text(
                f"{target}: {counted(done.count, 'Gaussian')}, SH degree {done.sh_degree}, "
                f"{size_text(done.file_bytes)}, {sum(done.seconds.values()):.2f} s"
            )
            if done.rendered is not None or lacks_loss(done.rendered, profile):
                print_rendered(done.rendered)


def _place(typed: str | None) -> tuple[float, float, float] | None:
    """The place that was typed."""
    if typed is None:
        return None
    try:
        longitude, latitude, height = map(float, typed.split(","))
    except ValueError:
        raise InvalidInput(f"--at {typed}: expected LON,LAT,HEIGHT") from None
    return longitude, latitude, height


def _say_what_changed(done: ConvertReport) -> None:
    say_what_was_done(done.actions)
    if done.dropped:
        print_status(f"dropped {counted(done.dropped, 'Gaussian')} with NaN or infinity")
    if done.turned_from:
        print_status(f"coordinates converted from {done.turned_from} to {done.coordinates}")
    else:
        print_status(f"coordinates unchanged ({done.coordinates})")

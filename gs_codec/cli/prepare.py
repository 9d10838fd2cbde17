"""``gs-codec prepare``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gs_codec.cli.documents import print_document
from gs_codec.cli.options import WRITTEN_SHOWN
from gs_codec.cli.output import (
    SCENES_PIPED,
    print_prepared,
    print_rendered,
    progress_bar,
)
from gs_codec.cli.streams import piped_source
from gs_codec.cli.typed import Typed, takes
from gs_codec.cli.typed_request import config_of, plan_of
from gs_codec.config import Config
from gs_codec.errors import InvalidInput
from gs_codec.files.suffixes import PLAIN, format_name, known_suffix
from gs_codec.plan import Plan
from gs_codec.report import bits_per_gaussian


@takes(
    "profile", "preset", "cameras", "gt_images", "refine", "prune", "gaussians",
    "prune_max_psnr_drop", "prune_geometry", "geometry_rule", "prune_importance", "compact_sh",
    "refit_colour", "rectify", "report", "checkpoint", "threads", "max_bytes", "overwrite", "json",
    expert=(Config, Plan), without=("nonfinite", "extra", "format"), hidden=["input_format"],
)  # fmt: skip
def command(
    source: Annotated[Path, typer.Argument(metavar="IN", help=SCENES_PIPED)],
    target: Annotated[
        Path, typer.Argument(metavar="OUT", help=f"Scene to write: {WRITTEN_SHOWN}.")
    ],
    typed: Typed,
) -> None:
    """Prune, refine or compact a scene before coding, and report the loss."""
    if known_suffix(target) in PLAIN:
        typed.refuse(["lod"], f"has no effect on {target}, expected an .egs")
    config = config_of(typed, target)
    plan = plan_of(typed, config)
    if plan is None or not plan.steps.wanted:
        raise InvalidInput("no step of preparation given; pass one, for example --prune 30")
    from gs_codec.files.preparing import prepare_file
    from gs_codec.files.writing import written_bytes
    from gs_codec.formats.registry import scene_files
    from gs_codec.runtime.mapped import total_bytes

    with piped_source(source, typed["input_format"]) as file, progress_bar() as progress:
        done = prepare_file(
            file, target, plan, config, progress=progress, report_folder=typed["report"],
            max_bytes=typed["max_bytes"], overwrite=typed["overwrite"],
        )  # fmt: skip
        input_bytes = total_bytes(scene_files(file))
    if typed["json"]:
        size, suffix = written_bytes(target), known_suffix(target)
        print_document(
            input=str(source), output=str(target), format=format_name(suffix),
            input_bytes=input_bytes, output_bytes=size,
            profile=None if suffix in PLAIN else config.profile,
            bits_per_gaussian=bits_per_gaussian(size, done.steps[-1].count), **done.as_dict(),
        )  # fmt: skip
    else:
        print_prepared(done.as_dict())
        print_rendered(done.rendered)

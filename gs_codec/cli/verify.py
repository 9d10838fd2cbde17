"""``gs-codec verify``."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from gs_codec.cli.documents import print_document
from gs_codec.cli.output import SCENES_PIPED, print_text, progress_bar
from gs_codec.cli.streams import piped_source
from gs_codec.cli.typed import Typed, takes
from gs_codec.config import EGS
from gs_codec.report import bits_per_gaussian
from gs_codec.runtime.wording import counted, size_text

_OF_EGS = ("threads", "max_memory", "tmc3")


@takes("threads", "max_memory", "max_bytes", "tmc3", "json", hidden=["input_format"])
def command(
    source: Annotated[Path, typer.Argument(metavar="FILE", help=SCENES_PIPED)],
    typed: Typed,
) -> None:
    """Check a whole file: test checksums and decode an .egs, or read another format."""
    from gs_codec.cli import sequence_commands
    from gs_codec.codecs.slabs import verify_file
    from gs_codec.files.scenes import is_egs

    with piped_source(source, typed["input_format"]) as file, progress_bar() as progress:
        if sequence_commands.moves(file):
            sequence_commands.verify(source, file, typed)
            return
        if not is_egs(file):
            typed.refuse(_OF_EGS, f"has no effect on {source}, expected an .egs")
            _verify_other(source, file, typed)
            return
        report = verify_file(
            file, typed["threads"], typed["max_bytes"], progress, typed["tmc3"], typed["max_memory"]
        )
    if typed["json"]:
        shown = asdict(report)
        print_document(
            input=str(source), format=EGS, input_bytes=shown.pop("file_bytes"),
            bits_per_gaussian=bits_per_gaussian(report.file_bytes, report.count), **shown,
        )  # fmt: skip
    else:
        levels = f"{counted(report.levels, 'coarser level')}, " if report.levels else ""
        print_text(
            f"{source}: sound, {size_text(report.file_bytes)}, "
            f"{counted(report.sections, 'section')}, {counted(report.count, 'Gaussian')}, "
            f"{counted(report.blocks, 'block')}, {levels}SH degree "
            f"{report.sh_degree}, profile {report.profile}, {report.seconds:.2f} s"
        )


def _verify_other(source: Path, file: Path, typed: Typed) -> None:
    """Read a scene at `file`, called `source`, that is not an .egs."""
    from gs_codec.formats.registry import check_file, overview_of

    start = time.perf_counter()
    found = overview_of(file, typed["max_bytes"])
    check_file(file, typed["max_bytes"])
    seconds = time.perf_counter() - start
    if typed["json"]:
        shown = found.as_dict()
        print_document(
            input=str(source), input_bytes=shown.pop("file_bytes"),
            bits_per_gaussian=bits_per_gaussian(found.file_bytes, found.count),
            seconds=seconds, **shown,
        )  # fmt: skip
    else:
        print_text(
            f"{source}: sound, {size_text(found.file_bytes)}, {found.format}, "
            f"{counted(found.count, 'Gaussian')}, SH degree {found.sh_degree}, {seconds:.2f} s"
        )

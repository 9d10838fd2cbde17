"""``gs-codec decode``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gs_codec.cli.asked import Asked, takes
from gs_codec.cli.output import print_json, print_text, progress_bar, size_text
from gs_codec.cli.streams import check_no_pipes, piped
from gs_codec.errors import InvalidInput

if TYPE_CHECKING:
    from gs_codec.files.coding import DecodeReport


@takes("threads", "max_memory", "max_bytes", "tmc3", "dask", "overwrite", "json")
def command(
    source: Annotated[Path, typer.Argument(metavar="IN", help="An .egs file; - is stdin.")],
    target: Annotated[
        Path, typer.Argument(metavar="OUT", help="Scene to write, a .ply; - is stdout.")
    ],
    asked: Asked,
    bbox: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z,X,Y,Z",
            help="Only Gaussians whose centre is in this box: lowest, then highest corner.",
        ),
    ] = None,
    sh_degree: Annotated[
        int | None, typer.Option(metavar="D", help="No SH above this degree, 0-3.")
    ] = None,
) -> None:
    """Decode an .egs file to a PLY that other 3DGS tools open."""
    box = None if bbox is None else _parse_box(bbox)
    from gs_codec.codecs.part import Part
    from gs_codec.files.coding import decode_file

    part = Part(box, sh_degree)
    if asked["dask"] is not None:
        asked.refuse(["max_bytes", "tmc3"], "has no effect with --dask")
        check_no_pipes("--dask", source, target)
        from gs_codec.distributed.decoding import decode_distributed

        with progress_bar() as progress:
            report = decode_distributed(
                source, target, part, dask=asked["dask"], threads=asked["threads"],
                progress=progress, max_memory=asked["max_memory"], overwrite=asked["overwrite"],
            )  # fmt: skip
        _tell(source, target, target, asked, report)
        return
    with piped([source], target, ".ply") as ([file], out):
        with progress_bar() as progress:
            report = decode_file(
                file, out, part, threads=asked["threads"], tmc3=asked["tmc3"], progress=progress,
                max_memory=asked["max_memory"], max_bytes=asked["max_bytes"],
                overwrite=asked["overwrite"],
            )  # fmt: skip
        _tell(source, target, out, asked, report)


def _tell(source: Path, target: Path, out: Path, asked: Asked, report: DecodeReport) -> None:
    """Print the report; `out` is the file that was written for the target."""
    named = {"input": str(source), "output": str(target), "output_bytes": out.stat().st_size}
    if asked["json"]:
        print_json(named | asdict(report))
    else:
        _print_report(named, report)


def _print_report(named: dict[str, Any], report: DecodeReport) -> None:
    print_text(
        f"{named['output']}: {report.count:,} Gaussians, SH degree {report.sh_degree}, "
        f"{size_text(named['output_bytes'])}, {sum(report.seconds.values()):.2f} s"
    )
    if report.bytes_read < report.file_bytes:
        share = report.bytes_read / report.file_bytes
        print_text(f"read {size_text(report.bytes_read)} of {named['input']}, {share:.0%} of it")


def _parse_box(text: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(field) for field in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != 6:
        raise InvalidInput(f"--bbox {text}: expected six numbers, x,y,z,x,y,z")
    return numbers

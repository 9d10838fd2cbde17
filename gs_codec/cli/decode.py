"""``gs-codec decode``."""

from __future__ import annotations

import os
import re
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gs_codec.cli.documents import print_document
from gs_codec.cli.output import print_text, progress_bar
from gs_codec.cli.streams import check_no_pipes, piped, piped_source
from gs_codec.cli.typed import Typed, takes
from gs_codec.errors import InvalidInput
from gs_codec.report import bits_per_gaussian
from gs_codec.runtime.wording import counted, size_text

if TYPE_CHECKING:
    from gs_codec.cameras.camera import Camera
    from gs_codec.files.decode_file import DecodeReport


@takes("threads", "max_memory", "max_bytes", "tmc3", "dask", "overwrite", "json")
def command(
    source: Annotated[Path, typer.Argument(metavar="IN", help="An .egs file; - is stdin.")],
    typed: Typed,
    target: Annotated[
        Path | None,
        typer.Argument(
            metavar="[OUT]",
            help="PLY to write; - is stdout.",
            show_default="IN with the suffix .ply",
        ),
    ] = None,
    bbox: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z,X,Y,Z",
            help="Decode only Gaussians with centres in this box: lowest, then highest corner.",
        ),
    ] = None,
    sh_degree: Annotated[
        int | None, typer.Option(metavar="D", help="Omit SH above this degree, 0-3.")
    ] = None,
    level: Annotated[
        int,
        typer.Option(metavar="K", help="Level of detail: 0 is the scene, 1 a quarter of it, ..."),
    ] = 0,
    view: Annotated[
        str | None,
        typer.Option(
            metavar="CAMERAS[:NAME]",
            help="Decode only what a camera (NAME, or #N from 0) needs; see --tolerance.",
        ),
    ] = None,
    budget: Annotated[
        int | None, typer.Option(metavar="N", help="With --view: maximum number of Gaussians.")
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(metavar="PIXELS", help="With --view: maximum error, pixels (default: 1)."),
    ] = None,
    frame: Annotated[
        int | None, typer.Option(metavar="K", help="Of a sequence, decode only this frame, from 0.")
    ] = None,
    time: Annotated[
        str | None,
        typer.Option(metavar="START-END", help="Of a sequence, decode only these seconds."),
    ] = None,
) -> None:
    """Decode an .egs file to a PLY that other 3DGS tools open.

    For a sequence, OUT is a folder with a PLY of each frame (default: IN without its suffix).
    """
    if target is None and str(source) == "-":
        raise InvalidInput("missing OUT: required with stdin, expected a .ply, or - for stdout")
    from gs_codec.egs.frame_sections import is_sequence

    with piped_source(source) as file:
        if is_sequence(file):
            from gs_codec.cli import sequence_commands

            target = target or source.with_suffix("" if frame is None else ".ply")
            sequence_commands.decode(source, file, target, typed, frame, time)
            return
        typed.refuse(["frame", "time"], f"has no effect on {source}, expected a sequence")
        target = target or source.with_suffix(".ply")
        box = None if bbox is None else _parse_box(bbox)
        from gs_codec.codecs.part import Part
        from gs_codec.files.decode_file import decode_file

        if typed["dask"] is not None:
            typed.refuse(["max_bytes", "tmc3"], "has no effect with --dask")
            typed.refuse(["level", "view"], "has no effect with --dask, which decodes whole scenes")
            check_no_pipes("--dask", source, target)
            part = Part(box, sh_degree, budget=budget, tolerance=tolerance)
            from gs_codec.distributed.decoding import decode_distributed

            with progress_bar() as progress:
                report = decode_distributed(
                    source, target, part, dask=typed["dask"], threads=typed["threads"],
                    progress=progress, max_memory=typed["max_memory"], overwrite=typed["overwrite"],
                )  # fmt: skip
            _tell(source, target, target, typed, report)
            return
        camera = None if view is None else _camera_of(view)
        part = Part(box, sh_degree, level, camera, budget, tolerance)
        with piped([file], target, ".ply") as (_, out):
            with progress_bar() as progress:
                report = decode_file(
                    file, out, part, threads=typed["threads"], tmc3=typed["tmc3"],
                    progress=progress, max_memory=typed["max_memory"],
                    max_bytes=typed["max_bytes"], overwrite=typed["overwrite"],
                )  # fmt: skip
            _tell(source, target, out, typed, report)


def _tell(source: Path, target: Path, out: Path, typed: Typed, report: DecodeReport) -> None:
    """Print the report; `out` is the file written for the target."""
    size = out.stat().st_size
    if typed["json"]:
        shown = asdict(report)
        print_document(
            input=str(source), output=str(target), format="ply",
            input_bytes=shown.pop("file_bytes"), output_bytes=size,
            bits_per_gaussian=bits_per_gaussian(size, report.count),
            stages=shown.pop("seconds"), **shown,
        )  # fmt: skip
        return
    print_text(
        f"{target}: {counted(report.count, 'Gaussian')}, SH degree {report.sh_degree}, "
        f"{size_text(size)}, {sum(report.seconds.values()):.2f} s"
    )
    if report.bytes_read < report.file_bytes:
        share = report.bytes_read / report.file_bytes
        print_text(f"read {size_text(report.bytes_read)} of {source} ({share:.0%})")


def _camera_of(text: str) -> Camera:
    """The camera named by ``CAMERAS[:NAME]`` or, by index, ``CAMERAS:#N``."""
    from gs_codec.cameras.camera_files import read_cameras

    path, name = text, ""
    if not os.path.exists(text):
        path, _, name = text.rpartition(":")
        path, name = (path, name) if path else (text, "")
    cameras = read_cameras(path)
    found = [camera for camera in cameras if name in ("", camera.name)]
    if not found and re.fullmatch("#[0-9]{1,9}", name):
        found = cameras[int(name[1:]) :][:1]
    if len(found) != 1:
        place = cameras.index(found[0]) if found else 0
        raise InvalidInput(
            f"--view {text}: matches {len(found) or 'none'} of "
            f"{counted(len(cameras), 'camera')}, expected the name "
            f"or number of one, for example {path}:#{place} for {cameras[place].name}"
        )
    return found[0]


def _parse_box(text: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(field) for field in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != 6:
        raise InvalidInput(f"--bbox {text}: expected six numbers, x,y,z,x,y,z")
    return numbers

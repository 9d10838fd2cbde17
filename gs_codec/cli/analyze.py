"""``gs-codec analyze``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gs_codec.cli.documents import print_document
from gs_codec.cli.output import (
    SCENES,
    print_status,
    print_table,
    print_text,
    progress_bar,
)
from gs_codec.cli.typed import Typed, takes
from gs_codec.errors import InvalidInput
from gs_codec.pages.tables import Table
from gs_codec.plan import CAMERAS
from gs_codec.runtime.atomic import check_folder
from gs_codec.runtime.wording import counted


@takes("width", "error_scale", "max_bytes", "overwrite", "json")
def command(
    source: Annotated[Path, typer.Argument(metavar="SCENE", help=SCENES)],
    typed: Typed,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder for report.html, report.json and pictures; optional with --json.",
        ),
    ] = None,
    cameras: Annotated[
        str | None,
        typer.Option(metavar="C", help=f"Also measure how errors affect views: {CAMERAS}"),
    ] = None,
    sample: Annotated[
        int,
        typer.Option(metavar="N", help="Maximum number of Gaussians for the statistics.", min=2),
    ] = 200_000,
    seed: Annotated[
        int,
        typer.Option(metavar="N", help="Random seed of the sample, shuffling and noise.", min=0),
    ] = 0,
) -> None:
    """Report why coding works on a scene: correlations, distributions, entropies, sensitivities."""
    if cameras is None:
        typed.refuse(["width", "error_scale"], "needs --cameras")
    if out is not None:
        check_folder(out, typed["overwrite"])
    elif not typed["json"]:
        raise InvalidInput("missing option '--out' (folder of the report) or '--json'")
    else:
        typed.refuse(["overwrite"], "needs --out")
    from gs_codec.analysis.analysis_report import analyse_file

    with progress_bar() as progress:
        content = analyse_file(
            source, out, max_bytes=typed["max_bytes"], progress=progress,
            cameras=cameras, width=typed["width"], error_scale=typed["error_scale"],
            sample=sample, seed=seed,
        )  # fmt: skip
    for note in content["notes"]:
        print_status(note)
    if typed["json"]:
        print_document(**content | {"output": None if out is None else str(out)})
        return
    print_text(
        f"{source}: {counted(content['gaussians'], 'Gaussian')}, SH degree {content['sh_degree']}"
    )
    if content["sensitivity"]:
        ranked = ", ".join(content["sensitivity"]["most_sensitive_first"])
        print_text(f"most sensitive first: {ranked}")
    bits = content["bits_by_profile"]
    print_table(
        Table(
            ["bits per Gaussian", *bits],
            [
                [part, *(f"{of_profile[part]:.2f}" for of_profile in bits.values())]
                for part in next(iter(bits.values()))
            ],
        )
    )
    assert out is not None
    print_text(f"report: {out / 'report.html'}")

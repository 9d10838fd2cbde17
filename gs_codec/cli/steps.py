"""Options of preparation, which ``prepare`` and ``encode`` share."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any

import typer

from gs_codec.cli.output import print_table, print_text
from gs_codec.cli.views import CAMERAS, drawing_options
from gs_codec.errors import InvalidInput
from gs_codec.preparation.steps import Steps

_PANEL = {"rich_help_panel": "Preparation"}

PruneGeometry = Annotated[
    float,
    typer.Option(
        metavar="THETA2", help="Prune this percentage along each axis, farthest first.", **_PANEL
    ),
]
PruneImportance = Annotated[
    float,
    typer.Option(
        metavar="THETA1", help="Prune this percentage, least important (LightGaussian).", **_PANEL
    ),
]
PruneLoo = Annotated[
    float,
    typer.Option(
        metavar="PERCENT", help="Prune this percentage, by what views lose without each.", **_PANEL
    ),
]
MaxDrop = Annotated[
    float | None,
    typer.Option(metavar="DB", help="Prune so while views lose no more than this.", **_PANEL),
]
Optimise = Annotated[
    int, typer.Option(metavar="N", help="Refit all attributes by N iterations of Adam.", **_PANEL)
]
CompactSh = Annotated[
    float,
    typer.Option(
        metavar="STRENGTH", help="Move SH energy to fewer coefficients; 3e-5 is usual.", **_PANEL
    ),
]
RefitColour = Annotated[
    int, typer.Option(metavar="N", help="Refit SH by N conjugate-gradient steps.", **_PANEL)
]
Rectify = Annotated[
    bool, typer.Option("--rectify", help="Move SH-AC to their Laplace range.", **_PANEL)
]
Cameras = Annotated[
    str | None,
    typer.Option(metavar="C", help=f"What to prepare by: {CAMERAS}", show_default="auto", **_PANEL),
]
EncodeCameras = Annotated[
    str | None,
    typer.Option(
        metavar="C",
        help=f"What to prepare by, and to spend bits by (profiles l, m, s): {CAMERAS}",
        show_default="auto if a step is asked for, else none",
        **_PANEL,
    ),
]
AgainstGt = Annotated[
    Path | None,
    typer.Option(
        metavar="IMAGES", help="Photographs to match, instead of views of the input.", **_PANEL
    ),
]
Views = Annotated[int, typer.Option(help="Most views to work by.", **_PANEL)]
ViewWidth = Annotated[
    int | None,
    typer.Option(help="Width of the views, pixels.", show_default="the cameras'", **_PANEL),
]
Backdrop = Annotated[str, typer.Option(help="Behind the scene: black or white.", **_PANEL)]
Report = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Write report.json, ablation.md, labels.npy.", **_PANEL),
]
Checkpoint = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Keeps --optimise's state, to go on from.", **_PANEL),
]


def plan_of(options: dict[str, Any]) -> Any:
    """The plan that options of these names ask for; None if they ask for nothing."""
    steps = Steps(**{field.name: options[field.name] for field in fields(Steps)})
    if not steps.wanted:
        measured = options.get("max_psnr_drop") is not None
        for name in ("report", "checkpoint", "against_gt"):
            if options[name] and not (measured and name == "against_gt"):
                option = "--" + name.replace("_", "-")
                other = (
                    " or --max-psnr-drop"
                    if name == "against_gt" and "max_psnr_drop" in options
                    else ""
                )
                raise InvalidInput(f"{option} needs a step, for example --prune-loo 30{other}")
        given = options["cameras"] is not None or options["against_gt"] is not None
        if not (given or measured or options.get("allow_prune")):
            if options["width"] is not None:
                raise InvalidInput("--width: nothing goes by views, expected --cameras or a step")
            return None
    from gs_codec.preparation.pipeline import Plan

    return Plan(
        steps,
        options["cameras"] or "auto",
        options["against_gt"],
        options["width"],
        options["views"],
        drawing_options(options["background"], "cpu")["background"],
        options["checkpoint"],
    )


def print_steps(report: Any) -> None:
    """What went, and the ablation table."""
    for reason, number in report.removed.items():
        if number:
            print_text(f"pruned by {reason}: {number:,} of {report.steps[0].count:,}")
    columns, *rows = report.table()
    print_table(columns, rows)

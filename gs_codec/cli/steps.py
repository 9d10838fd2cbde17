"""Options of preparation, which ``prepare`` and ``encode`` share."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any

import typer

from gs_codec.cli.given import refuse_given
from gs_codec.cli.output import print_table, print_text
from gs_codec.cli.views import CAMERAS, drawing_options
from gs_codec.config import LATTICE_PROFILES
from gs_codec.preparation.steps import Steps

#: Options that say which views there are.
_OF_VIEWS = ("views", "width", "background")

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
    bool,
    typer.Option(
        "--rectify", help="Move SH-AC to the Laplace range of -p paper-* (else paper-m).", **_PANEL
    ),
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


def plan_of(ctx: typer.Context, options: dict[str, Any]) -> Any:
    """The plan that options of these names ask for; None if they ask for nothing.

    Raises
    ------
    InvalidInput
        If one of them has no effect beside the others.
    """
    steps = Steps(**{field.name: options[field.name] for field in fields(Steps)})
    if not steps.optimise:
        refuse_given(ctx, ["checkpoint"], "needs --optimise, whose state it keeps")
    if not steps.wanted and not _goes_by_views(ctx, options):
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


def _goes_by_views(ctx: typer.Context, options: dict[str, Any]) -> bool:
    """Whether coding without preparation goes by views; what has no effect is refused."""
    step = "needs a step, for example --prune-loo 30"
    refuse_given(ctx, ["report"] if options["report"] else [], step)
    measured = options.get("max_psnr_drop") is not None
    if not measured:
        other = " or --max-psnr-drop" if "max_psnr_drop" in options else ""
        refuse_given(ctx, ["against_gt"], step + other)
    profile = options.get("profile")
    if profile not in LATTICE_PROFILES:
        known = ", ".join(LATTICE_PROFILES)
        why = f"has no effect on profile '{profile}', expected {known}, or a step"
        refuse_given(ctx, ["cameras", *_OF_VIEWS], why)
    if options["cameras"] is not None or measured or options.get("allow_prune"):
        return True
    refuse_given(
        ctx, _OF_VIEWS, "has no effect: nothing goes by views, expected --cameras or a step"
    )
    return False


def print_steps(report: Any) -> None:
    """What went, and the ablation table."""
    for reason, number in report.removed.items():
        if number:
            print_text(f"pruned by {reason}: {number:,} of {report.steps[0].count:,}")
    columns, *rows = report.table()
    print_table(columns, rows)

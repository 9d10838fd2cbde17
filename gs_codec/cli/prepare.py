"""``gs-codec prepare``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gs_codec.cli import coding, steps
from gs_codec.cli.output import SCENES_PIPED, print_json, progress_bar
from gs_codec.cli.resources import MaxBytes, Overwrite
from gs_codec.cli.streams import piped_source
from gs_codec.errors import InvalidInput


def command(
    ctx: typer.Context,
    source: Annotated[Path, typer.Argument(metavar="IN", help=SCENES_PIPED)],
    target: Annotated[
        Path, typer.Argument(metavar="OUT", help="Scene to write: .ply, .egs or .splat.")
    ],
    profile: coding.Profile = "m",
    depth: coding.Depth = None,
    prune_geometry: steps.PruneGeometry = 0.0,
    prune_importance: steps.PruneImportance = 0.0,
    prune_loo: steps.PruneLoo = 0.0,
    max_drop: steps.MaxDrop = None,
    optimise: steps.Optimise = 0,
    compact_sh: steps.CompactSh = 0.0,
    refit_colour: steps.RefitColour = 0,
    rectify: steps.Rectify = False,
    cameras: steps.Cameras = None,
    against_gt: steps.AgainstGt = None,
    views: steps.Views = 64,
    width: steps.ViewWidth = None,
    background: steps.Backdrop = "black",
    report: steps.Report = None,
    checkpoint: steps.Checkpoint = None,
    max_bytes: MaxBytes = None,
    overwrite: Overwrite = False,
    json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """Make a scene smaller before it is coded: prune, refit, compact; and say what that cost."""
    config = coding.config_of(ctx, locals())
    plan = steps.plan_of(ctx, locals())
    if plan is None or not plan.steps.wanted:
        raise InvalidInput("no step of preparation asked for, for example --prune-loo 30")
    from gs_codec.files import prepare_file

    with piped_source(source) as file, progress_bar() as progress:
        done = prepare_file(file, target, plan, report, progress, overwrite, max_bytes, config)
    if json:
        print_json({"input": str(source), "output": str(target), **done.as_dict()})
    else:
        steps.print_steps(done)

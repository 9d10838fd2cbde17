"""Options that ask for a size or a quality."""

from __future__ import annotations

from typing import Annotated

import typer

from gs_codec.cli.output import print_text, size_text
from gs_codec.cli.resources import parse_size
from gs_codec.config import Target
from gs_codec.errors import InvalidInput
from gs_codec.report import RateReport

_PANEL = {"rich_help_panel": "Size or quality (one of them; profiles l, m, s)"}

TargetSize = Annotated[
    str | None,
    typer.Option(metavar="SIZE", help="At most as large as this: 5MB, 800kB, 3MiB.", **_PANEL),
]
TargetRatio = Annotated[
    float | None,
    typer.Option(
        metavar="R", help="At least so many times smaller than IN, or than its floats.", **_PANEL
    ),
]
TargetBits = Annotated[
    float | None,
    typer.Option(
        "--target-bpg", metavar="B", help="At most so many bits for each Gaussian.", **_PANEL
    ),
]
MaxPsnrDrop = Annotated[
    float | None,
    typer.Option(
        metavar="DB", help="As small as it may be if views lose no more than this.", **_PANEL
    ),
]
AllowPrune = Annotated[
    bool,
    typer.Option(
        "--allow-prune", help="For it, leave out Gaussians that views hardly miss.", **_PANEL
    ),
]


def goal_of(
    size: str | None,
    ratio: float | None,
    bits: float | None,
    psnr_drop: float | None,
    allow_prune: bool = False,
) -> Target | None:
    """What the options ask for; None if they ask for nothing."""
    if all(option is None for option in (size, ratio, bits, psnr_drop)):
        if allow_prune:
            raise InvalidInput(
                "--allow-prune needs a size or a quality, for example --target-ratio 30"
            )
        return None
    bytes_ = None if size is None else parse_size("--target-size", size)
    return Target(bytes_, ratio, bits, psnr_drop, allow_prune)


def print_rate(rate: RateReport) -> None:
    """What a target led to."""
    text = f"steps {rate.coarseness:.3f} times the profile's, after {rate.encodings} encodings"
    if rate.target.allow_prune:
        text += f"; {rate.pruned:,} Gaussians pruned"
    if rate.predicted_bytes is not None:
        text += f"; {size_text(rate.predicted_bytes)} expected"
    if rate.psnr_drop is not None:
        text += f"; views lose {rate.psnr_drop:.4f} dB, {rate.predicted_drop:.4f} dB expected"
    if rate.at_end:
        text += f"; there are no {'coarser' if rate.psnr_drop is not None else 'finer'} steps"
    print_text(text)

"""Options of coding, which ``encode``, ``batch`` and ``convert`` share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from gs_codec.cli.given import refuse_given
from gs_codec.config import DEPTH_GROUPS, PROFILE_CHOICES, PROFILES, Config
from gs_codec.errors import InvalidInput

Profile = Annotated[
    str, typer.Option("--profile", "-p", help=f"One of {', '.join(PROFILE_CHOICES)}.")
]
Depth = Annotated[
    list[str] | None,
    typer.Option(
        metavar="GROUP=BITS",
        help=f"Bits of a group ({', '.join(DEPTH_GROUPS)}, sh-ac); may be repeated.",
    ),
]
Nonfinite = Annotated[str, typer.Option(help="Gaussians with NaN or infinity: error or drop.")]
Extra = Annotated[str, typer.Option(help="Properties beyond the 3DGS layout: error, keep or drop.")]
KeepOrder = Annotated[
    bool, typer.Option("--keep-order", help="With lossless: keep the order of Gaussians too.")
]
Geometry = Annotated[
    str,
    typer.Option(
        help="What codes geometry and SH-DC of paper-*: octree (ours), gpcc (MPEG's tmc3), or "
        "auto (gpcc where tmc3 is found)."
    ),
]
Coder = Annotated[
    Path | None,
    typer.Option(
        metavar="PATH", help="G-PCC program.", show_default="GS_CODEC_TMC3, or tmc3 in PATH"
    ),
]
Verify = Annotated[
    bool, typer.Option("--verify/--no-verify", help="Decode once what tmc3 has coded.")
]

#: Fields of `Config` that are options as they are.
_PLAIN = ("profile", "nonfinite", "extra", "threads", "keep_order", "geometry", "verify")


def config_of(ctx: typer.Context, values: dict[str, Any]) -> Config:
    """The configuration of a command's parameters, by name.

    Raises
    ------
    InvalidInput
        If one is out of its range, or has no effect.
    """
    plain = {name: values[name] for name in _PLAIN if name in values}
    tool = values.get("tmc3")
    config = Config(
        **plain,
        depths=parse_depths(values["depth"] or []),
        tmc3=None if tool is None else str(tool),
    )
    if config.profile not in PROFILES:
        why = f"has no effect on profile '{config.profile}', expected one of {', '.join(PROFILES)}"
        refuse_given(ctx, ("geometry", "tmc3", "verify"), why)
    return config


def parse_depths(options: list[str]) -> dict[str, int]:
    """Depths of ``GROUP=BITS`` options."""
    depths = {}
    for option in options:
        group, _, bits = option.partition("=")
        if not (bits.isascii() and bits.isdigit() and len(bits) < 4):
            raise InvalidInput(f"--depth {option}: expected GROUP=BITS, for example sh-ac=4")
        depths[group] = int(bits)
    return depths

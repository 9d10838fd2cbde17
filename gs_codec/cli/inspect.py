"""``gs-codec inspect``."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated

import typer

from gs_codec.cli.given import refuse_given
from gs_codec.cli.output import print_json, print_table, print_text, size_text


def command(
    ctx: typer.Context,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="An .egs file.")],
    channels: Annotated[
        bool, typer.Option("--channels", help="List every channel's quantiser and model.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print everything as JSON.")] = False,
) -> None:
    """Show what an .egs file holds, from its header alone."""
    if json:
        refuse_given(ctx, ["channels"], "has no effect: --json has them anyway")
    from gs_codec.files import inspect_file

    info = inspect_file(file)
    if json:
        print_json({"file": str(file), **info.as_dict()})
        return
    low, high = (" ".join(f"{x:.6g}" for x in corner) for corner in info.bounds)
    print_text(
        f"{file}: version {info.version}, profile {info.profile}, {info.count:,} Gaussians, "
        f"SH degree {info.sh_degree}, {info.blocks} blocks of at most {info.block_size:,}",
        f"{size_text(info.file_bytes)}, {info.ratio:.2f} times smaller than the floats, "
        f"{8 * info.file_bytes / max(info.count, 1):.1f} bits per Gaussian",
        f"bounds {low} to {high}, coordinates {info.coordinates or 'not stated'}"
        f"{', antialiased' if info.antialiased else ''}",
    )
    if info.tool is not None:
        print_text(f"geometry and SH-DC: G-PCC, by '{info.tool}'")
    print_table(
        ["stream", "bytes", "bits/Gaussian", "depth", "models"],
        [_stream_row(stream, info) for stream in info.streams],
    )
    if info.skipped:
        print_text("skipped:", *(f"  {line}" for line in info.skipped))
    if channels and info.passes:
        print_table(
            ["symbols", "stream", "tables", "finest step", "coarsest step"],
            [
                [p.name, p.stream, str(p.tables), f"{p.finest_step:.4g}", f"{p.coarsest_step:.4g}"]
                for p in info.passes
            ],
        )
    elif channels:
        print_table(
            ["channel", "quantiser", "depth", "origin", "step", "model", "parameters"],
            [_channel_row(channel) for channel in info.as_dict()["channels"]],
        )


def _stream_row(stream, info) -> list[str]:
    tables = sum(p.tables for p in info.passes if p.stream == stream.name)
    if tables:
        models = f"{tables} tables"
        return [stream.name, f"{stream.bytes:,}", f"{stream.bits_per_gaussian:.3f}", "", models]
    names = ("geometry", "sh-dc") if stream.name == "gpcc" else (stream.name,)
    members = [c for c in info.channels if c.stream in names]
    depths = "/".join(str(d) for d in sorted({c.quantiser.depth for c in members}))
    kinds = Counter(
        c.model.kind if c.model else "constant" for c in members if c.model or not c.quantiser.depth
    )
    models = ", ".join(f"{number} {kind}" for kind, number in sorted(kinds.items()))
    return [stream.name, f"{stream.bytes:,}", f"{stream.bits_per_gaussian:.3f}", depths, models]


def _channel_row(channel: dict) -> list[str]:
    parameters = ", ".join(
        f"{name} {_short(value)}" for name, value in channel.get("parameters", {}).items()
    )
    numbers = [f"{channel[key]:.6g}" for key in ("depth", "origin", "step")]
    return [channel["name"], channel["quantiser"], *numbers, channel.get("model", ""), parameters]


def _short(value) -> str:
    if isinstance(value, list):
        return "/".join(f"{item:.3g}" for item in value)
    return f"{value:.4g}"

"""``gs-codec inspect``."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gs_codec.cli.asked import Asked, takes
from gs_codec.cli.output import SCENES_PIPED, print_json, print_table, print_text, size_text
from gs_codec.cli.streams import piped_source
from gs_codec.coding.extent import box_text

if TYPE_CHECKING:
    from gs_codec.codecs.inspection import Info
    from gs_codec.formats.registry import Overview


@takes("max_bytes", "json")
def command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help=SCENES_PIPED)],
    asked: Asked,
    channels: Annotated[
        bool, typer.Option("--channels", help="List every channel's quantiser and model.")
    ] = False,
) -> None:
    """Show what a file holds: an .egs from its header alone, other scenes once they are read."""
    if asked["json"]:
        asked.refuse(["channels"], "has no effect: --json has them anyway")
    from gs_codec.files.scenes import inspect_file, is_egs

    with piped_source(file) as path:
        if not is_egs(path):
            asked.refuse(["channels"], f"has no effect on {file}, expected an .egs")
            _show_other(file, path, asked["max_bytes"], asked["json"])
            return
        asked.refuse(["max_bytes"], "has no effect on an .egs, of which the header is read")
        info = inspect_file(path)
    if asked["json"]:
        print_json({"file": str(file), **info.as_dict()})
        return
    _print_info(file, info)
    if channels:
        _print_channels(info)


def _show_other(file: Path, path: Path, max_bytes: int | None, json: bool) -> None:
    """What a scene at `path`, called `file`, holds that is no .egs."""
    from gs_codec.formats.registry import overview_of

    found = overview_of(path, max_bytes)
    if json:
        print_json({"file": str(file), **found.as_dict()})
        return
    print_text(
        f"{file}: {found.format}, {found.count:,} Gaussians, SH degree {found.sh_degree}",
        f"{size_text(found.file_bytes)}, floats {size_text(found.raw_bytes)}",
        _where(found),
    )
    if found.extra:
        print_text(f"other properties: {', '.join(found.extra)}")


def _where(info: Info | Overview) -> str:
    """Bounds, and how the scene is to be drawn."""
    text = "no bounds" if info.bounds is None else box_text(info.bounds)
    antialiased = ", antialiased" if info.antialiased else ""
    return f"{text}, coordinates {info.coordinates or 'not stated'}{antialiased}"


def _print_info(file: Path, info: Info) -> None:
    needs = f" with {' and '.join(info.features)}" if info.features else ""
    print_text(
        f"{file}: version {info.version}, profile {info.profile}{needs}, {info.count:,} Gaussians, "
        f"SH degree {info.sh_degree}, {info.blocks} blocks of at most {info.block_size:,}",
        f"{size_text(info.file_bytes)}, {info.ratio:.2f} times smaller than the floats, "
        f"{8 * info.file_bytes / max(info.count, 1):.1f} bits per Gaussian",
        _where(info),
    )
    if info.tool is not None:
        print_text(f"geometry and SH-DC: G-PCC, by '{info.tool}'")
    if info.coder.startswith("torchac"):
        print_text(f"attributes: coded by '{info.coder}'")
    print_table(
        ["stream", "bytes", "bits/Gaussian", "depth", "models"],
        [_stream_row(stream, info) for stream in info.streams],
    )
    if info.skipped:
        print_text("skipped:", *(f"  {line}" for line in info.skipped))


def _print_channels(info: Info) -> None:
    if info.passes:
        print_table(
            ["symbols", "stream", "tables", "finest step", "coarsest step"],
            [
                [p.name, p.stream, str(p.tables), f"{p.finest_step:.4g}", f"{p.coarsest_step:.4g}"]
                for p in info.passes
            ],
        )
    else:
        print_table(
            ["channel", "quantiser", "depth", "origin", "step", "model", "parameters"],
            [_channel_row(channel) for channel in info.as_dict()["channels"]],
        )


def _stream_row(stream, info) -> list[str]:
    if stream.tables:
        models = f"{stream.tables} tables"
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

"""``gs-codec inspect``."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gs_codec.batch.needed_memory import needed_bytes
from gs_codec.cli.documents import print_document
from gs_codec.cli.output import (
    SCENES_PIPED,
    bars,
    print_table,
    print_text,
    progress_bar,
)
from gs_codec.cli.streams import piped_source
from gs_codec.cli.typed import Typed, takes
from gs_codec.config import EGS
from gs_codec.pages.tables import Table
from gs_codec.plan import CAMERAS
from gs_codec.report import bits_per_gaussian
from gs_codec.runtime.wording import counted, size_text

if TYPE_CHECKING:
    from gs_codec.analysis.gpu_load import GpuLoad, Verdict
    from gs_codec.codecs.inspection import Info
    from gs_codec.edit.description import AttributeStatistics, Statistics
    from gs_codec.formats.registry import Overview
    from gs_codec.scene import Scene


@takes("max_bytes", "json", hidden=["input_format"])
def command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help=SCENES_PIPED)],
    typed: Typed,
    channels: Annotated[
        bool, typer.Option("--channels", help="List the quantiser and model of every channel.")
    ] = False,
    histogram: Annotated[
        bool,
        typer.Option(
            "--histogram", help="Print statistics of every attribute; an .egs is decoded."
        ),
    ] = False,
    gpu: Annotated[
        bool,
        typer.Option(
            "--gpu",
            help="Count splats per pixel, and report which devices can show the scene; an .egs is "
            "decoded.",
        ),
    ] = False,
    cameras: Annotated[
        str, typer.Option(metavar="C", help=f"Views in which --gpu counts: {CAMERAS}")
    ] = "auto",
) -> None:
    """Show the contents of a file; only the header of an .egs is read."""
    if not gpu:
        typed.refuse(["cameras"], "needs --gpu")
    if typed["json"]:
        typed.refuse(["channels"], "has no effect with --json, which always lists channels")
    from gs_codec.cli import sequence_commands
    from gs_codec.egs.frame_sections import is_sequence
    from gs_codec.files.scenes import inspect_file, is_egs, read_scene

    with piped_source(file, typed["input_format"]) as path:
        # Of an animation in one file, those show the first frame.
        if is_sequence(path) if histogram or gpu else sequence_commands.moves(path):
            sequence_commands.inspect(file, path, typed)
            return
        if not is_egs(path):
            typed.refuse(["channels"], f"has no effect on {file}, expected an .egs")
            _show_other(file, path, typed, histogram, cameras if gpu else None)
            return
        if not (histogram or gpu):
            why = "has no effect on an .egs without --histogram or --gpu: only its header is read"
            typed.refuse(["max_bytes"], why)
        info, statistics, load = inspect_file(path), None, None
        if histogram or gpu:
            scene = read_scene(path, coordinates=None, max_bytes=typed["max_bytes"])
            statistics = _statistics_of(scene) if histogram else None
            load = _load_of(scene, cameras) if gpu else None
    if typed["json"]:
        shown = {} if statistics is None else _as_dict(statistics)
        shown |= _load_dict(load)
        _print_document(file, info, shown | {"format": EGS, "ratio": info.ratio})
        return
    _print_info(file, info)
    if channels:
        _print_channels(info)
    if statistics is not None:
        _print_statistics(statistics)
    if load is not None:
        _print_load(load)


def _load_of(scene: Scene, cameras: str) -> GpuLoad:
    """The load that a scene puts on a GPU."""
    from gs_codec.analysis.gpu_load import gpu_load
    from gs_codec.formats.coordinates import turn_axes
    from gs_codec.views.find import find_cameras

    turned = turn_axes(scene)
    with progress_bar() as progress:
        views = find_cameras(cameras, turned, progress=progress)
        return gpu_load(turned, views, progress)


def _load_dict(load: GpuLoad | None) -> dict[str, Any]:
    return {} if load is None else {"gpu": load.as_dict()}


def _print_load(load: GpuLoad) -> None:
    """Print splats per pixel, memory, and a table of devices."""
    print_text(
        "",
        f"splats per pixel: {load.mean:.1f}, 95th percentile {load.percentile_95:.0f}, in "
        f"{counted(load.views, 'view')}; {load.densest:.1f} in the densest view",
        f"GPU memory: {size_text(load.page_bytes)} in the page of `share`, "
        f"{size_text(load.float_bytes)} as floats",
    )
    columns = ["device", "can show it", "Gaussians", "fragments per second", "memory"]
    rows = [_verdict_row(one, load) for one in load.verdicts]
    print_table(Table(columns, rows, left=(0, 1)))


def _verdict_row(verdict: Verdict, load: GpuLoad) -> list[str]:
    device = verdict.device
    return [
        device.name,
        "yes" if verdict.copes else "no",
        f"{load.count / 1e6:.2f} of {device.gaussians / 1e6:.0f} million",
        f"{verdict.fragments / 1e9:.2f} of {device.fragments / 1e9:.0f} billion",
        f"{load.page_bytes / 1e6:.0f} of {device.bytes / 1e6:.0f} MB",
    ]


def _show_other(file: Path, path: Path, typed: Typed, histogram: bool, cameras: str | None) -> None:
    """Describe a scene at `path`, called `file`, that is not an .egs; `cameras` are for --gpu."""
    from gs_codec.edit.shares import shares_of
    from gs_codec.formats.registry import read_with_overview

    scene, found = read_with_overview(path, typed["max_bytes"])
    statistics = _statistics_of(scene) if histogram else None
    load = None if cameras is None else _load_of(scene, cameras)
    shares = shares_of(scene) if statistics is None else ()
    if typed["json"]:
        shown = {"shares": list(map(vars, shares))} if statistics is None else _as_dict(statistics)
        shown |= _load_dict(load)
        _print_document(file, found, shown)
        return
    print_text(
        f"{file}: {found.format}, {counted(found.count, 'Gaussian')}, SH degree {found.sh_degree}",
        f"{size_text(found.file_bytes)}, floats {size_text(found.raw_bytes)}",
        _where(found),
    )
    if some := [f"{_percent(each.share)} {each.name}" for each in shares if each.count]:
        print_text(f"of the Gaussians: {', '.join(some)}")
    if found.extra:
        print_text(f"other properties: {', '.join(found.extra)}")
    if statistics is not None:
        _print_statistics(statistics)
    if load is not None:
        _print_load(load)


def _print_document(file: Path, found: Info | Overview, shown: dict[str, Any]) -> None:
    shown = shown | found.as_dict()
    print_document(
        input=str(file), input_bytes=shown.pop("file_bytes"),
        bits_per_gaussian=bits_per_gaussian(found.file_bytes, found.count), **shown,
    )  # fmt: skip


def _statistics_of(scene: Scene) -> Statistics:
    from gs_codec.edit.description import statistics_of

    return statistics_of(scene)


def _as_dict(statistics: Statistics) -> dict[str, Any]:
    return statistics.as_dict() | {"encoding_bytes": needed_bytes(statistics.raw_bytes)}


def _print_statistics(statistics: Statistics) -> None:
    """Print tables of attributes and of shares, and the memory of a scene."""
    rows = [_attribute_row(attribute) for attribute in statistics.attributes]
    columns = ["min", "1 %", "median", "99 %", "max", "NaN", "Inf", "1 % to 99 %"]
    print_text("")
    print_table(Table(["attribute", "unit", *columns], rows, left=(0, 1, -1)))
    rows = [[s.name, f"{s.count:,}", _percent(s.share), s.rule] for s in statistics.shares]
    print_text("")
    print_table(Table(["Gaussians", "number", "share", "rule"], rows, left=(0, -1)))
    print_text(
        "",
        f"memory: {statistics.bytes_per_gaussian} bytes per Gaussian, floats "
        f"{size_text(statistics.raw_bytes)}; camera-free encoding takes up to "
        f"{size_text(needed_bytes(statistics.raw_bytes))}",
    )


def _attribute_row(found: AttributeStatistics) -> list[str]:
    values = (found.minimum, found.low, found.median, found.high, found.maximum)
    # Each character shows two bins.
    pairs = [sum(found.counts[i : i + 2]) for i in range(0, len(found.counts), 2)]
    return [
        found.name,
        found.unit.removesuffix(" units"),
        *(_number(value, found) for value in values),
        f"{found.nan:,}",
        f"{found.infinite:,}",
        bars(pairs),
    ]


def _number(value: float | None, found: AttributeStatistics) -> str:
    if value is None or found.minimum is None or found.maximum is None:
        return "-"
    if "int" in found.unit:
        return f"{value:.10g}"
    if found.name.endswith(" scale"):
        return f"{value:.3g}"
    # Values that are negligible relative to the largest are shown as 0.
    largest = max(-found.minimum, found.maximum)
    if 10 * abs(value) < largest:
        value = round(value, max(4 - math.floor(math.log10(largest)), 0)) + 0.0
    return f"{value:.4g}"


def _percent(share: float) -> str:
    """A share in percent; small ones are never shown as 0."""
    return "<0.01 %" if 0 < share < 0.00005 else f"{100 * share:.2f} %"


def _where(info: Info | Overview) -> str:
    """Bounds, coordinate system and antialiasing."""
    from gs_codec.coding.extent import box_text

    text = "no bounds" if info.bounds is None else box_text(info.bounds)
    antialiased = ", antialiased" if info.antialiased else ""
    return f"{text}, coordinates {info.coordinates or 'not stated'}{antialiased}"


def _print_info(file: Path, info: Info) -> None:
    needs = f" with {' and '.join(info.features)}" if info.features else ""
    print_text(
        f"{file}: version {info.version}, profile {info.profile}{needs}, "
        f"{counted(info.count, 'Gaussian')}, SH degree {info.sh_degree}, "
        f"{counted(info.blocks, 'block')} of at most {info.block_size:,}",
        f"{size_text(info.file_bytes)}, {info.ratio:.2f}x relative to the floats, "
        f"{8 * info.file_bytes / max(info.count, 1):.1f} bits per Gaussian",
        _where(info),
    )
    if info.tool is not None:
        print_text(f"geometry and SH-DC: G-PCC, by '{info.tool}'")
    if info.coder.startswith("torchac"):
        print_text(f"attributes: coded by '{info.coder}'")
    if info.far:
        print_text(f"far Gaussians: {info.far:,}, with exact centres")
    print_table(
        Table(
            ["stream", "bytes", "bits/Gaussian", "depth", "models"],
            [_stream_row(stream, info) for stream in info.streams],
        )
    )
    if info.levels:
        print_table(Table(
            ["level", "Gaussians", "blocks", "bytes", "smallest error", "largest error"],
            [
                [
                    str(one.level), f"{one.count:,}", f"{one.blocks:,}", f"{one.bytes:,}",
                    f"{one.least_error:.4g}", f"{one.largest_error:.4g}",
                ]
                for one in info.levels
            ],
        ))  # fmt: skip
    if info.skipped:
        print_text("skipped:", *(f"  {line}" for line in info.skipped))


def _print_channels(info: Info) -> None:
    if info.passes:
        print_table(
            Table(
                ["symbols", "stream", "tables", "finest step", "coarsest step"],
                [
                    [
                        p.name,
                        p.stream,
                        str(p.tables),
                        f"{p.finest_step:.4g}",
                        f"{p.coarsest_step:.4g}",
                    ]
                    for p in info.passes
                ],
            )
        )
    else:
        print_table(
            Table(
                ["channel", "quantiser", "depth", "origin", "step", "model", "parameters"],
                [_channel_row(channel) for channel in info.as_dict()["channels"]],
            )
        )


def _stream_row(stream, info) -> list[str]:
    if stream.tables:
        models = counted(stream.tables, "table")
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

"""``gs-codec compare``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gs_codec.cli.given import refuse_given
from gs_codec.cli.output import (
    SCENES,
    print_json,
    print_status,
    print_table,
    print_text,
    progress_bar,
)
from gs_codec.cli.resources import MaxBytes, Overwrite
from gs_codec.cli.views import CAMERAS, SPLIT, Background, Device, Width, drawing_options
from gs_codec.io.atomic import check_folder

#: Options of what is drawn.
_OF_VIEWS = (
    "images", "against_gt", "width", "split", "background", "device", "overwrite",
)  # fmt: skip

if TYPE_CHECKING:
    from gs_codec.metrics.images import Quality
    from gs_codec.metrics.views import RenderedComparison, View


def command(
    ctx: typer.Context,
    first: Annotated[Path, typer.Argument(metavar="A", help=SCENES)],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another version of it.")],
    cameras: Annotated[
        str | None, typer.Option(metavar="C", help=f"Compare what these see: {CAMERAS}")
    ] = None,
    images: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Write each view's two images, and 10 x their difference."
        ),
    ] = None,
    against_gt: Annotated[
        Path | None,
        typer.Option(metavar="IMAGES", help="Ground-truth images to measure both scenes against."),
    ] = None,
    width: Width = None,
    split: Annotated[str, typer.Option(help=SPLIT)] = "held-out",
    background: Background = "black",
    device: Device = "auto",
    max_bytes: MaxBytes = None,
    overwrite: Overwrite = False,
    json: Annotated[bool, typer.Option("--json", help="Print everything as JSON.")] = False,
) -> None:
    """Show how far two versions of a scene are apart: by attribute, or in rendered views."""
    options = drawing_options(background, device)
    if cameras is None:
        refuse_given(ctx, _OF_VIEWS, "needs --cameras")
        _compare_attributes(first, second, max_bytes, json)
        return
    if images is None:
        refuse_given(ctx, ["overwrite"], "needs --images")
    else:
        check_folder(images, overwrite)
    from gs_codec.viewing import compare

    with progress_bar() as progress:
        comparison: Any = compare(
            first, second, cameras, split=split, width=width, truth=against_gt, images=images,
            progress=progress, max_bytes=max_bytes, **options,
        )  # fmt: skip
    _say_systems(comparison.systems)
    if json:
        print_json({"a": str(first), "b": str(second), **_plain(comparison)})
    else:
        _print_views(comparison)


def _compare_attributes(first: Path, second: Path, max_bytes: int | None, json: bool) -> None:
    from gs_codec.files import compare_files

    comparison = compare_files(first, second, max_bytes)
    _say_systems(comparison.systems)
    if json:
        print_json({"a": str(first), "b": str(second), **asdict(comparison)})
        return
    print_text(f"{comparison.count:,} Gaussians, matched by {comparison.matched_by}")
    print_table(
        ["attribute", "unit", "max error", "rms error"],
        [[g.name, g.unit, f"{g.max:.6g}", f"{g.rms:.6g}"] for g in comparison.groups],
    )


def _say_systems(systems: tuple[str, str]) -> None:
    if systems[0] != systems[1]:
        print_status("coordinates {} in A, {} in B: turned to one system".format(*systems))


def _print_views(comparison: RenderedComparison) -> None:
    mean, worst = comparison.mean, comparison.worst
    with_truth, with_lpips = mean.delta is not None, mean.between.lpips is not None
    columns = ["view", "PSNR dB", "SSIM"] + ["LPIPS"] * with_lpips
    if with_truth:
        columns += ["A to truth", "B to truth", "delta-PSNR", "delta-SSIM"]
        columns += ["delta-LPIPS"] * with_lpips
    rows = [_row(view.name, view) for view in comparison.views]
    rows += [_row("mean", mean), _row(f"worst: {worst.name}", worst)]
    print_text("Gaussians: {:,} in A, {:,} in B".format(*comparison.counts))
    print_table(columns, rows)


def _row(name: str, view: View) -> list[str]:
    row = [name, *_numbers(view.between, "")]
    if view.first and view.second and view.delta:
        row += [f"{view.first.psnr:.3f}", f"{view.second.psnr:.3f}", *_numbers(view.delta, "+")]
    return row


def _numbers(quality: Quality, sign: str) -> list[str]:
    values = [f"{quality.psnr:{sign}.3f}", f"{quality.ssim:{sign}.5f}"]
    return values if quality.lpips is None else [*values, f"{quality.lpips:{sign}.5f}"]


def _plain(comparison: RenderedComparison) -> dict:
    def plain(view: View) -> dict:
        pairs = {"between": view.between, "a": view.first, "b": view.second, "delta": view.delta}
        return {"view": view.name} | {name: q.as_dict() for name, q in pairs.items() if q}

    return {
        "gaussians": comparison.counts,
        "views": [plain(view) for view in comparison.views],
        "mean": plain(comparison.mean),
        "worst": plain(comparison.worst),
        "systems": comparison.systems,
    }

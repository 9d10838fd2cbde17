"""``gs-codec compare``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
from gs_codec.pages.tables import Table
from gs_codec.plan import CAMERAS
from gs_codec.runtime.atomic import check_folder
from gs_codec.runtime.wording import counted

#: Options for rendering.
_OF_VIEWS = ("width", "split", "background", "device")

if TYPE_CHECKING:
    from gs_codec.metrics.attributes import Comparison
    from gs_codec.metrics.image_quality import Quality, View


@takes(*_OF_VIEWS, "max_bytes", "overwrite", "json", split="held-out", device="auto")
def command(
    first: Annotated[Path, typer.Argument(metavar="A", help=SCENES)],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another version of A.")],
    typed: Typed,
    cameras: Annotated[
        str | None, typer.Option(metavar="C", help=f"Compare rendered views: {CAMERAS}")
    ] = None,
    gt_images: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder of ground-truth images to measure both scenes against."
        ),
    ] = None,
    images: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder for both images of each view and 10x their difference."
        ),
    ] = None,
    lpips: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            help="Also measure LPIPS, with these weights of VGG16, AlexNet or SqueezeNet 1.1.",
            show_default="GS_CODEC_LPIPS",
        ),
    ] = None,
) -> None:
    """Compare two versions of a scene: by attribute, or in rendered views."""
    if cameras is None:
        typed.refuse((*_OF_VIEWS, "gt_images", "images", "lpips", "overwrite"), "needs --cameras")
    elif images is None:
        typed.refuse(["overwrite"], "needs --images")
    else:
        check_folder(images, typed["overwrite"])
    if cameras is None:
        from gs_codec.files.scenes import compare_files

        comparison = compare_files(first, second, max_bytes=typed["max_bytes"])
    else:
        from gs_codec.api.viewing import compare

        with progress_bar() as progress:
            drawn = {name: typed[name] for name in _OF_VIEWS}
            comparison = compare(
                first, second, cameras, gt_images=gt_images, images=images, lpips=lpips,
                progress=progress, max_bytes=typed["max_bytes"], overwrite=typed["overwrite"],
                **drawn,
            )  # fmt: skip
    _say_systems(comparison.systems)
    if typed["json"]:
        print_document(input=[str(first), str(second)], **_plain(comparison, images))
    elif comparison.views:
        _print_views(comparison)
    else:
        _print_attributes(comparison)


def _print_attributes(comparison: Comparison) -> None:
    print_text(f"{counted(comparison.counts[0], 'Gaussian')}, matched by {comparison.matched_by}")
    print_table(
        Table(
            ["attribute", "unit", "max error", "rms error"],
            [[g.name, g.unit, f"{g.max:.6g}", f"{g.rms:.6g}"] for g in comparison.groups],
        )
    )
    print_text("Errors of invisible Gaussians are included; --cameras auto compares rendered views")


def _say_systems(systems: tuple[str, str]) -> None:
    if systems[0] != systems[1]:
        print_status("coordinates {} in A, {} in B: converted to one system".format(*systems))


def _print_views(comparison: Comparison) -> None:
    mean, worst = comparison.mean, comparison.worst
    with_truth, with_lpips = mean.delta is not None, mean.between.lpips is not None
    columns = ["view", "PSNR dB", "SSIM"] + [f"LPIPS ({comparison.backbone})"] * with_lpips
    if with_truth:
        columns += ["A to truth", "B to truth", "delta-PSNR", "delta-SSIM"]
        columns += ["delta-LPIPS"] * with_lpips
    rows = [_row(view.name, view) for view in comparison.views]
    rows += [_row("mean", mean), _row(f"worst: {worst.name}", worst)]
    print_text("Gaussians: {:,} in A, {:,} in B".format(*comparison.counts))
    print_table(Table(columns, rows))


def _row(name: str, view: View) -> list[str]:
    row = [name, *_numbers(view.between, "")]
    if view.first and view.second and view.delta:
        row += [f"{view.first.psnr:.3f}", f"{view.second.psnr:.3f}", *_numbers(view.delta, "+")]
    return row


def _numbers(quality: Quality, sign: str) -> list[str]:
    values = [f"{quality.psnr:{sign}.3f}", f"{quality.ssim:{sign}.5f}"]
    return values if quality.lpips is None else [*values, f"{quality.lpips:{sign}.5f}"]


def _plain(comparison: Comparison, images: Path | None) -> dict:
    def plain(view: View) -> dict:
        pairs = {"between": view.between, "a": view.first, "b": view.second, "delta": view.delta}
        return {"view": view.name} | {name: q and q.as_dict() for name, q in pairs.items()}

    seen = bool(comparison.views)
    return {
        "output": None if images is None else str(images),
        "gaussians": comparison.counts,
        "coordinates": comparison.systems,
        "matched_by": comparison.matched_by,
        "groups": [asdict(group) for group in comparison.groups] or None,
        "views": [plain(view) for view in comparison.views] or None,
        "mean": plain(comparison.mean) if seen else None,
        "worst": plain(comparison.worst) if seen else None,
        "backbone": comparison.backbone,
    }

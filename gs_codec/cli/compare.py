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
from gs_codec.metrics.comparison import table_of
from gs_codec.plan import CAMERAS
from gs_codec.runtime.atomic import check_folder
from gs_codec.runtime.wording import counted

#: Options for rendering.
_OF_VIEWS = ("width", "split", "background", "device")

if TYPE_CHECKING:
    from gs_codec.metrics.comparison import Comparison
    from gs_codec.metrics.image_quality import View


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
    """Compare two versions of a scene: by attribute, or in rendered views.

    Both may be sequences: an .egs, a folder, a pattern or a zip. Views of each frame are compared.
    """
    from gs_codec.sequences.frame_sources import has_frames

    if has_frames(first) or has_frames(second):
        from gs_codec.cli import sequence_commands

        drawn = {name: typed[name] for name in _OF_VIEWS}
        sequence_commands.compare(first, second, typed, cameras, drawn)
        return
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
        return
    first_count, second_count = comparison.counts
    if comparison.views:
        print_text(f"Gaussians: {first_count:,} in A, {second_count:,} in B")
    else:
        print_text(f"{counted(first_count, 'Gaussian')}, matched by {comparison.matched_by}")
    print_table(table_of(comparison))
    if not comparison.views:
        hint = "--cameras auto compares rendered views"
        print_text(f"Errors of invisible Gaussians are included; {hint}")


def _say_systems(systems: tuple[str, str]) -> None:
    if systems[0] != systems[1]:
        print_status("coordinates {} in A, {} in B: converted to one system".format(*systems))


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

"""``gs-codec render``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from gs_codec.cli.documents import print_document
from gs_codec.cli.output import SCENES, print_text, progress_bar
from gs_codec.cli.typed import Typed, takes
from gs_codec.files.suffixes import check_no_source
from gs_codec.plan import CAMERAS
from gs_codec.runtime.atomic import check_folder, check_writable
from gs_codec.runtime.wording import counted


@takes(
    "width", "split", "background", "device", "max_bytes", "overwrite", "json",
    split="all", device="auto",
)  # fmt: skip
def command(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help=SCENES)],
    cameras: Annotated[str, typer.Option(metavar="C", help=f"Views to render: {CAMERAS}")],
    out: Annotated[
        Path,
        typer.Option(
            metavar="DIR", help="Folder for PNG images, or a .json file for only the cameras."
        ),
    ],
    typed: Typed,
    antialiased: Annotated[
        bool | None,
        typer.Option(
            "--antialiased/--plain",
            help="Apply Mip-Splatting's opacity compensation, or not.",
            show_default="as in the file",
        ),
    ] = None,
) -> None:
    """Render a scene from each camera as 3DGS does, or write only the cameras."""
    only_cameras = out.suffix.lower() == ".json"
    if only_cameras:
        drawing = ("background", "device", "antialiased")
        typed.refuse(drawing, f"has no effect with --out {out}, which writes only cameras")
        check_no_source([scene, cameras], out)
        check_writable(out, typed["overwrite"])
    else:
        check_folder(out, typed["overwrite"])
    from gs_codec.cameras.camera_files import write_cameras
    from gs_codec.files.scenes import read_scene
    from gs_codec.rendering.renderer import write_views
    from gs_codec.views.find import find_cameras

    loaded = read_scene(scene, "drop", max_bytes=typed["max_bytes"])
    views = find_cameras(cameras, loaded, typed["split"], typed["width"])
    if only_cameras:
        write_cameras(out, views, typed["overwrite"])
        shown, seconds = counted(len(views), "camera"), None
    else:
        start = time.perf_counter()
        with progress_bar() as progress:
            drawn = typed["background"], antialiased, typed["device"]
            write_views(loaded, views, out, *drawn, progress)
        seconds = time.perf_counter() - start
        shown = f"{counted(len(views), 'image')}, {seconds:.2f} s"
    if typed["json"]:
        print_document(
            input=str(scene), output=str(out), gaussians=loaded.count, sh_degree=loaded.sh_degree,
            seconds=seconds, views=[view.name for view in views],
        )  # fmt: skip
    else:
        print_text(f"{out}: {shown}")

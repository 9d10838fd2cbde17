"""``gs-viewer``: show one scene, or two beside each other, in a window or as a picture."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

import gs_codec
from gs_codec.cli.main import describe_error
from gs_codec.cli.output import log_to_stderr, print_status, print_text, progress_bar
from gs_codec.preparation.steps import CAMERAS
from viewer.scenes.choice import CELL_COLOURINGS, COLOURINGS, DEPTHS, LAYERS, OctreeChoice
from viewer.scenes.pose import UPS

if TYPE_CHECKING:
    from viewer.pictures.film import Film
    from viewer.scenes.request import Request

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command()
def command(
    a: Annotated[
        Path | None, typer.Argument(metavar="[A]", help="A scene.", show_default=False)
    ] = None,
    b: Annotated[
        Path | None,
        typer.Argument(metavar="[B]", help="Another version of it.", show_default=False),
    ] = None,
    cameras: Annotated[
        str | None,
        typer.Option(metavar="C", help=f"Cameras to look from: {CAMERAS}"),
    ] = None,
    gt_images: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Ground-truth images of the cameras, shown beside."),
    ] = None,
    pruned: Annotated[
        Path | None,
        typer.Option(metavar="REPORT", help="Folder that prepare --report wrote for A."),
    ] = None,
    layers: Annotated[
        str | None,
        typer.Option(
            metavar="L,...", help=f"Layers to show: {', '.join(LAYERS)}.", show_default=False
        ),
    ] = None,
    colour: Annotated[
        str, typer.Option(help=f"Colour centres by: {', '.join(COLOURINGS)}.")
    ] = "colour",
    octree_depth: Annotated[
        int, typer.Option(help=f"Depth of the octree's cells, {DEPTHS[0]}-{DEPTHS[-1]}.")
    ] = OctreeChoice.depth,
    octree_colour: Annotated[
        str, typer.Option(help=f"Colour the octree's cells by: {', '.join(CELL_COLOURINGS)}.")
    ] = OctreeChoice.colouring,
    mode: Annotated[
        str, typer.Option(help="Two scenes: side by side, wipe (one view, A left), or flip (B).")
    ] = "side",
    view: Annotated[
        int | None, typer.Option(help="Camera to begin with, from 0.", show_default=False)
    ] = None,
    up: Annotated[
        str | None,
        typer.Option(
            metavar="AXIS",
            help=f"Up axis: {', '.join(UPS)}; by default from cameras, given or estimated.",
            show_default=False,
        ),
    ] = None,
    screenshot: Annotated[
        Path | None,
        typer.Option(metavar="PNG", help="Write a picture and exit; needs no display."),
    ] = None,
    turntable: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT",
            help="Write a film once around the scene and exit: .mp4, or a folder of PNG frames.",
        ),
    ] = None,
    flythrough: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT",
            help="The same along a smooth path through --cameras, in the order of the file.",
        ),
    ] = None,
    frames: Annotated[
        int | None, typer.Option(help="Frames of a film.", show_default="180")
    ] = None,
    fps: Annotated[
        int | None, typer.Option(help="Frames a second of an .mp4 film.", show_default="24")
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an existing film.")
    ] = False,
    max_bytes: Annotated[
        int | None,
        typer.Option(
            help="Largest size of a scene's floats.", show_default="1 GiB or 1000 times the file"
        ),
    ] = None,
    width: Annotated[int, typer.Option(help="Width of the window or picture, pixels.")] = 1280,
    height: Annotated[int, typer.Option(help="Its height.")] = 800,
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    """Show a 3D Gaussian Splatting scene, or two versions of one, of any format."""
    if version:
        print_text(f"gs-viewer {gs_codec.__version__}")
        return
    from viewer.scenes.request import Request, parse_layers

    request = Request(
        a,
        b,
        cameras,
        gt_images,
        pruned,
        parse_layers(layers, pruned),
        colour,
        mode,
        view,
        (width, height),
        max_bytes,
        up,
        OctreeChoice(octree_depth, octree_colour),
    )
    request.check()
    film = _film(screenshot, turntable, flythrough, frames, fps, overwrite)
    if film is not None:
        _write_film(request, film)
        return
    if screenshot is not None:
        from viewer.pictures.screenshot import write_screenshot

        missing = write_screenshot(request, screenshot)
        if missing:
            print_status(f"gs-viewer: without a photograph: {missing}")
        return
    from viewer.window.device import find_device

    device = find_device()
    from viewer.window.viewer import run

    run(request, device)


def _film(
    screenshot: Path | None,
    turntable: Path | None,
    flythrough: Path | None,
    frames: int | None,
    fps: int | None,
    overwrite: bool,
) -> Film | None:
    """The film that was asked for, if one was; options without effect are refused."""
    outputs = {"screenshot": screenshot, "turntable": turntable, "flythrough": flythrough}
    asked = [name for name, path in outputs.items() if path is not None]
    if len(asked) > 1:
        raise gs_codec.GsCodecError(f"{asked[0]} and {asked[1]}: expected one of them")
    path = turntable or flythrough
    if path is None:
        for name, value in (("frames", frames), ("fps", fps), ("overwrite", overwrite or None)):
            if value is not None:
                raise gs_codec.GsCodecError(f"{name}: needs --turntable or --flythrough")
        return None
    from viewer.pictures.film import FRAMES, Film

    kind: Literal["turntable", "flythrough"] = "flythrough" if flythrough else "turntable"
    return Film(kind, path, FRAMES if frames is None else frames, fps, overwrite)


def _write_film(request: Request, film: Film) -> None:
    from viewer.pictures.film import write_film

    film.check(request)
    with progress_bar() as progress:
        told = write_film(request, film, progress)
    print_text(f"{film.path}: {film.frames} frames, {told}")


def main() -> None:
    """Run the command; errors of use and input exit with status 2."""
    log_to_stderr("gs-viewer")
    try:
        status = app(standalone_mode=False)
    except (gs_codec.GsCodecError, OSError, MemoryError) as error:
        print_status(f"gs-viewer: error: {describe_error(error)}")
        sys.exit(2)
    except (KeyboardInterrupt, typer.Abort):
        status = 130
    except Exception as error:
        # Usage errors of Typer; its releases define the class in different modules.
        if not hasattr(error, "format_message"):
            raise
        print_status(f"gs-viewer: error: {' '.join(error.format_message().split())}")
        sys.exit(2)
    if status == 130:
        print_status("gs-viewer: interrupted")
        sys.exit(status)

"""``gs-viewer``: show one scene, or two beside each other, in a window or as a picture."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

import gs_codec
from gs_codec.cli.output import log_to_stderr, print_status, print_text
from gs_codec.preparation.steps import CAMERAS
from viewer.scenes.choice import (
    CELL_COLOURINGS,
    COLOURINGS,
    DEPTHS,
    LAYERS,
    SCALED,
    SCALES,
    OctreeChoice,
)
from viewer.scenes.pose import UPS

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
    colour_scale: Annotated[
        str | None,
        typer.Option(
            help=f"Scale of {', '.join(SCALED)}: {', '.join(SCALES)}.",
            show_default="linear for opacity and bits",
        ),
    ] = None,
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
        colour_scale,
    )
    request.check()
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


def main() -> None:
    """Run the command; errors of use and input exit with status 2."""
    log_to_stderr("gs-viewer")
    try:
        app(standalone_mode=False)
    except (gs_codec.GsCodecError, OSError) as error:
        print_status(f"gs-viewer: error: {error}")
        sys.exit(2)
    except (KeyboardInterrupt, typer.Abort):
        print_status("gs-viewer: interrupted")
        sys.exit(130)
    except Exception as error:
        # Usage errors of Typer; its releases define the class in different modules.
        if not hasattr(error, "format_message"):
            raise
        print_status(f"gs-viewer: error: {' '.join(error.format_message().split())}")
        sys.exit(2)

"""``gs-viewer``: show one scene, or two side by side, in a window or as a picture."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from glob import has_magic
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Literal

import typer

import gs_codec
from gs_codec.cameras.up import UPS
from gs_codec.cli.command import message_of
from gs_codec.cli.main import describe_error
from gs_codec.cli.options import typed_name
from gs_codec.cli.output import SCENES, log_to_stderr, print_status, print_text, progress_bar
from gs_codec.cli.typed import is_given
from gs_codec.plan import CAMERAS
from gs_codec.runtime.optional import check_installed, is_available
from gs_codec.runtime.wording import counted
from viewer.scenes.choice import (
    CELL_COLOURINGS,
    COLOURINGS,
    DEPTHS,
    LAYERS,
    SCALED,
    SCALES,
    OctreeChoice,
)

if TYPE_CHECKING:
    from viewer.pictures.film import Film
    from viewer.scenes.view_request import Request

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


#: Panels of the help.
_INPUT = "Input"
_SHOWN = "Display"
_OUTPUT = "Pictures and films (no display needed)"
_BROWSER = "Browser instead of a window"

#: Options allowed with ``--web``: of the page, and of what it asks the server for.
_OF_PAGES = {"web", "port", "a", "b", "cameras", "max_bytes", "up", "view", "frame"}
_OF_INSPECTION = {
    "gt_images",
    "pruned",
    "layers",
    "colour",
    "colour_scale",
    "octree_depth",
    "octree_colour",
}


@app.command(epilog="Without a scene, the window opens empty. Press H in it for a list of keys.")
def command(
    ctx: typer.Context,
    a: Annotated[Path | None, typer.Argument(metavar="A", help=SCENES, show_default=False)] = None,
    b: Annotated[
        Path | None,
        typer.Argument(metavar="B", help="Another version of A.", show_default=False),
    ] = None,
    cameras: Annotated[
        str | None,
        typer.Option(metavar="C", help=f"Views to choose from: {CAMERAS}", rich_help_panel=_INPUT),
    ] = None,
    gt_images: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of the cameras' ground-truth images, shown next to the scene.",
            rich_help_panel=_INPUT,
        ),
    ] = None,
    pruned: Annotated[
        Path | None,
        typer.Option(
            metavar="REPORT",
            help="Folder that prepare --report wrote for A.",
            rich_help_panel=_INPUT,
        ),
    ] = None,
    max_bytes: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Maximum size of a scene's floats, bytes; by default 1 GiB, or 1000x the file.",
            rich_help_panel=_INPUT,
        ),
    ] = None,
    frame: Annotated[
        int | None,
        typer.Option(
            metavar="K",
            help="First frame to show of a sequence, counted from 0.",
            rich_help_panel=_SHOWN,
        ),
    ] = None,
    watch: Annotated[
        bool,
        typer.Option(
            "--watch",
            help="Reload files that change; follow iteration_7000/a.ply to iteration_30000/a.ply.",
            rich_help_panel=_INPUT,
        ),
    ] = False,
    layers: Annotated[
        str | None,
        typer.Option(
            metavar="L,...",
            help=f"Layers: {', '.join(LAYERS)}; by default splats, and pruned with --pruned.",
            rich_help_panel=_SHOWN,
        ),
    ] = None,
    colour: Annotated[
        str,
        typer.Option(
            metavar="C",
            help=f"Colour centres by: {', '.join(COLOURINGS)}.",
            rich_help_panel=_SHOWN,
        ),
    ] = "colour",
    colour_scale: Annotated[
        str | None,
        typer.Option(
            metavar="|".join(SCALES),
            help=f"Colour scale of {', '.join(SCALED)}.",
            show_default="linear for opacity and bits",
            rich_help_panel=_SHOWN,
        ),
    ] = None,
    octree_depth: Annotated[
        int,
        typer.Option(
            metavar="N",
            help=f"Depth of the octree's cells, {DEPTHS[0]}-{DEPTHS[-1]}.",
            rich_help_panel=_SHOWN,
        ),
    ] = OctreeChoice.depth,
    octree_colour: Annotated[
        str,
        typer.Option(
            metavar="C",
            help=f"Colour the octree's cells by: {', '.join(CELL_COLOURINGS)}.",
            rich_help_panel=_SHOWN,
        ),
    ] = OctreeChoice.colouring,
    mode: Annotated[
        str,
        typer.Option(
            metavar="M",
            help="Layout of two scenes: side (by side), wipe (A left of a line) or flip (B first).",
            rich_help_panel=_SHOWN,
        ),
    ] = "side",
    view: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="First camera to show, counted from 0.", rich_help_panel=_SHOWN
        ),
    ] = None,
    up: Annotated[
        str | None,
        typer.Option(
            metavar="AXIS",
            help=f"Up axis: {', '.join(UPS)}; by default from the cameras, given or estimated.",
            rich_help_panel=_SHOWN,
        ),
    ] = None,
    width: Annotated[
        int,
        typer.Option(
            metavar="N",
            help="Width of the window or picture, pixels.",
            rich_help_panel=_SHOWN,
        ),
    ] = 1280,
    height: Annotated[
        int, typer.Option(metavar="N", help="Height, pixels.", rich_help_panel=_SHOWN)
    ] = 800,
    screenshot: Annotated[
        Path | None,
        typer.Option(
            metavar="PNG",
            help="Write a picture instead of opening a window.",
            rich_help_panel=_OUTPUT,
        ),
    ] = None,
    turntable: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT",
            help="Write a film that circles the scene: .mp4, or a folder of PNG frames.",
            rich_help_panel=_OUTPUT,
        ),
    ] = None,
    flythrough: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT",
            help="Write a film of the camera path in --cameras, or through its cameras in order.",
            rich_help_panel=_OUTPUT,
        ),
    ] = None,
    frames: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Number of frames of a film; by default 180, or those of the camera path.",
            rich_help_panel=_OUTPUT,
        ),
    ] = None,
    fps: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Frames per second of an .mp4 film; by default 24, or those of the camera path.",
            rich_help_panel=_OUTPUT,
        ),
    ] = None,
    overwrite: Annotated[
        bool,
        typer.Option(
            "--overwrite", help="Overwrite an existing picture or film.", rich_help_panel=_OUTPUT
        ),
    ] = False,
    web: Annotated[
        bool,
        typer.Option(
            "--web",
            help="Show and inspect the scene in a browser, on this machine or over SSH.",
            rich_help_panel=_BROWSER,
        ),
    ] = False,
    port: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Port of the server; by default a free one.",
            rich_help_panel=_BROWSER,
        ),
    ] = None,
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    """Show a 3D Gaussian Splatting scene, or two versions of one, of any format."""
    if version:
        print_text(f"gs-viewer {gs_codec.__version__}")
        return
    if port is not None and not web:
        raise gs_codec.GsCodecError("port: needs --web")
    if web:
        _check_web(ctx, a)
    else:
        check_installed("open3d", "all but --web")
    from viewer.scenes.view_request import Request, parse_layers

    request = Request(
        a,
        b,
        cameras or ("auto" if web else None),
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
        watch,
        frame,
    )
    if web:
        asks = any(is_given(ctx, name) for name in _OF_INSPECTION)
        _serve(request, [*filter(None, (a, b))], port, asks)
        return
    request.check()
    film = _film(screenshot, turntable, flythrough, frames, fps, overwrite)
    if film is not None:
        _write_film(request, film)
        return
    if screenshot is not None:
        from viewer.pictures.screenshot import write_screenshot

        missing = write_screenshot(request, screenshot, overwrite)
        if missing:
            print_status(f"gs-viewer: no photograph of {missing}")
        return
    for source in filter(None, (a, b)):
        if not has_magic(str(source)):
            source.stat()  # report a missing scene before looking for a display
    from viewer.window.display import find_device

    device = find_device()
    _leave_out_plotly()
    from viewer.window.main_window import run

    run(request, device)


def _check_web(ctx: typer.Context, a: Path | None) -> None:
    """Reject options that have no effect on a page, or a missing scene."""
    for name in ctx.params:
        if name not in _OF_PAGES | _OF_INSPECTION and is_given(ctx, name):
            raise gs_codec.GsCodecError(f"{typed_name(name)}: has no effect on --web")
    if a is None:
        raise gs_codec.GsCodecError("web: needs a scene")


def _serve(request: Request, sources: Sequence[Path], port: int | None, asks: bool) -> None:
    """Show a page in a browser; `asks` says whether options of its inspection are given."""
    from viewer.served import serve

    request.check_picture("page")
    inspector = None
    if asks:
        check_installed("open3d", "inspection")
    if is_available("open3d"):
        from viewer.inspector import Inspector

        inspector = Inspector(request)
    with progress_bar() as progress:
        if inspector is not None and asks:
            inspector.open(progress)
        page = serve(sources, request, port, progress, inspector)
    page.run()


def _leave_out_plotly() -> None:
    """Keep Open3D from importing Plotly and Dash, the slowest of its imports."""
    name, module = "open3d.visualization.draw_plotly", ModuleType("draw_plotly")
    for each in ("get_plotly_fig", "draw_plotly", "draw_plotly_server"):
        setattr(module, each, None)
    sys.modules.setdefault(name, module)


def _film(
    screenshot: Path | None,
    turntable: Path | None,
    flythrough: Path | None,
    frames: int | None,
    fps: int | None,
    overwrite: bool,
) -> Film | None:
    """The requested film, if any; rejects options that have no effect."""
    outputs = {"screenshot": screenshot, "turntable": turntable, "flythrough": flythrough}
    given = [name for name, path in outputs.items() if path is not None]
    if len(given) > 1:
        raise gs_codec.GsCodecError(f"{given[0]} and {given[1]} cannot be combined")
    if overwrite and not given:
        raise gs_codec.GsCodecError("overwrite: needs --screenshot, --turntable or --flythrough")
    path = turntable or flythrough
    if path is None:
        for name, value in (("frames", frames), ("fps", fps)):
            if value is not None:
                raise gs_codec.GsCodecError(f"{name}: needs --turntable or --flythrough")
        return None
    from viewer.pictures.film import Film

    kind: Literal["turntable", "flythrough"] = "flythrough" if flythrough else "turntable"
    return Film(kind, path, frames, fps, overwrite)


def _write_film(request: Request, film: Film) -> None:
    from viewer.pictures.film import write_film

    with progress_bar() as progress:
        count, described = write_film(request, film, progress)
    print_text(f"{film.path}: {counted(count, 'frame')}, {described}")


def main() -> None:
    """Run the command; input and usage errors exit with status 2."""
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
        print_status(f"gs-viewer: error: {message_of(error)}")
        sys.exit(2)
    if status == 130:
        print_status("gs-viewer: interrupted")
        sys.exit(status)

"""``gs-codec share``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from gs_codec.cli.documents import print_document
from gs_codec.cli.output import SCENES, print_rendered, print_text, progress_bar
from gs_codec.cli.typed import Typed, takes
from gs_codec.config import UP_AXES
from gs_codec.plan import CAMERAS
from gs_codec.runtime.wording import size_text


@takes("max_bytes", "overwrite", "json")
def command(
    first: Annotated[Path, typer.Argument(metavar="A", help=SCENES)],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            metavar="OUT",
            help="A .html file that contains everything, or a folder for a web server.",
        ),
    ],
    typed: Typed,
    second: Annotated[
        Path | None,
        typer.Argument(metavar="[B]", help="Another version of A.", show_default=False),
    ] = None,
    cameras: Annotated[
        str, typer.Option(metavar="C", help=f"Views to choose from: {CAMERAS}")
    ] = "auto",
    up: Annotated[
        str | None,
        typer.Option(
            metavar="AXIS",
            help=f"Up axis: {', '.join(UP_AXES)}; by default from the cameras, given or estimated.",
        ),
    ] = None,
    annotations: Annotated[
        Path | None,
        typer.Option(metavar="JSON", help="Points with titles and texts, which the page shows."),
    ] = None,
    tour: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH", help="A camera path for a tour; by default through the views."
        ),
    ] = None,
    title: Annotated[
        str | None,
        typer.Option(metavar="TEXT", help="Title; by default the names of the scenes."),
    ] = None,
    url: Annotated[
        str | None,
        typer.Option(
            "--url", metavar="URL", help="Address of the page on the web, for previews of links."
        ),
    ] = None,
    embed: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ORIGIN",
            help="Site whose pages may control this one: https://example.org, or * for any.",
        ),
    ] = None,
) -> None:
    """Write a web page that shows a scene, or compares two, in any browser."""
    from gs_codec.files.sharing import Publication, share

    publication = Publication(title, url, tuple(embed or ()))
    sources = [first] if second is None else [first, second]
    with progress_bar() as progress:
        shared = share(
            sources, out, cameras, progress=progress, max_bytes=typed["max_bytes"],
            overwrite=typed["overwrite"], up=up, annotations=annotations, tour=tour,
            publication=publication,
        )  # fmt: skip
    if typed["json"]:
        scenes = [
            {"name": one.name, "bytes": len(one.data), "encoded": one.encoded,
             "rendered": one.rendered and asdict(one.rendered)}
            for one in shared
        ]  # fmt: skip
        print_document(input=list(map(str, sources)), output=str(out), scenes=scenes)
        return
    for one in shared:
        how = ", encoded for the page by profile l" if one.encoded else ""
        print_text(f"{out}: {one.name}, {size_text(len(one.data))}{how}")
        if one.encoded:
            print_rendered(one.rendered)

"""Scenes in a notebook: the page of ``gs-codec share``, in a frame."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from gs_codec.errors import GsCodecError, InvalidInput
from gs_codec.files.sharing import PAGE, page_of
from gs_codec.formats.cloud import from_cloud
from gs_codec.formats.coordinates import turn_axes
from gs_codec.runtime.arguments import checked
from gs_codec.runtime.wording import counted, size_text
from gs_codec.scene import Scene

if TYPE_CHECKING:
    from IPython.core.interactiveshell import InteractiveShell
    from open3d.pybind.t.geometry import PointCloud

log = logging.getLogger(__name__)

#: Maximum bytes of a page, all of which a notebook's file keeps.
_MOST = 50_000_000

#: Clouds with more Gaussians do not show themselves, because they are encoded for that.
_GAUSSIANS = 1_000_000


@dataclass(frozen=True)
class Embedded:
    """A page with scenes, which notebooks display.

    Attributes
    ----------
    page : str
        The page, complete in itself.
    height : int
        Height of its frame, pixels.

    Examples
    --------
    >>> with open("page.html", "w") as file:
    ...     written = file.write(viewer.embed("scene.ply").page)
    """

    page: str = field(repr=False)
    height: int

    def _repr_html_(self) -> str:
        # The frame's scripts cannot reach the notebook.
        return (
            f'<iframe title="scene" sandbox="allow-scripts allow-downloads" width="100%" '
            f'height="{self.height}" style="border:0" srcdoc="{escape(self.page)}"></iframe>'
        )


@checked
def embed(
    *scenes: PointCloud | str | Path,
    cameras: str | Path = "auto",
    up: str | None = None,
    height: int = 480,
) -> Embedded:
    """Show one scene, or compare two versions of one, in a notebook.

    As the last value of a cell, the result is displayed as the page of ``gs-codec share``. The
    notebook's file contains it, so it is also shown where only the notebook is.

    Parameters
    ----------
    *scenes : open3d.t.geometry.PointCloud, or path
        One or two clouds or files. All but `.egs` files are encoded with profile `l`.
    cameras : str or Path
        Views to choose from, as in `gs_codec.render`.
    up : {"-y", "y", "-z", "z", "-x", "x"}, optional
        Up axis; by default from the cameras, given or estimated.
    height : int
        Height of the frame, 200-4000 pixels.

    Returns
    -------
    Embedded
        Its attribute `page` is the page's HTML.

    Raises
    ------
    gs_codec.GsCodecError
        If a scene cannot be read or encoded, or the page has more than 50 MB.

    Examples
    --------
    >>> shown = viewer.embed("scene.ply", "scene.egs", cameras="cameras.json")
    """
    if not 1 <= len(scenes) <= 2:
        raise InvalidInput(f"embed: {counted(len(scenes), 'scene')}, expected one or two")
    if not 200 <= height <= 4000:
        raise InvalidInput(f"height {height}: expected 200 to 4000")
    sources = [each if isinstance(each, str | Path) else _scene_of(each) for each in scenes]
    page = page_of(sources, cameras, alone=True, up=up)[1][PAGE]
    if len(page) > _MOST:
        raise InvalidInput(
            f"embed: a page of {size_text(len(page))}, expected at most {size_text(_MOST)}; "
            f"`gs-codec share` writes it to a file"
        )
    return Embedded(page.decode(), height)


def _scene_of(cloud: PointCloud) -> Scene:
    return turn_axes(from_cloud(cloud, "drop"))


def load_ipython_extension(shell: InteractiveShell) -> None:
    """Let clouds with the attributes of Gaussians show themselves: ``%load_ext viewer``."""
    import open3d

    if shell.display_formatter is not None:
        formatter = shell.display_formatter.formatters["text/html"]
        formatter.for_type(open3d.t.geometry.PointCloud, _shown)


def _shown(cloud: PointCloud) -> str | None:
    """The page of a cloud; None for other clouds, and those that take long or cannot be encoded."""
    if "f_dc" not in cloud.point or len(cloud.point.positions) > _GAUSSIANS:
        return None
    try:
        return embed(cloud)._repr_html_()
    except GsCodecError as error:
        log.warning("the cloud is not shown: %s", error)
        return None

"""What other programs show of a link to a page: its title, a description, a picture."""

from __future__ import annotations

import html
import io
import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera, facing
from gs_codec.rendering.renderer import render
from gs_codec.scene import Scene

#: Name of the picture among a page's files.
PICTURE = "preview.jpg"

#: Its width in pixels, and the smallest and largest ratio of width to height that most programs
#: show whole.
_WIDTH, _RATIOS = 1200, (1.0, 1.91)

#: Half the width of the line between two scenes, pixels.
_LINE = 2

_QUALITY = 85


def picture_of(scenes: Sequence[Scene], view: Camera, up: NDArray | None = None) -> bytes:
    """A JPEG of what a page shows first: one scene, or the halves of two on either side of a line.

    Parameters
    ----------
    scenes : sequence of Scene
        One or two.
    view : Camera
        Its frame fills the picture, which is square at least: outside, scenes are seldom complete.
    up : ndarray, shape (3,), optional
        The direction that is up in the picture; by default that of the view.
    """
    from PIL import Image

    camera = _framed(view)
    if up is not None:
        camera = replace(camera, rotation=facing(camera.rotation[2], up))
    images = [render(scene, camera, device="cpu").colour for scene in scenes]
    shown = images[0]
    if len(images) == 2:
        middle = _WIDTH // 2
        shown = np.concatenate([images[0][:, :middle], images[1][:, middle:]], axis=1)
        shown[:, middle - _LINE : middle + _LINE] = 1
    levels = np.round(255 * np.clip(shown, 0, 1)).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(levels).save(file, "JPEG", quality=_QUALITY)
    return file.getvalue()


def _framed(view: Camera) -> Camera:
    """The view, cut to a picture's shape about the middle of its frame."""
    ratio = np.clip(view.width / view.height, *_RATIOS)
    height = round(_WIDTH / ratio)
    scale = max(_WIDTH / view.width, height / view.height)
    camera = view.resized(*(round(scale * side) for side in (view.width, view.height)))
    return replace(
        camera,
        width=_WIDTH,
        height=height,
        cx=camera.cx + (_WIDTH - camera.width) / 2,
        cy=camera.cy + (height - camera.height) / 2,
        lens=None,
    )


def tags_of(title: str, description: str, url: str | None, view: Camera | None) -> str:
    """Elements of a page's head (Open Graph protocol, https://ogp.me).

    Parameters
    ----------
    title, description : str
    url : str, optional
        Address of the page; some programs show the picture only if it is stated.
    view : Camera, optional
        The view that `PICTURE` beside the page shows; None if there is no picture.
    """
    tags = {"og:type": "website", "og:title": title, "og:description": description}
    if url is not None:
        tags["og:url"] = url
    if view is not None:
        framed = _framed(view)
        folder = "" if url is None else re.split("[?#]", url)[0].rpartition("/")[0] + "/"
        tags |= {"og:image": folder + PICTURE, "og:image:alt": title}
        tags |= {"og:image:width": str(framed.width), "og:image:height": str(framed.height)}
        tags["twitter:card"] = "summary_large_image"
    lines = [f'<meta name="description" content="{html.escape(description)}">\n']
    for name, value in tags.items():
        key = "name" if name.startswith("twitter") else "property"
        lines.append(f'<meta {key}="{name}" content="{html.escape(value)}">\n')
    return "".join(lines)

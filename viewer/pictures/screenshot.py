"""Write a picture of the window's contents, without a window."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import gs_codec
from gs_codec.cameras.image_files import find_image
from gs_codec.runtime.atomic import atomic_writer, check_writable
from gs_codec.views.photographs import read_photograph
from viewer.pictures.drawer import Drawer, measure
from viewer.pictures.layers import Legend
from viewer.pictures.picture import (
    Shown,
    caption_lines,
    draw_scene,
    from_pillow,
    labelled,
    outlined,
    side_by_side,
    to_pillow,
    wipe_line,
    wiped,
    write_reasons,
)
from viewer.scenes.edits import Edits
from viewer.scenes.opened import Opened
from viewer.scenes.pose import Pose
from viewer.scenes.view_request import Request, find_pruned, find_views, first_view
from viewer.scenes.viewpoints import find_viewpoints


def write_screenshot(request: Request, path: Path, overwrite: bool) -> str:
    """Draw a request and write the picture; return a message if a photograph is missing, or "".

    Parameters
    ----------
    request : Request
    path : Path
    overwrite : bool
        Whether to replace an existing picture.

    Raises
    ------
    gs_codec.GsCodecError
    """
    request.check_picture("screenshot")
    if path.suffix.lower() != ".png":
        raise gs_codec.GsCodecError(f"{path}: expected .png")
    check_writable(path, overwrite)
    picture, missing = draw_request(request)
    save_picture(picture, path)
    return missing


def save_picture(picture: Image.Image, path: Path) -> None:
    """Write a picture as a PNG, atomically."""
    with atomic_writer(path) as file:
        picture.save(file, "PNG")


def shown_of(request: Request, scenes: Sequence[Opened]) -> Shown:
    """Drawing settings of a request whose scenes are open."""
    pruned, scale = find_pruned(request, scenes[0]), request.scale
    drawn = {scene: Edits(scene).drawn for scene in scenes if scene.hidden is not None}
    return Shown(
        request.layers, request.colouring, tuple(scenes), pruned, request.octree, scale=scale,
        drawn={scene: mask for scene, mask in drawn.items() if mask is not None},
    )  # fmt: skip


def draw_request(request: Request) -> tuple[Image.Image, str]:
    """The requested picture, and a message if a photograph is missing, or ""."""
    scenes = request.scenes()
    views = find_views(request, scenes[0])
    viewpoints = find_viewpoints(scenes[0], views, request.up or views.ups[0])
    viewpoint = viewpoints[first_view(request, views)]
    shown = shown_of(request, scenes)
    photograph, missing = None, ""
    if request.images is not None and viewpoint.camera is not None:
        try:
            path = find_image(request.images, viewpoint.name)
        except gs_codec.GsCodecError as error:
            missing = str(error)
        else:
            _, photograph = read_photograph(viewpoint.camera, path)
    return compose(viewpoint.pose, shown, request.mode, 0.5, request.size, photograph), missing


def compose(
    pose: Pose,
    shown: Shown,
    mode: str,
    wipe: float,
    size: tuple[int, int],
    photograph: NDArray[np.float32] | None = None,
    front: int = 1,
    views: dict[Opened, Drawer] | None = None,
) -> Image.Image:
    """Draw one or two labelled scenes, with the photograph next to them.

    Parameters
    ----------
    pose : Pose
    shown : Shown
    mode : {"side", "wipe", "flip"}
    wipe : float, 0-1
        Position of the wipe line.
    size : tuple of two int
        Width and height of the whole picture, pixels.
    photograph : ndarray, shape (H, W, 3), float32, 0-1, optional
    front : {0, 1}
        Index of the scene that ``flip`` shows.
    views : dict, optional
        Drawers of the scenes, reused for further pictures.
    """
    width, height = size
    scenes = shown.scenes
    panes = 1 if mode != "side" else len(scenes)
    panes += photograph is not None
    width = (width - 2 * (panes - 1)) // panes
    views = {} if views is None else views
    drawn = [draw_scene(scene, pose, width, height, shown, views) for scene in scenes]
    labels = shown.captions
    if len(scenes) > 1:
        drawn = [(outlined(image, pose), legends) for image, legends in drawn]
        wide, high = pose.measured
        labels[1] += f"\n{measure(views, scenes, pose)} in the frame, {wide}x{high}"
    parts = _arrange(drawn, labels, mode, wipe, front)
    has_first = mode != "flip" or len(scenes) < 2 or front == 0
    if shown.pruned is not None and "pruned" in shown.layers and has_first:
        wide = wipe_line(wipe, width)[1] if mode == "wipe" and len(scenes) > 1 else width
        below = len(caption_lines(labels[0], wide))
        write_reasons(parts[0], shown.pruned.of(shown.scenes[0]), below)
    if photograph is not None:
        parts.append(labelled(_fitted(photograph, width, height), [(0, "photograph")], []))
    return to_pillow(side_by_side([from_pillow(part) for part in parts]))


def _arrange(
    drawn: list[tuple[NDArray, list[Legend]]],
    labels: list[str],
    mode: str,
    wipe: float,
    front: int,
) -> list[Image.Image]:
    """The labelled picture of each pane."""
    if len(drawn) > 1 and mode == "wipe":
        image = wiped(drawn[0][0], drawn[1][0], wipe)
        _, right = wipe_line(wipe, image.shape[1])
        legends = list(dict.fromkeys([*drawn[0][1], *drawn[1][1]]))
        return [labelled(image, [(0, labels[0]), (right, labels[1])], legends)]
    if len(drawn) > 1 and mode == "flip":
        drawn, labels = [drawn[front]], [labels[front]]
    return [
        labelled(image, [(0, label)], legends)
        for (image, legends), label in zip(drawn, labels, strict=True)
    ]


def _fitted(image: NDArray, width: int, height: int) -> NDArray[np.float32]:
    """An image scaled to fit this size, and centred."""
    scale = min(width / image.shape[1], height / image.shape[0])
    size = max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale))
    resized = to_pillow(image).resize(size, Image.Resampling.LANCZOS)
    canvas = Image.new("RGB", (width, height))
    canvas.paste(resized, ((width - size[0]) // 2, (height - size[1]) // 2))
    return from_pillow(canvas)

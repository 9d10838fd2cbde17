"""The window's picture without a window."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import gs_codec
from viewer.layers import Legend
from viewer.numbers import quality_text
from viewer.opened import Opened
from viewer.photograph import find_photograph
from viewer.picture import (
    Shown,
    draw_scene,
    from_pillow,
    labelled,
    side_by_side,
    splats,
    to_pillow,
    wiped,
    write_reasons,
)
from viewer.pose import Pose, of_camera
from viewer.request import Request, find_pruned, find_views


def write_screenshot(request: Request, path: Path) -> None:
    """Draw what is asked for and write it.

    Raises
    ------
    gs_codec.GsCodecError
    """
    save_picture(draw_request(request), path)


def save_picture(picture: Image.Image, path: Path) -> None:
    """Write a picture as a PNG, which appears whole or not at all."""
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        picture.save(partial, "PNG")
        os.replace(partial, path)
    except OSError as error:
        raise gs_codec.GsCodecError(f"{path}: {error.strerror or error}") from error
    finally:
        partial.unlink(missing_ok=True)


def draw_request(request: Request) -> Image.Image:
    """The picture that is asked for."""
    scenes = request.scenes()
    if not scenes:
        raise gs_codec.GsCodecError("screenshot: no scene to draw")
    first = scenes[0]
    cameras = find_views(replace(request, cameras=request.cameras or "auto"), first)
    number = request.view or 0
    pose = of_camera(cameras[number])
    pruned = find_pruned(request, first)
    shown = Shown(
        request.layers,
        request.colouring,
        first if len(scenes) > 1 else None,
        pruned,
        first if pruned is not None else None,
    )
    photograph = None
    if request.images is not None:
        photograph = find_photograph(request.images, cameras[number].name)
    return compose(scenes, pose, shown, request.mode, 0.5, request.size, photograph)


def compose(
    scenes: Sequence[Opened],
    pose: Pose,
    shown: Shown,
    mode: str,
    place: float,
    size: tuple[int, int],
    photograph: NDArray[np.uint8] | None = None,
) -> Image.Image:
    """One or two scenes, labelled, with the photograph beside them.

    Parameters
    ----------
    scenes : sequence of Opened
    pose : Pose
    shown : Shown
    mode : {"side", "wipe", "flip"}
    place : float, 0-1
        Where a wipe is.
    size : tuple of two int
        Width and height of it all, pixels.
    photograph : ndarray, shape (H, W, 3), uint8, optional
    """
    width, height = size
    panes = 1 if mode != "side" else len(scenes)
    panes += photograph is not None
    width = (width - 2 * (panes - 1)) // panes
    views: dict[Opened, Any] = {}
    drawn = [draw_scene(scene, pose, width, height, shown, views) for scene in scenes]
    captions = [scene.name for scene in scenes]
    if len(scenes) > 1:
        own = [splats(views, scene, pose, width, height) for scene in scenes]
        captions[1] += f": {quality_text(gs_codec.compare(*own))} against {captions[0]}"
    parts = _arrange(drawn, captions, mode, place)
    if shown.pruned is not None and "pruned" in shown.layers:
        write_reasons(parts[0], shown.pruned)
    if photograph is not None:
        parts.append(labelled(_fitted(photograph, width, height), "photograph", []))
    return to_pillow(side_by_side([from_pillow(part) for part in parts]))


def _arrange(
    drawn: list[tuple[NDArray, list[Legend]]], captions: list[str], mode: str, place: float
) -> list[Image.Image]:
    """Each pane, labelled."""
    if len(drawn) > 1 and mode == "wipe":
        image = wiped(drawn[0][0], drawn[1][0], place)
        return [labelled(image, f"{captions[0]} | {captions[1]}", drawn[1][1])]
    if len(drawn) > 1 and mode == "flip":
        drawn, captions = drawn[1:], captions[1:]
    return [
        labelled(image, caption, legends)
        for (image, legends), caption in zip(drawn, captions, strict=True)
    ]


def _fitted(image: NDArray, width: int, height: int) -> NDArray[np.float32]:
    """An image as large as fits, in the middle of a picture of this size."""
    scale = min(width / image.shape[1], height / image.shape[0])
    size = max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale))
    resized = Image.fromarray(image).resize(size, Image.Resampling.LANCZOS)
    canvas = Image.new("RGB", (width, height))
    canvas.paste(resized, ((width - size[0]) // 2, (height - size[1]) // 2))
    return from_pillow(canvas)

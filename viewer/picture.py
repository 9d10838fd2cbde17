"""Pictures without a display: what the window shows, drawn in software."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

import gs_codec
from viewer.layers import (
    BOX_COLOUR,
    Legend,
    Points,
    box_lines,
    centres,
    error_image,
    heat_bar,
    pruned_centres,
    reason_colour,
)
from viewer.opened import Opened, Pruned
from viewer.pose import Pose

#: Side of a centre, pixels.
POINT_SIZE = 2
PRUNED_SIZE = 3

#: What is nearer than this to the camera is not drawn, scene units.
_NEAR = 1e-3

#: RGB where nothing is.
BACKGROUND = (0.07, 0.07, 0.08)
_TEXT = 13


@dataclass(frozen=True)
class Shown:
    """What is to be seen of a scene, or of two.

    Attributes
    ----------
    layers : collection of str
        Of `LAYERS`.
    colouring : str
        Of `COLOURINGS`.
    reference : Opened or None
        What errors are measured against.
    pruned : Pruned or None
    pruned_of : Opened or None
        The scene that the pruned ones were in.
    """

    layers: Collection[str]
    colouring: str = "colour"
    reference: Opened | None = None
    pruned: Pruned | None = None
    pruned_of: Opened | None = None


def draw_scene(
    scene: Opened, pose: Pose, width: int, height: int, shown: Shown, views: dict[Opened, Any]
) -> tuple[NDArray[np.float32], list[Legend]]:
    """One scene's picture ``(H, W, 3)``, 0-1, and the legends of what is in it.

    Raises
    ------
    gs_codec.GsCodecError
    """
    legends = []
    image = np.empty((height, width, 3), np.float32)
    image[:] = BACKGROUND
    reference = shown.reference
    if "error" in shown.layers and reference is not None and reference is not scene:
        known, own = (splats(views, each, pose, width, height) for each in (reference, scene))
        image, legend = error_image(known, own)
        legends.append(legend)
    elif "splats" in shown.layers or "error" in shown.layers:
        image = np.clip(splats(views, scene, pose, width, height), 0, 1)
    if "centres" in shown.layers:
        points = centres(scene, shown.colouring, shown.reference)
        draw_points(image, points, pose, POINT_SIZE)
        if points.legend is not None:
            legends.append(points.legend)
    if "pruned" in shown.layers and shown.pruned is not None and shown.pruned_of is not None:
        points = pruned_centres(shown.pruned_of, shown.pruned)
        draw_points(image, points, pose, PRUNED_SIZE)
    if "boxes" in shown.layers:
        image = draw_boxes(image, scene.blocks, pose)
    return image, legends


def splats(
    views: dict[Opened, Any], scene: Opened, pose: Pose, width: int, height: int
) -> NDArray[np.float32]:
    """What the rasteriser draws of a scene; `views` keeps how, and the last picture of each."""
    camera = pose.camera(width, height)
    renderer, drawn, image = views.get(scene, (None, None, None))
    if drawn != camera:
        renderer = renderer or gs_codec.render(scene.cloud, [camera])
        image = renderer.draw(camera).colour
        views[scene] = renderer, camera, image
    return image


def draw_points(image: NDArray, points: Points, pose: Pose, size: int) -> None:
    """Draw squares of `size` pixels into an image, the nearest over the others."""
    height, width = image.shape[:2]
    places, depth = pose.project(points.positions, width, height)
    inside = (depth > _NEAR) & np.all((places > -size) & (places < (width, height)), axis=1)
    order = np.flatnonzero(inside)[np.argsort(-depth[inside], kind="stable")]
    corner = np.floor(places[order] - (size - 1) / 2).astype(np.int64)
    offsets = np.stack(np.meshgrid(np.arange(size), np.arange(size)), axis=-1).reshape(-1, 2)
    columns, rows = (corner[:, None] + offsets).reshape(-1, 2).T
    within = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    # Of several that fall on a pixel the last one, which is the nearest, stays.
    pixels = (rows * width + columns)[within]
    last = len(pixels) - 1 - np.unique(pixels[::-1], return_index=True)[1]
    sources = order.repeat(size * size)[within][last]
    image.reshape(-1, 3)[pixels[last]] = points.colours[sources]


def draw_boxes(image: NDArray, boxes: NDArray, pose: Pose) -> NDArray[np.float32]:
    """The image with the edges of boxes ``(n, 2, 3)``."""
    height, width = image.shape[:2]
    corners, lines = box_lines(boxes)
    canvas = to_pillow(image)
    pen = ImageDraw.Draw(canvas)
    before = pose.rotation @ (corners - pose.position).T
    for a, b in lines:
        ends = _clipped(before[:, a], before[:, b])
        if ends is not None:
            world = np.stack(ends) @ pose.rotation + pose.position
            places, _ = pose.project(world, width, height)
            pen.line([tuple(np.clip(p, -1e6, 1e6)) for p in places], fill=_bytes(BOX_COLOUR))
    return from_pillow(canvas)


def _clipped(a: NDArray, b: NDArray) -> tuple[NDArray, NDArray] | None:
    """The part of a line that is before the camera."""
    if a[2] < _NEAR and b[2] < _NEAR:
        return None
    if a[2] < _NEAR:
        a = b + (a - b) * (b[2] - _NEAR) / (b[2] - a[2])
    elif b[2] < _NEAR:
        b = a + (b - a) * (a[2] - _NEAR) / (a[2] - b[2])
    return a, b


def side_by_side(images: Sequence[NDArray]) -> NDArray[np.float32]:
    """Images of one height beside each other, with a line between."""
    line = np.full((images[0].shape[0], 2, 3), 0.5, np.float32)
    parts: list[NDArray] = []
    for image in images:
        parts += [line, image] if parts else [image]
    return np.concatenate(parts, axis=1)


def wiped(first: NDArray, second: NDArray, place: float) -> NDArray[np.float32]:
    """The first image left of a place (0-1), the second right of it, and a line between."""
    column = round(place * first.shape[1])
    image = np.concatenate([first[:, :column], second[:, column:]], axis=1)
    image[:, max(column - 1, 0) : column + 1] = 1.0
    return image


def labelled(image: NDArray, caption: str, legends: Sequence[Legend]) -> Image.Image:
    """The image with a caption in its upper left corner, and legends in its lower one."""
    canvas = to_pillow(image)
    pen = ImageDraw.Draw(canvas)
    font = ImageFont.load_default(_TEXT)
    _write(pen, (8, 6), caption, font)
    bottom = canvas.height - 10
    for legend in reversed(legends):
        canvas.paste(to_pillow(heat_bar(160, 10)), (8, bottom - 10))
        _write(pen, (174, bottom - 14), f"{legend.low} to {legend.high}: {legend.title}", font)
        bottom -= 22
    return canvas


def reasons_text(pruned: Pruned) -> list[tuple[str, tuple[float, float, float]]]:
    """A line for each reason something was pruned for, and its colour."""
    found = enumerate(pruned.counts.items())
    return [(f"{n:,} by {reason}", reason_colour(k)) for k, (reason, n) in found if n]


def write_reasons(canvas: Image.Image, pruned: Pruned) -> None:
    """Write into the upper left corner, below the caption, what was pruned for which reason."""
    pen, font = ImageDraw.Draw(canvas), ImageFont.load_default(_TEXT)
    for row, (text, colour) in enumerate(reasons_text(pruned)):
        top = 26 + 18 * row
        pen.rectangle((8, top + 3, 18, top + 13), fill=_bytes(colour))
        _write(pen, (24, top), text, font)


def _write(pen: ImageDraw.ImageDraw, place: tuple[int, int], text: str, font: Any) -> None:
    pen.text(place, text, (255, 255, 255), font, stroke_width=2, stroke_fill=(0, 0, 0))


def _bytes(colour: tuple[float, float, float]) -> tuple[int, ...]:
    return tuple(round(255 * c) for c in colour)


def to_pillow(image: NDArray) -> Image.Image:
    """Pillow's image of one ``(H, W, 3)``, 0-1."""
    return Image.fromarray(np.rint(255 * np.clip(image, 0, 1)).astype(np.uint8))


def from_pillow(image: Image.Image) -> NDArray[np.float32]:
    """The inverse of `to_pillow`."""
    return np.asarray(image, np.float32) / np.float32(255)

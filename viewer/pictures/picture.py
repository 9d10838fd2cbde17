"""Draw the contents of the window in software, without a display."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from viewer.pictures.centres import centres, pruned_centres, why_unknown
from viewer.pictures.cubes import Cubes, draw_cubes
from viewer.pictures.drawer import Drawer, drawer_of
from viewer.pictures.layers import (
    EDGES,
    PIXEL_LEGEND,
    Legend,
    Points,
    block_colour,
    box_lines,
    error_image,
    reason_colour,
)
from viewer.pictures.marker import NEAR, draw_marker, marker
from viewer.pictures.octree_cells import Octree
from viewer.scenes.appearance import Look
from viewer.scenes.choice import Appearance, OctreeChoice
from viewer.scenes.opened import Opened, Pruned
from viewer.scenes.pose import Pose

#: Side of the square drawn for a centre, pixels.
POINT_SIZE = 2
PRUNED_SIZE = CELL_SIZE = SELECTED_SIZE = 3

#: Width of the wipe line, pixels; RGB of this line and of frame outlines.
WIPE_LINE = 8
LINE_COLOUR = (0.85, 0.85, 0.85)

#: RGB behind charts.
BACKGROUND = (0.07, 0.07, 0.08)

#: Height of text, pixels.
TEXT = 13

#: Length of a legend's bar, pixels.
_BAR = 200


@dataclass(frozen=True)
class Shown:
    """Settings for drawing one or two scenes.

    Attributes
    ----------
    layers : collection of str
        Names in `LAYERS`.
    colouring : str
        One of `COLOURINGS`.
    scenes : tuple of Opened
        One or two; errors are of the second relative to the first.
    pruned : Pruned or None
        Gaussians that were removed from the first.
    octree : OctreeChoice
    appearance : Appearance
    drawn : mapping of Opened to ndarray, shape (N,), bool
        Masks of drawn Gaussians; scenes without a mask have none hidden. Cached drawings stay valid
        while the array objects are the same.
    scale : str or None
        One of `SCALES`, for the colours of centres; None is the quantity's default.
    marked : tuple of Opened and int, or None
        A Gaussian to mark in all pictures: its scene and its row.
    """

    layers: Collection[str]
    colouring: str = "colour"
    scenes: tuple[Opened, ...] = ()
    pruned: Pruned | None = None
    octree: OctreeChoice = field(default_factory=OctreeChoice)
    appearance: Appearance = field(default_factory=Appearance)
    drawn: Mapping[Opened, NDArray[np.bool_]] = field(default_factory=dict)
    scale: str | None = None
    marked: tuple[Opened, int] | None = None

    def look(self, scene: Opened) -> Look:
        """Look of a scene."""
        return Look(self.appearance, self.drawn.get(scene))

    @cached_property
    def cells(self) -> Octree:
        """The octree of the scenes."""
        return Octree(self.scenes)

    def shows_error(self, scene: Opened) -> bool:
        """Whether the error of each pixel is shown instead of the scene."""
        return "error" in self.layers and scene in self.scenes[1:]

    @property
    def captions(self) -> list[str]:
        """The caption of each scene's pane."""
        return [
            f"{letter}: {scene.title}{self._remark(scene)}"
            for letter, scene in zip("AB", self.scenes, strict=False)
        ]

    def _remark(self, scene: Opened) -> str:
        remark = ", error against A" if self.shows_error(scene) else ""
        if "octree" in self.layers and self.octree.colouring == "bits" and scene.bits_unknown:
            remark += f", bits unknown: {scene.bits_unknown}"
        if "centres" in self.layers:
            reason = why_unknown(scene, self.colouring, self.scenes)
            remark += f", {self.colouring} unknown: {reason}" if reason else ""
        return remark


def draw_scene(
    scene: Opened, pose: Pose, width: int, height: int, shown: Shown, views: dict[Opened, Drawer]
) -> tuple[NDArray[np.float32], list[Legend]]:
    """The picture ``(H, W, 3)``, 0-1, of one scene, and its legends.

    Raises
    ------
    gs_codec.GsCodecError
    """
    legends = []
    image = np.empty((height, width, 3), np.float32)
    image[:] = shown.appearance.background
    if {"splats", "error"} & set(shown.layers):
        image = picture(views, scene, pose, width, height, shown)
    if shown.shows_error(scene):
        legends.append(PIXEL_LEGEND)
    if "centres" in shown.layers:
        points = centres(scene, shown.colouring, shown.scenes, None, shown.scale, shown.look(scene))
        draw_points(image, points, pose, POINT_SIZE)
        if points.legend is not None:
            legends.append(points.legend)
    if "pruned" in shown.layers and shown.pruned is not None and scene is shown.scenes[0]:
        draw_points(image, pruned_centres(scene, shown.pruned), pose, PRUNED_SIZE)
    if "boxes" in shown.layers:
        image = draw_boxes(image, scene.blocks, pose)
    if "octree" in shown.layers:
        cells = shown.cells.cells(scene, shown.octree.among(shown.layers))
        if isinstance(cells, Cubes):
            canvas = to_pillow(image)
            draw_cubes(canvas, cells, pose)
            image = from_pillow(canvas)
        else:
            draw_points(image, cells, pose, CELL_SIZE)
        if cells.legend is not None:
            legends.append(cells.legend)
    if shown.marked is not None:
        canvas = to_pillow(image)
        draw_marker(canvas, marker(*shown.marked, pose, width, height))
        image = from_pillow(canvas)
    return image, legends


def picture(
    views: dict[Opened, Drawer],
    scene: Opened,
    pose: Pose,
    width: int,
    height: int,
    shown: Shown,
    draft: int = 0,
) -> NDArray[np.float32]:
    """A scene's splats ``(H, W, 3)``, 0-1, or a heat map of the errors if chosen.

    Parameters
    ----------
    views : dict
        Drawer of each scene.
    scene : Opened
    pose : Pose
    width, height : int
    shown : Shown
    draft : int
        If not 0, splats are drawn as drafts, of one in every `draft` Gaussians.
    """

    def draw(each: Opened) -> NDArray[np.float32]:
        drawer, look = drawer_of(views, each), shown.look(each)
        if draft:
            return drawer.draft(pose, width, height, look, draft)
        return drawer.exact(pose, width, height, look)

    if shown.shows_error(scene):
        return error_image(*map(draw, shown.scenes))
    return np.clip(draw(scene), 0, 1)


def draw_points(image: NDArray, points: Points, pose: Pose, size: int) -> None:
    """Draw points as squares of `size` pixels into an image, nearest on top."""
    height, width = image.shape[:2]
    pixels, depth = pose.project(points.positions, width, height)
    inside = (depth > 0) & np.all((pixels > -size) & (pixels < (width, height)), axis=1)
    order = np.flatnonzero(inside)[np.argsort(-depth[inside], kind="stable")]
    corner = np.floor(pixels[order] - (size - 1) / 2).astype(np.int64)
    offsets = np.stack(np.meshgrid(np.arange(size), np.arange(size)), axis=-1).reshape(-1, 2)
    columns, rows = (corner[:, None] + offsets).reshape(-1, 2).T
    within = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    # If several points fall on a pixel, keep the last, which is the nearest.
    pixels = (rows * width + columns)[within]
    last = len(pixels) - 1 - np.unique(pixels[::-1], return_index=True)[1]
    sources = order.repeat(size * size)[within][last]
    image.reshape(-1, 3)[pixels[last]] = points.colours[sources]


def draw_boxes(image: NDArray, boxes: NDArray, pose: Pose) -> NDArray[np.float32]:
    """Draw the edges of boxes ``(n, 2, 3)`` into an image."""
    height, width = image.shape[:2]
    corners, lines = box_lines(boxes)
    canvas = to_pillow(image)
    pen = ImageDraw.Draw(canvas)
    before = pose.rotation @ (corners - pose.position).T
    for edge, (a, b) in enumerate(lines):
        ends = _clipped(before[:, a], before[:, b])
        if ends is not None:
            world = np.stack(ends) @ pose.rotation + pose.position
            pixels, _ = pose.project(world, width, height)
            colour = _bytes(block_colour(edge // EDGES))
            pen.line([tuple(np.clip(p, -1e6, 1e6)) for p in pixels], fill=colour)
    return from_pillow(canvas)


def _clipped(a: NDArray, b: NDArray) -> tuple[NDArray, NDArray] | None:
    """The part of a line in front of the camera; None if there is none."""
    near = NEAR * max(a[2], b[2])
    if near <= 0:
        return None
    if a[2] < near:
        a = b + (a - b) * (b[2] - near) / (b[2] - a[2])
    elif b[2] < near:
        b = a + (b - a) * (a[2] - near) / (a[2] - b[2])
    return a, b


def side_by_side(images: Sequence[NDArray]) -> NDArray[np.float32]:
    """Images of equal height side by side, separated by lines."""
    line = np.full((images[0].shape[0], 2, 3), 0.5, np.float32)
    parts: list[NDArray] = []
    for image in images:
        parts += [line, image] if parts else [image]
    return np.concatenate(parts, axis=1)


def wiped(first: NDArray, second: NDArray, wipe: float) -> NDArray[np.float32]:
    """The first image to the left of `wipe` (0-1), the second to the right, and a line between."""
    start, stop = wipe_line(wipe, first.shape[1])
    image = np.concatenate([first[:, :start], second[:, start:]], axis=1)
    image[:, start:stop] = LINE_COLOUR
    return image


def wipe_line(wipe: float, width: int) -> tuple[int, int]:
    """First and end column of the wipe line at `wipe` (0-1) in a picture of this width."""
    line = min(WIPE_LINE, width - 2)
    start = min(max(round(wipe * width) - line // 2, 1), width - line - 1)
    return start, start + line


def outlined(image: NDArray, pose: Pose) -> NDArray[np.float32]:
    """The image with an outline of the camera's frame."""
    canvas = to_pillow(image)
    left, top, right, bottom = map(round, pose.framed(canvas.width, canvas.height))
    ImageDraw.Draw(canvas).rectangle(
        (left, top, right - 1, bottom - 1), outline=_bytes(LINE_COLOUR)
    )
    return from_pillow(canvas)


def labelled(
    image: NDArray, captions: Sequence[tuple[int, str]], legends: Sequence[Legend]
) -> Image.Image:
    """The image with captions at the top, each at its column, and legends at the bottom."""
    canvas = to_pillow(image)
    pen = ImageDraw.Draw(canvas)
    font = ImageFont.load_default(TEXT)
    ends = [*(left for left, _ in captions[1:]), canvas.width]
    for (left, caption), end in zip(captions, ends, strict=True):
        _write(pen, (left + 8, 6), "\n".join(caption_lines(caption, end - left)), font)
    for row, legend in enumerate(reversed(legends)):
        top = canvas.height - 52 * (row + 1)
        _write(pen, (20, top), legend.title, font)
        canvas.paste(to_pillow(legend.bar(_BAR, 10)), (20, top + 20))
        columns = 20 + _BAR * legend.places
        for column, mark in zip(columns, legend.marks, strict=True):
            _write(pen, (round(column), top + 32), mark, font, "ma")
    return canvas


def caption_lines(caption: str, width: int) -> list[str]:
    """Lines of a caption, wrapped to a width in pixels."""
    font = ImageFont.load_default(TEXT)
    lines: list[str] = []
    for line in caption.splitlines():
        rest = line
        while len(rest) > 1 and font.getlength(rest) > width - 16:
            fits = [k for k in range(1, len(rest)) if font.getlength(rest[:k]) <= width - 16]
            most = max(fits, default=1)
            cut = rest.rfind(" ", 0, most + 1)
            cut = cut if cut > 0 else most
            lines.append(rest[:cut])
            rest = rest[cut:].lstrip()
        lines.append(rest)
    return lines


def reasons_text(pruned: Pruned) -> list[tuple[str, tuple[float, float, float]]]:
    """A line of text for each reason for pruning, and its colour."""
    found = enumerate(pruned.counts.items())
    return [(f"{n:,} by {reason}", reason_colour(k)) for k, (reason, n) in found if n]


def write_reasons(canvas: Image.Image, pruned: Pruned, below: int = 1) -> None:
    """Write the reasons for pruning, with counts, into the upper left corner below the caption.

    `below` is the number of the caption's lines.
    """
    pen, font = ImageDraw.Draw(canvas), ImageFont.load_default(TEXT)
    for row, (text, colour) in enumerate(reasons_text(pruned)):
        top = 8 + 18 * (below + row)
        pen.rectangle((8, top + 3, 18, top + 13), fill=_bytes(colour))
        _write(pen, (24, top), text, font)


def _write(
    pen: ImageDraw.ImageDraw,
    corner: tuple[int, int],
    text: str,
    font: ImageFont.ImageFont | ImageFont.FreeTypeFont,
    anchor: str = "la",
) -> None:
    edge = (0, 0, 0)
    pen.text(corner, text, (255, 255, 255), font, anchor, stroke_width=2, stroke_fill=edge)


def _bytes(colour: tuple[float, float, float]) -> tuple[int, ...]:
    return tuple(round(255 * c) for c in colour)


def to_pillow(image: NDArray) -> Image.Image:
    """Convert an image ``(H, W, 3)``, 0-1, to a Pillow image."""
    return Image.fromarray(np.rint(255 * np.clip(image, 0, 1)).astype(np.uint8))


def from_pillow(image: Image.Image) -> NDArray[np.float32]:
    """The inverse of `to_pillow`."""
    return np.asarray(image, np.float32) / np.float32(255)

"""The panes of a window: their layout, common pose, and pictures."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from open3d.visualization import gui

from viewer.pictures.layers import PIXEL_LEGEND, Legend, centres, pruned_centres
from viewer.pictures.octree import MOST_CUBES
from viewer.pictures.picture import Shown, depth_at, measure, picture, wipe_line
from viewer.scenes.choice import Choice
from viewer.scenes.opened import Opened, Pruned
from viewer.scenes.pose import Pose
from viewer.window.divider import make_divider
from viewer.window.mouse import Mouse, Place
from viewer.window.navigation import Navigator, distance_ahead, focused
from viewer.window.octree_layer import OctreeLayer
from viewer.window.pane import HIDDEN, Pane
from viewer.window.worker import Stale, Worker

#: Most centres that a pane shows, by device.
_MOST = {"gpu": 5_000_000, "cpu": 250_000}

#: Most cells of the octree that it shows as cubes: each is twelve triangles.
_CUBES = {"gpu": MOST_CUBES, "cpu": 12_000}

#: Seconds without a move until pictures are drawn in full; reduction of size before that.
_REST, _COARSE = 0.25, 4


#: Least height of the captions above the panes, pixels: Open3D draws label backgrounds this high.
_CAPTION = 32


class Stage:
    """Panes, side by side or in one view, that look from the same pose.

    Parameters
    ----------
    window : gui.Window
    worker : Worker
    choice : Choice
    device : {"gpu", "cpu"}
        What draws splats: Open3D's shader, or gs_codec's rasteriser.
    changed : callable
        Called when a picture or measurement is ready.
    failed : callable
        Called with the exception of a failed job.
    clicked, focused : callable
        Called with a pane and a pixel of its picture after a click and a double click.

    Attributes
    ----------
    scenes, panes : list
    views : dict
        What draws each scene, and its last pictures.
    pruned : Pruned or None
    pose : Pose or None
    navigator : Navigator
    captions : list of gui.Label
        The captions above the panes.
    divider : Canvas
        The line of a wipe.
    mouse : Mouse
    """

    def __init__(
        self,
        window: gui.Window,
        worker: Worker,
        choice: Choice,
        device: Literal["gpu", "cpu"],
        changed: Callable[[], None],
        failed: Callable[[Exception], None],
        clicked: Callable[[Pane, Place], None],
        focused: Callable[[Pane, Place], None],
    ) -> None:
        self.window, self.worker, self.choice, self.device = window, worker, choice, device
        self._changed, self._failed = changed, failed
        self.scenes: list[Opened] = []
        self.panes: list[Pane] = []
        self.pruned: Pruned | None = None
        self.pose: Pose | None = None
        self.navigator = Navigator()
        self.captions = [gui.Label("") for _ in range(2)]
        for label in self.captions:
            window.add_child(label)
        self.divider = make_divider(window, self._slide)
        self.mouse = Mouse(self, clicked, focused)
        self.size, self._left = (1, 1), 0
        self._measured: tuple[Pose | None, str] = (None, "")
        self.views: dict[Opened, Any] = {}
        self._coloured: Any = None
        self._octree = OctreeLayer(worker, changed, failed)
        self._moved_at = 0.0
        self._laid_out = False
        self._drawn: Literal["coarse", "full"] | None = None
        self._coming: Literal["coarse", "full"] | None = None

    def put(self, scenes: list[Opened], pruned: Pruned | None) -> None:
        """Show other scenes."""
        self.worker.cancel("picture")
        self.worker.cancel("centres")
        self.worker.cancel("measure")
        self.worker.cancel("focus")
        for pane in self.panes:
            pane.widget.visible = False
            pane.widget.scene.clear_geometry()
        self.scenes, self.pruned = scenes, pruned
        self.views.clear()
        self._coloured = self._coming = None
        self._measured = (None, "")
        self.panes = [Pane(self.window, scene) for scene in scenes]
        self._octree.put(self.panes, _CUBES[self.device], self._most)
        if pruned is not None:
            self.panes[0].points["pruned"] = pruned_centres(scenes[0], pruned, self._most)
        for pane in self.panes:
            self.window.add_child(pane.widget)
            self.mouse.attach(pane)
            if self.by_hand:
                # A draft until the first picture is drawn.
                pane.show_points("draft", centres(pane.scene, "colour", scenes, self._most))

    @property
    def shown(self) -> Shown:
        """What to draw."""
        choice = self.choice
        scenes = tuple(self.scenes)
        return Shown(tuple(choice.layers), choice.colouring, scenes, self.pruned, choice.octree)

    @property
    def quality(self) -> str:
        """PSNR and SSIM of B against A in the frame of the present view; empty until measured."""
        pose, text = self._measured
        return text if pose is self.pose else ""

    @property
    def legends(self) -> list[Legend]:
        """The legends of the layers shown."""
        layers, known = self.choice.layers, []
        if "centres" in layers and self._coloured == self.choice.colouring:
            known = [p.points["centres"].legend for p in self.panes[:1]]
        if "error" in layers and len(self.scenes) > 1:
            known.append(PIXEL_LEGEND)
        known.append(self._octree.legend)
        return [legend for legend in known if legend is not None]

    @property
    def by_hand(self) -> bool:
        """Whether splats are drawn by gs_codec's rasteriser."""
        return self.device == "cpu" and "splats" in self.choice.layers

    @property
    def resting(self) -> bool:
        """Whether the full pictures of this pose have been started."""
        return self.pose is None or self._drawn == "full"

    @property
    def visible(self) -> list[Pane]:
        """The visible panes, from left to right."""
        if len(self.panes) > 1 and self.choice.mode == "flip":
            return [self.panes[self.choice.front]]
        return self.panes

    @property
    def _most(self) -> int:
        return _MOST[self.device]

    # Layers

    def refresh(self) -> None:
        """Update the panes to the choice."""
        layers = self.choice.layers
        for pane in self.panes:
            pane.show_splats(self.device == "gpu" and "splats" in layers)
            pane.show_boxes(pane.scene.blocks if "boxes" in layers else None)
            for name in ("pruned", "centres"):
                pane.show_points(name, pane.points.get(name) if name in layers else None)
        if "centres" in layers:
            self._colour_centres()
        self.show_octree()
        self.arrange()

    def show_octree(self) -> None:
        """Update the octree alone to the choice."""
        choice = self.choice
        self._octree.show(choice.octree if "octree" in choice.layers else None)

    def _colour_centres(self) -> None:
        """Start colouring centres, unless they have the chosen colours."""
        shown, panes, most = self.shown, list(self.panes), self._most
        if self._coloured == shown.colouring:
            return

        def colour(stale: Stale) -> Any:
            return [centres(p.scene, shown.colouring, shown.scenes, most) for p in panes]

        def done(points: Any) -> None:
            self._coloured = shown.colouring
            for pane, each in zip(panes, points, strict=True):
                pane.points["centres"] = each
                pane.show_points("centres", each if "centres" in self.choice.layers else None)
            self._changed()

        self.worker.submit("centres", colour, done, self._failed)

    # Layout and cameras

    def look_from(self, pose: Pose, distance: float | None = None) -> None:
        """Look from another pose, at the distance of what is ahead, or another."""
        self.pose = pose
        ahead = distance_ahead(pose, self.scenes[0].positions) if distance is None else distance
        self.navigator.aim(ahead)
        self.arrange()

    def focus(self, pane: Pane, at: Place) -> None:
        """Bring what is at a pixel of a pane's picture to the middle."""
        views, scene, pose, size = self.views, pane.scene, self.pose, self.picture_size
        if pose is None:
            return

        def done(depth: float) -> None:
            if depth > 0 and self.pose is pose:
                self.look_from(focused(pose, at, depth, size), depth)

        def find(stale: Stale) -> float:
            return depth_at(views, scene, pose, at, size)

        self.worker.submit("focus", find, done, self._failed)

    def arrange(self) -> None:
        """Lay out the panes and redraw their pictures."""
        self._moved_at, self._drawn, self._coming = time.monotonic(), None, None
        self.window.set_needs_layout()
        self.window.post_redraw()

    def lay_out(self, left: int, top: int, width: int, height: int) -> None:
        """Put the panes into a part of the window, each below its caption."""
        visible, columns = self.visible, self._columns(width)
        line = self.caption_height
        below, high = top + line, max(height - line, 1)
        for pane in self.panes:
            if pane not in visible:
                pane.widget.frame = gui.Rect(left + width - 1, top, *HIDDEN)
        for pane, (start, stop, _, _) in zip(visible, columns, strict=True):
            pane.widget.frame = gui.Rect(left + start, below, max(stop - start, 1), high)
        names = dict(zip(self.panes, self.shown.captions, strict=True))
        for k, label in enumerate(self.captions):
            label.visible = k < len(visible)
            if label.visible:
                start, stop = columns[k][:2]
                # Most characters: a longer text would be wrapped.
                most = 2 * (stop - start) // self.window.theme.font_size
                label.text = f" {names[visible[k]]}"[:most]
                label.frame = gui.Rect(left + start, top, stop - start, line)
        gap = gui.Rect(left + width - 1, top, *HIDDEN)
        if len(visible) == 2 and self.choice.mode == "wipe":
            gap = gui.Rect(left + columns[0][1], below, columns[1][0] - columns[0][1], high)
        self.divider.move_to(gap)
        self.size, self._left = (width, high), left
        self._look()
        self._laid_out = True

    @property
    def caption_height(self) -> int:
        """Height of the captions above the panes, pixels."""
        return max(_CAPTION, int(1.5 * self.window.theme.font_size))

    def _slide(self, x: int) -> None:
        """Move the line of a wipe to a column of the window."""
        self.wipe_to((x - self._left) / self.size[0])

    def wipe_to(self, wipe: float) -> None:
        """Move the line of a wipe, 0-1."""
        self.choice.wipe = min(max(wipe, 0.0), 1.0)
        self.arrange()

    def _columns(self, width: int) -> list[tuple[int, int, int, int]]:
        """For each visible pane: start and stop column, picture width, and first picture column."""
        count = len(self.visible)
        if count == 2 and self.choice.mode == "wipe":
            stop, start = wipe_line(self.choice.wipe, width)
            return [(0, stop, width, 0), (start, width, width, start)]
        each = width // max(count, 1)
        return [(k * each, (k + 1) * each - (k < count - 1), each, 0) for k in range(count)]

    def _look(self) -> None:
        if self.pose is None:
            return
        width, height = self.size
        for pane, (_, _, wide, left) in zip(self.visible, self._columns(width), strict=True):
            pane.look(self.pose, wide, height, left)
            if len(self.scenes) > 1:
                pane.outline(self.pose, wide, height)

    def steer(self, pose: Pose) -> None:
        """Look from a pose that moves on."""
        self.pose = pose
        self._moved_at, self._drawn = time.monotonic(), None
        self._look()

    @property
    def picture_size(self) -> tuple[int, int]:
        """Width and height of the picture of each pane, of which a wipe shows parts, pixels."""
        return self._columns(self.size[0])[0][2], self.size[1]

    def place(self, pane: Pane, x: int, y: int) -> Place:
        """The pixel of a pane's picture at a pixel of the window."""
        left = self._columns(self.size[0])[self.visible.index(pane)][3]
        return x - pane.widget.frame.x + left + 0.5, y - pane.widget.frame.y + 0.5

    def tick(self) -> bool:
        """Draw pictures, coarse ones while the camera moves."""
        if self.pose is None:
            return False
        looked = self._laid_out
        if looked:
            # Open3D sets its own near and far planes when the size of a pane changes.
            self._laid_out = False
            self._look()
        rested = time.monotonic() - self._moved_at > _REST
        wanted: Literal["coarse", "full"] = "full" if rested else "coarse"
        # Let a coarse picture finish; otherwise none would appear during continuous moves.
        if self._drawn in ("full", wanted) or wanted == self._coming == "coarse":
            return looked
        self._drawn = wanted
        self._draw(1 if rested else _COARSE)
        return True

    # Pictures

    def _draw(self, coarse: int) -> None:
        """Start drawing the pictures of all visible panes; after full ones, measure B."""
        visible, shown, by_hand = list(self.visible), self.shown, self.by_hand
        views, pose, (width, height) = self.views, self.pose, self.size
        columns = self._columns(width)
        assert pose is not None
        wanted = [by_hand or shown.shows_error(pane.scene) for pane in visible]

        def draw(stale: Stale) -> Any:
            wide, high = max(columns[0][2] // coarse, 1), max(height // coarse, 1)
            pictures: list[NDArray | None] = []
            for pane, cut, want in zip(visible, columns, wanted, strict=True):
                if stale():
                    return None
                image = picture(views, pane.scene, pose, wide, high, shown) if want else None
                pictures.append(None if image is None else _cut(image, cut, coarse))
            return pictures

        def done(pictures: Any) -> None:
            self._coming = None
            if pictures is None:
                return
            for pane, image in zip(visible, pictures, strict=True):
                pane.show_picture(image)
            self._changed()
            self.window.post_redraw()

        def failed(error: Exception) -> None:
            self._coming = None
            self._failed(error)

        self._coming = self._drawn
        self.worker.submit("picture", draw, done, failed)
        if coarse == 1:
            self._measure()

    def _measure(self) -> None:
        """Start measuring B in the frame of the present view, unless that is done."""
        views, scenes, pose = self.views, list(self.scenes), self.pose
        if len(scenes) < 2 or pose is None or self._measured[0] is pose:
            return

        def done(text: str) -> None:
            self._measured = pose, text
            self._changed()

        def work(stale: Stale) -> str:
            return measure(views, scenes, pose)

        self.worker.submit("measure", work, done, self._failed)


def _cut(image: NDArray, cut: tuple[int, int, int, int], coarse: int) -> NDArray[np.float32]:
    """The part of a picture that a pane shows."""
    start, stop, _, left = cut
    first = min(left // coarse, image.shape[1] - 1)
    return image[:, first : first + max((stop - start) // coarse, 1)]

"""The panes of a window: layout, common pose, and pictures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from open3d.visualization import gui

from viewer.pictures.centres import centres, pruned_centres, selected_centres
from viewer.pictures.drawer import Drawer, depth_at
from viewer.pictures.layers import PIXEL_LEGEND, Legend, Points
from viewer.pictures.marker import marker
from viewer.pictures.octree_cells import MOST_CUBES
from viewer.pictures.picture import Shown, wipe_line
from viewer.scenes.choice import Choice
from viewer.scenes.opened import Opened, Pruned
from viewer.scenes.pose import Pose, distance_ahead
from viewer.scenes.worker import Stale, Worker
from viewer.window.divider import make_divider
from viewer.window.mouse import Mouse, Place
from viewer.window.navigation import Navigator, focused
from viewer.window.octree_layer import OctreeLayer
from viewer.window.painter import Columns, Painter
from viewer.window.pane import HIDDEN, Pane, draws_splats
from viewer.window.tag import Tag

#: Maximum number of centres in a pane, by device.
_MOST = {"gpu": 5_000_000, "cpu": 250_000}

#: Maximum number of octree cells shown as cubes (twelve triangles each), by device.
_CUBES = {"gpu": MOST_CUBES, "cpu": 12_000}

#: Maximum number of centres shown before the first picture.
_DRAFT = 100_000

#: Minimum height of the captions above the panes, pixels: that of label backgrounds in Open3D.
_CAPTION = 32

#: Minimum side of saved pictures, pixels.
_SAVED = 64

#: Closed lines ``(n, 2)``, pixels, of a picture from a pose, of a width and a height.
Overlay = Callable[[Pose, int, int], list[NDArray[np.float64]]]


class Stage:
    """Panes with a common pose, side by side or in one view.

    Parameters
    ----------
    window : gui.Window
    worker : Worker
    choice : Choice
    device : {"gpu", "cpu"}
        Device that draws splats: with Open3D's shader, or with gs_codec's rasteriser.
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
        Drawer of each scene, with its last pictures.
    pruned : Pruned or None
    drawn : dict of Opened to ndarray, shape (N,), bool
        Masks of drawn Gaussians, for scenes that have hidden ones.
    pose : Pose or None
        The current pose.
    seen : Pose or None
        The pose of the panes; follows the pictures if gs_codec's rasteriser draws.
    painter : Painter
    navigator : Navigator
    overlays : dict of str to Overlay
        Lines drawn over all panes, by name.
    overlay_colours : dict of str to tuple
        RGB of those that are not white.
    captions : list of gui.Label
        The captions above the panes.
    tag : Tag
        The text beside a place in the first pane.
    divider : Canvas
        The wipe line.
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
        self.drawn: dict[Opened, NDArray[np.bool_]] = {}
        self.pose: Pose | None = None
        self.seen: Pose | None = None
        self.navigator = Navigator()
        self.overlays: dict[str, Overlay] = {}
        self.overlay_colours: dict[str, tuple[float, float, float]] = {}
        self.captions = [gui.Label("") for _ in range(2)]
        for label in self.captions:
            window.add_child(label)
        self.tag = Tag(window)
        self.divider = make_divider(window, self._slide)
        self.mouse = Mouse(self, clicked, focused)
        # Created together: Open3D cannot remove them, and adding one later would select the first
        # tab.
        self._both = [Pane(window) for _ in range(2)]
        for pane in self._both:
            # One stays visible: Open3D does not clear areas without a widget, so an empty window
            # would keep old dialogs.
            pane.widget.visible = pane is self._both[0]
            window.add_child(pane.widget)
            self.mouse.attach(pane)
        self.size, self._left = (1, 1), 0
        self.views: dict[Opened, Drawer] = {}
        self.painter = Painter(self, changed, failed)
        self._coloured: Shown | None = None
        self._marked: tuple[Opened, int] | None = None
        self._octree = OctreeLayer(worker, changed, failed)
        self._laid_out = False

    def put(self, scenes: list[Opened], pruned: Pruned | None) -> None:
        """Show other scenes."""
        before = self._keep(scenes)
        self.painter.put(scenes)
        self.panes = self._both[: len(scenes)]
        for number, scene in enumerate(scenes):
            if before[number : number + 1] != [scene]:
                self.panes[number].put(scene)
                self.panes[number].show_picture(None)
        for pane in self._both:
            pane.widget.visible = pane in self.panes
        self._octree.put(self.panes, _CUBES[self.device], self._most)
        self.put_pruned(pruned)
        if self.by_hand:  # until the first pictures are drawn
            for pane in self.panes:
                look = self.shown.look(pane.scene)
                points = centres(pane.scene, "colour", scenes, _DRAFT, look=look)
                pane.show_points("draft", points)

    def replace(self, number: int, scene: Opened) -> None:
        """Replace a scene by its edited version, from the same pose."""
        self._keep([*self.scenes[:number], scene, *self.scenes[number + 1 :]])
        self.painter.put(self.scenes)
        self.panes[number].put(scene)
        self._octree.put(self.panes, _CUBES[self.device], self._most)
        self.put_pruned(self.pruned)
        self.refresh()

    def exchange(self, scenes: list[Opened]) -> None:
        """Show other frames of the same scenes, from the same pose; more may follow."""
        self._keep(scenes)
        self.painter.follow()
        for pane, scene in zip(self.panes, scenes, strict=True):
            if pane.scene is not scene:
                pane.put(scene)
        self._octree.put(self.panes, _CUBES[self.device], self._most)
        self.refresh()
        self.painter.move()

    def _keep(self, scenes: list[Opened]) -> list[Opened]:
        """Stop and forget drawers of scenes other than these; return the previous scenes."""
        self.worker.cancel("centres")
        self.worker.cancel("focus")
        before, self.scenes = self.scenes, list(scenes)
        # Replaced, not modified, because a job may still add to it.
        self.drawn = {each: self.drawn[each] for each in scenes if each in self.drawn}
        self.views = {each: self.views[each] for each in scenes if each in self.views}
        self._coloured = self._marked = None
        self._octree.show(None)
        return before

    def put_pruned(self, pruned: Pruned | None) -> None:
        """Show the Gaussians that a report lists as pruned from the first scene."""
        self.pruned = pruned
        if pruned is not None:
            self.panes[0].points["pruned"] = pruned_centres(self.scenes[0], pruned, self._most)

    def show_selected(self, number: int, selected: NDArray[np.bool_]) -> None:
        """Show the selected Gaussians of a scene, by their mask ``(N,)``."""
        pane = self.panes[number]
        pane.show_points("selected", selected_centres(pane.scene, selected, self._most))

    @property
    def shown(self) -> Shown:
        """Settings for drawing."""
        choice = self.choice
        return Shown(
            tuple(choice.layers),
            choice.colouring,
            tuple(self.scenes),
            self.pruned,
            choice.octree,
            choice.appearance,
            dict(self.drawn),
            choice.scale,
            self._marked,
        )

    @property
    def quality(self) -> str:
        """PSNR and SSIM of B against A in the frame of the current view; empty until measured."""
        return self.painter.quality

    @property
    def legends(self) -> list[Legend]:
        """Legends of the layers shown."""
        layers, coloured = self.choice.layers, self._coloured
        known: list[Legend | None] = []
        if "centres" in layers and coloured and _same_colours(coloured, self.shown):
            # Equal in all panes where the quantity is known.
            legends = [pane.points["centres"].legend for pane in self.panes]
            known += [legend for legend in legends if legend is not None][:1]
        if "error" in layers and len(self.scenes) > 1:
            known.append(PIXEL_LEGEND)
        known.append(self._octree.legend)
        return [legend for legend in known if legend is not None]

    @property
    def by_hand(self) -> bool:
        """Whether gs_codec's rasteriser draws splats."""
        return "splats" in self.choice.layers and not self.by_shader

    @property
    def by_shader(self) -> bool:
        """Whether Open3D's shader draws splats."""
        return self.has_shader and not self.choice.exact

    @property
    def has_shader(self) -> bool:
        """Whether Open3D can draw splats on the device."""
        return draws_splats(self.device)

    @property
    def resting(self) -> bool:
        """Whether full pictures of the current pose are shown."""
        return self.pose is None or self.painter.resting

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
            pane.show_boxes(pane.scene.blocks if "boxes" in layers else None)
            for name in ("pruned", "centres"):
                pane.show_points(name, pane.points.get(name) if name in layers else None)
        self._dress()
        self.show_octree()
        self.arrange()

    def draw_only(self, drawn: dict[Opened, NDArray[np.bool_]]) -> None:
        """Draw only the Gaussians in these masks; scenes without a mask are drawn whole."""
        before, self.drawn = self.drawn, drawn
        if any(before.get(each) is not drawn.get(each) for each in self.scenes):
            self.restyle()

    def restyle(self) -> None:
        """Update the panes to the appearance and the drawn Gaussians; more updates may follow."""
        self._dress()
        self.painter.move()
        self.window.post_redraw()

    def _dress(self) -> None:
        """Update everything that depends on the appearance, except pictures."""
        shown, layers = self.shown, self.choice.layers
        for pane in self.panes:
            by_shader = self.by_shader and "splats" in layers
            by_shader = by_shader and not shown.shows_error(pane.scene)
            pane.show_splats(shown.look(pane.scene) if by_shader else None)
            pane.set_background(shown.appearance.background)
        if "centres" in layers:
            self._colour_centres()

    def show_octree(self) -> None:
        """Update only the octree to the choice."""
        octree, layers = self.choice.octree, self.choice.layers
        self._octree.show(octree.among(layers) if "octree" in layers else None)

    def _colour_centres(self) -> None:
        """Start colouring centres, unless they already have the chosen colours."""
        shown, panes, most = self.shown, list(self.panes), self._most
        if self._coloured is not None and _same_centres(self._coloured, shown):
            return

        def colour(stale: Stale) -> list[Points]:
            chosen, scenes = shown.colouring, shown.scenes
            return [
                centres(p.scene, chosen, scenes, most, shown.scale, shown.look(p.scene))
                for p in panes
            ]

        def done(points: list[Points]) -> None:
            self._coloured = shown
            for pane, each in zip(panes, points, strict=True):
                pane.points["centres"] = each
                pane.show_points("centres", each if "centres" in self.choice.layers else None)
            self._changed()

        self.worker.submit("centres", colour, done, self._failed)

    def show_tag(self, text: str, at: NDArray[np.float64] | None) -> bool:
        """Show a text beside a pixel of the picture, or none; return whether to draw the window."""
        if at is None:
            return self.tag.hide()
        return self.tag.show(text, at - (self.columns[0][3], 0), self.visible[0].widget)

    # Layout and cameras

    def look_from(self, pose: Pose, distance: float | None = None) -> None:
        """Look from another pose; the point ahead is at `distance`, by default unchanged."""
        self.pose = pose
        ahead = distance_ahead(pose, self.scenes[0].positions) if distance is None else distance
        self.navigator.aim(ahead)
        self.arrange()

    def focus(self, pane: Pane, at: Place) -> None:
        """Move the point at a pixel of a pane's picture to the middle."""
        views, scene, pose, size = self.views, pane.scene, self.pose, self.picture_size
        look = self.shown.look(scene)
        if pose is None:
            return

        def done(depth: float) -> None:
            if depth > 0 and self.pose is pose:
                self.look_from(focused(pose, at, depth, size), depth)

        def find(stale: Stale) -> float:
            return depth_at(views, scene, pose, at, size, look)

        self.worker.submit("focus", find, done, self._failed)

    def arrange(self) -> None:
        """Lay out the panes and redraw their pictures."""
        if not self.painter.leads:
            self.seen = self.pose
        self.painter.move()
        self.painter.rest()
        self.window.set_needs_layout()
        self.window.post_redraw()

    def lay_out(self, left: int, top: int, width: int, height: int) -> None:
        """Place the panes in a part of the window, each below its caption."""
        line = self.caption_height
        below, high = top + line, max(height - line, 1)
        if self.size != (width, high):
            self.painter.move()
        self.size, self._left = (width, high), left
        visible, columns = self.visible, self.columns
        if not self.panes:
            self._both[0].widget.frame = gui.Rect(left, below, width, high)
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
                # Maximum characters; longer text would be wrapped.
                most = 2 * (stop - start) // self.window.theme.font_size
                label.text = f" {names[visible[k]]}"[:most]
                label.frame = gui.Rect(left + start, top, stop - start, line)
        gap = gui.Rect(left + width - 1, top, *HIDDEN)
        if len(visible) == 2:  # otherwise a gap would keep old dialogs
            line = max(columns[1][0] - columns[0][1], 1)
            gap = gui.Rect(left + columns[0][1], below, line, high)
        self.divider.move_to(gap)
        self._look()
        self._laid_out = True

    @property
    def caption_height(self) -> int:
        """Height of the captions above the panes, pixels."""
        return max(_CAPTION, int(1.5 * self.window.theme.font_size))

    def _slide(self, x: int) -> None:
        """Move the wipe line to a column of the window."""
        if self.choice.mode == "wipe":
            self.wipe_to((x - self._left) / self.size[0])

    def wipe_to(self, wipe: float) -> None:
        """Move the wipe line, 0-1."""
        self.choice.wipe = min(max(wipe, 0.0), 1.0)
        self.arrange()

    @property
    def columns(self) -> list[Columns]:
        """Columns of each visible pane."""
        count, width = len(self.visible), self.size[0]
        if count == 2 and self.choice.mode == "wipe":
            stop, start = wipe_line(self.choice.wipe, width)
            return [(0, stop, width, 0), (start, width, width, start)]
        each = width // max(count, 1)
        starts = (0, width - each)[:count]
        return [(start, start + each - (k < count - 1), each, 0) for k, start in enumerate(starts)]

    def _look(self) -> None:
        if self.seen is None:
            return
        height = self.size[1]
        for pane, (_, _, wide, left) in zip(self.visible, self.columns, strict=True):
            pane.look(self.seen, wide, height, left)
            if len(self.scenes) > 1:
                pane.outline(self.seen, wide, height)
            lines = marker(*self._marked, self.seen, wide, height) if self._marked else []
            pane.show_lines("mark", lines, self.seen, wide, height)
            for name, overlay in self.overlays.items():
                lines, colour = overlay(self.seen, wide, height), self.overlay_colours.get(name)
                pane.show_lines(name, lines, self.seen, wide, height, colour)

    def draw_overlays(self) -> None:
        """Draw lines again, without new pictures."""
        self._look()
        self.window.post_redraw()

    def see(self, pose: Pose) -> None:
        """Make the panes look from a pose."""
        if self.seen is not pose:
            self.seen = pose
            self._look()

    def mark(self, marked: tuple[Opened, int] | None) -> None:
        """Mark a Gaussian of a scene in all panes, or remove the mark."""
        self._marked = marked
        self._look()
        self.window.post_redraw()

    def steer(self, pose: Pose) -> None:
        """Look from a pose that keeps moving."""
        self.pose = pose
        self.painter.move()
        if not self.painter.leads:
            self.see(pose)

    @property
    def picture_size(self) -> tuple[int, int]:
        """Width and height of each pane's picture, pixels; a wipe shows parts of it."""
        return self.columns[0][2], self.size[1]

    @property
    def saved_size(self) -> tuple[int, int]:
        """Width and height of saved pictures: those of the panes, but no less than 64 pixels."""
        return max(self.size[0], _SAVED), max(self.size[1], _SAVED)

    def place(self, pane: Pane, x: int, y: int) -> Place:
        """The pixel of a pane's picture at a pixel of the window."""
        columns = dict(zip(self.visible, self.columns, strict=True))
        # A pane may have been hidden while the mouse was dragged in it.
        left = columns[pane][3] if pane in columns else 0
        return x - pane.widget.frame.x + left + 0.5, y - pane.widget.frame.y + 0.5

    def tick(self) -> bool:
        """Draw changes; return whether to draw the window."""
        if self.pose is None:
            return False
        looked = self._laid_out
        if looked:
            # Open3D resets near and far planes when the size of a pane changes.
            self._laid_out = False
            self._look()
        stuck = [pane.tick() for pane in self.panes]
        return self.painter.tick(self.pose) or looked or any(stuck)


def _same_colours(before: Shown, after: Shown) -> bool:
    """Whether centres have the same colouring and scale."""
    return (before.colouring, before.scale) == (after.colouring, after.scale)


def _same_centres(before: Shown, after: Shown) -> bool:
    """Whether the same centres are shown, in the same colours."""
    return (
        _same_colours(before, after)
        and before.appearance.least_opacity == after.appearance.least_opacity
        and all(before.drawn.get(each) is after.drawn.get(each) for each in after.scenes)
    )

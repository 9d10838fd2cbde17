"""The panes of a window: where they are, where they look from, and their pictures."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from open3d.visualization import gui

import gs_codec
from viewer.choice import Choice
from viewer.layers import Legend, centres, error_image, pruned_centres
from viewer.navigation import Navigator, distance_ahead
from viewer.numbers import quality_text
from viewer.opened import Opened, Pruned
from viewer.pane import HIDDEN, Pane
from viewer.picture import Shown, splats
from viewer.pose import Pose
from viewer.worker import Stale, Worker

#: Most centres a pane shows, by what draws them.
_MOST = {"gpu": 5_000_000, "cpu": 250_000}

#: Seconds without a move after which pictures are drawn in full; before, by one pixel of so many.
_REST, _COARSE = 0.25, 4

#: Smaller pictures have no SSIM, pixels.
_LEAST_SIDE = 11


class Stage:
    """Panes beside each other, or over each other, that look from one pose.

    Parameters
    ----------
    window : gui.Window
    worker : Worker
    choice : Choice
    device : {"gpu", "cpu"}
        What draws splats: Open3D's shader, or our own rasteriser.
    changed : callable
        Called when a picture has come, with what is known of it.
    failed : callable
        Called with what went wrong.

    Attributes
    ----------
    scenes, panes : list
    pruned : Pruned or None
    pose : Pose or None
    navigator : Navigator
    legends : list of Legend
        Of what centres are coloured by.
    error_legend : Legend or None
    quality : str
        PSNR and SSIM of the present view.
    """

    def __init__(
        self,
        window: gui.Window,
        worker: Worker,
        choice: Choice,
        device: Literal["gpu", "cpu"],
        changed: Callable[[], None],
        failed: Callable[[Exception], None],
    ) -> None:
        self.window, self.worker, self.choice, self.device = window, worker, choice, device
        self._changed, self._failed = changed, failed
        self.scenes: list[Opened] = []
        self.panes: list[Pane] = []
        self.pruned: Pruned | None = None
        self.pose: Pose | None = None
        self.navigator = Navigator()
        self.legends: list[Legend] = []
        self.error_legend: Legend | None = None
        self.quality = ""
        self.size = (1, 1)
        self._views: dict[Opened, Any] = {}
        self._coloured: Any = None
        self._moved_at = 0.0
        self._laid_out = False
        self._drawn: Literal["coarse", "full"] | None = None
        self._coming: Literal["coarse", "full"] | None = None

    def put(self, scenes: list[Opened], pruned: Pruned | None) -> None:
        """Show other scenes."""
        self.worker.cancel("picture")
        self.worker.cancel("centres")
        for pane in self.panes:
            pane.widget.visible = False
            pane.widget.scene.clear_geometry()
        self.scenes, self.pruned = scenes, pruned
        self._views.clear()
        self._coloured = self._coming = None
        self.legends, self.error_legend, self.quality = [], None, ""
        self.panes = [Pane(self.window, scene) for scene in scenes]
        known = {}
        if pruned is not None:
            known["pruned"] = pruned_centres(scenes[0], pruned, self._most)
        for pane in self.panes:
            self.window.add_child(pane.widget)
            pane.widget.set_on_mouse(self._mouse)
            pane.points.update(known)
            if self.by_hand:
                # Something to see until the first picture is drawn.
                pane.show_points("draft", centres(pane.scene, "colour", None, self._most))

    @property
    def shown(self) -> Shown:
        """What is to be seen."""
        first = self.scenes[0] if self.scenes else None
        reference = first if len(self.scenes) > 1 else None
        return Shown(
            tuple(self.choice.layers), self.choice.colouring, reference, self.pruned, first
        )

    @property
    def by_hand(self) -> bool:
        """Whether splats are to be drawn by our own rasteriser."""
        return self.device == "cpu" and "splats" in self.choice.layers

    @property
    def resting(self) -> bool:
        """Whether all that is to be seen was asked for."""
        return self.pose is None or self._drawn == "full"

    @property
    def visible(self) -> list[Pane]:
        """The panes that are seen, from left to right."""
        if len(self.panes) > 1 and self.choice.mode == "flip":
            return [self.panes[self.choice.front]]
        return self.panes

    @property
    def _most(self) -> int:
        return _MOST[self.device]

    # Layers

    def refresh(self) -> None:
        """Bring the panes up to what was chosen."""
        layers = self.choice.layers
        for pane in self.panes:
            pane.show_splats(self.device == "gpu" and "splats" in layers)
            pane.show_boxes(pane.scene.blocks if "boxes" in layers else None)
            for name in ("pruned", "centres"):
                pane.show_points(name, pane.points.get(name) if name in layers else None)
        self.legends = []
        if "centres" in layers:
            self._colour_centres()
        self.arrange()

    def _colour_centres(self) -> None:
        """Have centres coloured, unless they are already."""
        shown, panes, most = self.shown, list(self.panes), self._most
        if self._coloured == shown.colouring:
            self._show_legends()
            return

        def colour(stale: Stale) -> Any:
            return [centres(p.scene, shown.colouring, shown.reference, most) for p in panes]

        def done(points: Any) -> None:
            self._coloured = shown.colouring
            for pane, each in zip(panes, points, strict=True):
                pane.points["centres"] = each
                pane.show_points("centres", each if "centres" in self.choice.layers else None)
            self._show_legends()
            self._changed()

        self.worker.submit("centres", colour, done, self._failed)

    def _show_legends(self) -> None:
        known = [pane.points["centres"].legend for pane in self.panes]
        self.legends = [legend for legend in known if legend is not None][-1:]

    # Layout and cameras

    def look_from(self, pose: Pose) -> None:
        """Look from somewhere else."""
        self.pose = pose
        self.navigator.aim(distance_ahead(pose, self.scenes[0].positions))
        self.arrange()

    def arrange(self) -> None:
        """Lay panes out, and draw their pictures anew."""
        self._moved_at, self._drawn, self._coming = time.monotonic(), None, None
        self.window.set_needs_layout()
        self.window.post_redraw()

    def lay_out(self, left: int, top: int, width: int, height: int) -> None:
        """Put the panes into a part of the window."""
        visible = self.visible
        for pane in self.panes:
            if pane not in visible:
                pane.widget.frame = gui.Rect(left + width - 1, top, *HIDDEN)
        for pane, (start, stop, _, _) in zip(visible, self._places(width), strict=True):
            pane.widget.frame = gui.Rect(left + start, top, max(stop - start, 1), height)
        self.size = (width, height)
        self._look()
        self._laid_out = True

    def _places(self, width: int) -> list[tuple[int, int, int, int]]:
        """For each visible pane: where it starts and stops, the picture's width, and its left."""
        count = len(self.visible)
        if count == 2 and self.choice.mode == "wipe":
            split = min(max(round(self.choice.place * width), 2), width - 1)
            return [(0, split - 1, width, 0), (split, width, width, split)]
        each = width // max(count, 1)
        return [(k * each, (k + 1) * each - (k < count - 1), each, 0) for k in range(count)]

    def _look(self) -> None:
        if self.pose is None:
            return
        width, height = self.size
        for pane, (_, _, wide, left) in zip(self.visible, self._places(width), strict=True):
            pane.look(self.pose, wide, height, left)

    def _mouse(self, event: Any) -> Any:
        """Turn by dragging; shift with ctrl or another button; come nearer by the wheel.

        All panes follow the one pose. Open3D's own control is left out: it measures from a
        camera that it alone may set.
        """
        pose, navigator, kind = self.pose, self.navigator, gui.MouseEvent.Type
        if pose is None:
            return gui.SceneWidget.EventCallbackResult.CONSUMED
        moved = None
        if event.type == kind.BUTTON_DOWN:
            left = event.is_button_down(gui.MouseButton.LEFT)
            shifts = not left or event.is_modifier_down(gui.KeyModifier.CTRL)
            navigator.hold(pose, event.x, event.y, shifts)
        elif event.type == kind.DRAG:
            wide = self._places(self.size[0])[0][2]
            moved = navigator.drag(event.x, event.y, wide, self.size[1])
        elif event.type == kind.BUTTON_UP:
            navigator.release()
        elif event.type == kind.WHEEL:
            moved = navigator.nearer(pose, event.wheel_dy)
        if moved is not None:
            self.pose = moved
            self._moved_at, self._drawn = time.monotonic(), None
            self._look()
        return gui.SceneWidget.EventCallbackResult.CONSUMED

    def tick(self) -> bool:
        """Draw pictures, coarse ones while the camera moves."""
        if self.pose is None:
            return False
        looked = self._laid_out
        if looked:
            # Open3D sets near and far planes of its own when it draws a pane of another size.
            self._laid_out = False
            self._look()
        rested = time.monotonic() - self._moved_at > _REST
        wanted: Literal["coarse", "full"] = "full" if rested else "coarse"
        # A coarse picture that is being drawn is waited for, or none came while moves do.
        if self._drawn in ("full", wanted) or wanted == self._coming == "coarse":
            return looked
        self._drawn = wanted
        self._draw(1 if rested else _COARSE)
        return True

    # Pictures

    def _draw(self, coarse: int) -> None:
        """Have the pictures of all visible panes drawn; in full, with the quality of B."""
        visible, scenes, by_hand = list(self.visible), self.scenes, self.by_hand
        wants_error = "error" in self.choice.layers and len(scenes) > 1
        if not (by_hand or wants_error):
            self.error_legend = None
            for pane in visible:
                pane.show_picture(None)
            if coarse > 1 or len(scenes) < 2:
                return
        pose, views = self.pose, self._views
        width, height = self.size
        places = self._places(width)
        assert pose is not None

        def draw(stale: Stale) -> Any:
            wide, high = max(places[0][2] // coarse, 1), max(height // coarse, 1)
            images: dict[Opened, NDArray] = {}
            needed = scenes if coarse == 1 or wants_error else [p.scene for p in visible]
            for scene in needed:
                if stale():
                    return None
                images[scene] = splats(views, scene, pose, wide, high)
            quality, legend = "", None
            if coarse == 1 and len(images) == 2 and min(wide, high) >= _LEAST_SIDE:
                quality = quality_text(gs_codec.compare(*images.values()))
            if wants_error:
                images[scenes[1]], legend = error_image(images[scenes[0]], images[scenes[1]])
            pictures = [
                _cut(images[pane.scene], place, coarse)
                for pane, place in zip(visible, places, strict=True)
            ]
            return pictures, quality, legend

        def done(found: Any) -> None:
            self._coming = None
            if found is None:
                return
            pictures, self.quality, self.error_legend = found
            if by_hand or wants_error:
                for pane, picture in zip(visible, pictures, strict=True):
                    keep = by_hand or pane.scene is not scenes[0]
                    pane.show_picture(picture if keep else None)
            self._changed()
            self.window.post_redraw()

        def failed(error: Exception) -> None:
            self._coming = None
            self._failed(error)

        self._coming = self._drawn
        self.worker.submit("picture", draw, done, failed)


def _cut(image: NDArray, place: tuple[int, int, int, int], coarse: int) -> NDArray[np.float32]:
    """A pane's part of its picture."""
    start, stop, _, left = place
    first = left // coarse
    part = image[:, first : max(first + (stop - start) // coarse, first + 1)]
    return np.clip(part, 0, 1)

"""The viewer's window."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from open3d.visualization import gui

import gs_codec
from viewer.layers import LAYERS, centres, error_image, pruned_centres
from viewer.numbers import quality_text
from viewer.opened import Opened, Pruned, open_scene
from viewer.pane import Pane, picture_of
from viewer.panel import Panel, folded, monospace
from viewer.photograph import find_photograph
from viewer.picture import Shown, splats
from viewer.pose import Pose, of_camera, overview
from viewer.request import MODES, Request, find_pruned, find_views
from viewer.screenshot import compose, save_picture
from viewer.worker import Stale, Worker

#: Most centres a pane shows, by what draws them.
_MOST = {"gpu": 5_000_000, "cpu": 250_000}

#: Seconds without a move after which pictures are drawn in full; before, by one pixel of so many.
_REST, _COARSE = 0.25, 4

#: Smaller pictures have no SSIM, pixels.
_LEAST_SIDE = 11

#: Width of the panel, in heights of a line.
_PANEL_EMS = 19

#: Longest line of a dialog, characters.
_DIALOG = 76

_HELP = (
    ("drag, wheel", "turn, come nearer"),
    ("ctrl + drag", "shift"),
    ("N, P", "next, previous camera"),
    ("M", "side by side, wipe, flip"),
    ("F", "in one view: A or B"),
    ("left, right", "move the wipe"),
    ("1 ... 5", ", ".join(LAYERS)),
    ("C", "what centres are coloured by"),
    ("O", "open a scene"),
    ("S", "save a picture"),
    ("Esc", "stop loading"),
    ("H", "this help"),
    ("Q", "quit"),
)


class Viewer:
    """A window that shows one scene, or two.

    Parameters
    ----------
    request : Request
    device : {"gpu", "cpu"}
        What the window is drawn by; splats by Open3D's shader or by our own rasteriser.

    Attributes
    ----------
    scenes, panes : list
    pose : Pose or None
    message : tuple of str or None
        Title and text of the dialog that is open.
    quality : str
        PSNR and SSIM of the present view.
    """

    def __init__(self, request: Request, device: Literal["gpu", "cpu"] = "cpu") -> None:
        self.request, self.device = request, device
        self.scenes: list[Opened] = []
        self.panes: list[Pane] = []
        self.pose: Pose | None = None
        self.layers = set(request.layers)
        self.colouring, self.mode = request.colouring, request.mode
        self.front, self.place = 1, 0.5
        self.cameras: list[Any] = []
        self.number = request.view or 0
        self.pruned: Pruned | None = None
        self.message: tuple[str, str] | None = None
        self.quality = ""
        self._views: dict[Opened, Any] = {}
        self._width = self._height = 1
        self._without_cameras = False
        self._changed_at = 0.0
        self._drawn: Any = None
        font = monospace()
        self.window = gui.Application.instance.create_window("gs-viewer", *request.size)
        self.worker = Worker(
            lambda call: gui.Application.instance.post_to_main_thread(self.window, call)
        )
        self.panel = Panel(self, font)
        self.photograph = gui.ImageWidget()
        self.photograph.visible = False
        self.window.add_child(self.panel.widget)
        self.window.add_child(self.photograph)
        self.window.set_on_layout(self._lay_out)
        self.window.set_on_tick_event(self._tick)
        self.window.set_on_key(self._key)
        self.window.set_on_close(self._close)
        self.panel.refresh()
        if request.a is not None:
            self._load()

    # Loading

    def _load(self) -> None:
        request = self.request

        def read(stale: Stale) -> Any:
            scenes = request.scenes()
            return scenes, find_views(request, scenes[0]), find_pruned(request, scenes[0])

        self.panel.say("loading ... (Esc stops)")
        self.worker.submit("load", read, lambda found: self.show(*found), self.fail)

    def show(self, scenes: list[Opened], cameras: list[Any], pruned: Pruned | None) -> None:
        """Show opened scenes in place of those that are there."""
        self.worker.cancel("picture")
        self.worker.cancel("cameras")
        for pane in self.panes:
            pane.widget.visible = False
            pane.widget.scene.clear_geometry()
        self.scenes, self.cameras, self.pruned = scenes, cameras, pruned
        self._views.clear()
        self.panes = [Pane(self.window, scene) for scene in scenes]
        for pane in self.panes:
            self.window.add_child(pane.widget)
            if self._by_hand:
                # Something to see until the first picture is drawn.
                pane.show_points("draft", centres(pane.scene, "colour", None, _MOST[self.device]))
        first = scenes[0]
        self.number = min(self.number, max(len(cameras) - 1, 0))
        self.pose = (
            of_camera(cameras[self.number])
            if cameras
            else overview(first.positions, first.opacities)
        )
        self.panel.say("")
        self.refresh()
        self._show_photograph()
        # Places to look from take seconds to choose: after the first picture, where one is drawn.
        self._without_cameras = not cameras
        if self._without_cameras and not self._by_hand:
            self._choose_cameras()

    def _choose_cameras(self) -> None:
        """Choose places to look from, and go to the first if nobody has moved meanwhile."""
        self._without_cameras = False
        scene, pose = self.scenes[0], self.pose

        def choose(stale: Stale) -> list[Any]:
            return gs_codec.render(scene.cloud, "auto").cameras

        def done(cameras: list[Any]) -> None:
            self.cameras, self.number = cameras, 0
            if self.pose is pose:
                self.pose = of_camera(cameras[0])
                self._arrange()
            self.panel.refresh()

        self.worker.submit("cameras", choose, done, lambda error: self.panel.say(str(error)))

    def open(self, path: str) -> None:
        """Open a file: as the first scene, or as the second if there is one already."""
        before = self.scenes[:1]

        def read(stale: Stale) -> list[Opened]:
            return [*before, open_scene(Path(path))]

        def done(scenes: list[Opened]) -> None:
            self.show(scenes, self.cameras, self.pruned)

        self.panel.say(f"loading {Path(path).name} ... (Esc stops)")
        self.worker.submit("load", read, done, self.fail)

    def fail(self, error: Exception) -> None:
        """Say what went wrong; what was shown stays."""
        if not isinstance(error, (gs_codec.GsCodecError, OSError, MemoryError)):
            raise error
        self.panel.say("")
        self.tell("Not possible", str(error))

    def tell(self, title: str, text: str) -> None:
        """Open a dialog."""
        self.message = (title, text)
        em = self.window.theme.font_size
        dialog = gui.Dialog(title)
        box = gui.Vert(0.5 * em, gui.Margins(em, em, em, em))
        for line in [title, *folded(text, _DIALOG)]:
            box.add_child(gui.Label(line))
        button = gui.Button("OK")
        button.set_on_clicked(self.dismiss)
        row = gui.Horiz()
        row.add_stretch()
        row.add_child(button)
        row.add_stretch()
        box.add_child(row)
        dialog.add_child(box)
        self.window.show_dialog(dialog)

    def dismiss(self) -> None:
        """Close the dialog."""
        self.message = None
        self.window.close_dialog()

    # What is shown

    @property
    def shown(self) -> Shown:
        """What is to be seen."""
        first = self.scenes[0] if self.scenes else None
        reference = first if len(self.scenes) > 1 else None
        return Shown(tuple(self.layers), self.colouring, reference, self.pruned, first)

    def toggle(self, layer: str) -> None:
        """Switch a layer on or off."""
        self.layers ^= {layer}
        self.refresh()

    def set_colouring(self, colouring: str) -> None:
        """Colour centres by something else."""
        self.colouring = colouring
        self.refresh()

    def set_mode(self, mode: str) -> None:
        """Show two scenes in another way."""
        self.mode = mode
        self.refresh()

    def set_place(self, place: float) -> None:
        """Move the wipe."""
        self.place = min(max(place, 0.0), 1.0)
        self._arrange()

    def flip(self) -> None:
        """Show the other scene in the one view."""
        self.mode, self.front = "flip", 1 - self.front if self.mode == "flip" else 0
        self.refresh()

    def go(self, step: int) -> None:
        """Go to the next camera or the one before."""
        if self.cameras:
            self.number = (self.number + step) % len(self.cameras)
            self.pose = of_camera(self.cameras[self.number])
            self._show_photograph()
            self._arrange()
            self.panel.refresh()

    def refresh(self) -> None:
        """Bring panes and panel up to what is to be shown."""
        shown, most = self.shown, _MOST[self.device]
        for pane in self.panes:
            pane.show_splats(self.device == "gpu" and "splats" in self.layers)
            pane.show_boxes(pane.scene.blocks if "boxes" in self.layers else None)
            gone = None
            if "pruned" in self.layers and self.pruned is not None:
                gone = pruned_centres(self.scenes[0], self.pruned, most)
            pane.show_points("pruned", gone)
            if "centres" not in self.layers:
                pane.show_points("centres", None)
        self.panel.legends = []
        if "centres" in self.layers:
            panes = list(self.panes)

            def colour(stale: Stale) -> Any:
                return [centres(p.scene, shown.colouring, shown.reference, most) for p in panes]

            def done(points: Any) -> None:
                for pane, each in zip(panes, points, strict=True):
                    pane.show_points("centres", each)
                self.panel.legends = [each.legend for each in points if each.legend][-1:]
                self.panel.refresh()

            self.worker.submit("centres", colour, done, self.fail)
        self._arrange()
        self.panel.refresh()

    @property
    def _by_hand(self) -> bool:
        """Whether splats are to be drawn by our own rasteriser."""
        return self.device == "cpu" and "splats" in self.layers

    @property
    def busy(self) -> bool:
        """Whether what is seen is not yet all that is to be seen."""
        return self.worker.busy or (self.pose is not None and self._drawn != "full")

    # Layout and cameras

    def _visible(self) -> list[Pane]:
        """The panes that are seen, from left to right."""
        if len(self.panes) > 1 and self.mode == "flip":
            return [self.panes[self.front]]
        return self.panes

    def _arrange(self) -> None:
        """Lay panes out, and draw their pictures anew."""
        self._changed_at, self._drawn = time.monotonic(), None
        self.window.set_needs_layout()
        self.window.post_redraw()

    def _lay_out(self, context: Any) -> None:
        rect = self.window.content_rect
        wide = int(_PANEL_EMS * self.window.theme.font_size)
        wide = min(wide, rect.width // 2)
        self.panel.widget.frame = gui.Rect(rect.get_right() - wide, rect.y, wide, rect.height)
        left, width = rect.x, rect.width - wide
        if self.photograph.visible:
            width -= width // (len(self._places(width)) + 1)
            end = rect.x + rect.width - wide
            self.photograph.frame = gui.Rect(left + width, rect.y, end - left - width, rect.height)
        visible = self._visible()
        for pane in self.panes:
            pane.widget.visible = pane in visible
        for pane, (start, stop, _, _) in zip(visible, self._places(width), strict=True):
            pane.widget.frame = gui.Rect(left + start, rect.y, max(stop - start, 1), rect.height)
        self._width, self._height = width, rect.height
        self._look()

    def _places(self, width: int) -> list[tuple[int, int, int, int]]:
        """For each visible pane: where it starts and stops, the picture's width, and its left."""
        count = len(self._visible())
        if count == 2 and self.mode == "wipe":
            split = min(max(round(self.place * width), 2), width - 1)
            return [(0, split - 1, width, 0), (split, width, width, split)]
        each = width // max(count, 1)
        return [(k * each, (k + 1) * each - (k < count - 1), each, 0) for k in range(count)]

    def _look(self) -> None:
        if self.pose is None:
            return
        for pane, (_, _, width, left) in zip(
            self._visible(), self._places(self._width), strict=True
        ):
            pane.look(self.pose, width, self._height, left)

    def _tick(self) -> bool:
        """Follow cameras that were moved, and draw pictures when they rest."""
        if self.pose is None:
            return False
        for pane in self._visible():
            model = pane.moved()
            if model is not None:
                self.pose = self.pose.moved(model)
                self._changed_at, self._drawn = time.monotonic(), None
                self._look()
                break
        rested = time.monotonic() - self._changed_at > _REST
        wanted = "full" if rested else "coarse"
        if self._drawn not in ("full", wanted):
            self._drawn = wanted
            self._draw(1 if rested else _COARSE)
            return True
        return False

    def _draw(self, coarse: int) -> None:
        """Have the pictures of all visible panes drawn; in full, with the quality of B."""
        visible = list(self._visible())
        by_hand = self._by_hand
        wants_error = "error" in self.layers and len(self.scenes) > 1
        if not (by_hand or wants_error):
            for pane in visible:
                pane.show_picture(None)
        pose, views, scenes = self.pose, self._views, self.scenes
        places, height = self._places(self._width), self._height
        assert pose is not None

        def draw(stale: Stale) -> Any:
            width = max(places[0][2] // coarse, 1)
            low = max(height // coarse, 1)
            images: dict[Opened, NDArray] = {}
            needed = scenes if coarse == 1 or wants_error else [p.scene for p in visible]
            for scene in needed:
                if stale():
                    return None
                images[scene] = splats(views, scene, pose, width, low)
            quality = None
            if coarse == 1 and len(images) == 2 and min(width, low) >= _LEAST_SIDE:
                quality = gs_codec.compare(*images.values())
            legend = None
            if wants_error:
                images[scenes[1]], legend = error_image(images[scenes[0]], images[scenes[1]])
            return (
                [
                    _cut(images[p.scene], place, coarse)
                    for p, place in zip(visible, places, strict=True)
                ],
                quality,
                legend,
            )

        def done(found: Any) -> None:
            if found is None:
                return
            pictures, quality, legend = found
            if by_hand or wants_error:
                for pane, picture in zip(visible, pictures, strict=True):
                    keep = by_hand or pane.scene is not scenes[0]
                    pane.show_picture(picture if keep else None)
            if quality is not None:
                self.quality = quality_text(quality)
            self.panel.error_legend = legend
            self.panel.refresh()
            if self._without_cameras:
                self._choose_cameras()
            self.window.post_redraw()

        if by_hand or wants_error or (coarse == 1 and len(scenes) > 1):
            self.quality = "" if coarse == 1 else self.quality
            self.worker.submit("picture", draw, done, self.fail)

    def _show_photograph(self) -> None:
        self.photograph.visible = False
        if self.request.images is not None and self.cameras:
            try:
                image = find_photograph(self.request.images, self.cameras[self.number].name)
            except gs_codec.GsCodecError as error:
                self.panel.say(str(error))
            else:
                self.photograph.update_image(picture_of(image))
                self.photograph.visible = True
                self.panel.say("")
        self.window.set_needs_layout()

    # Keys and files

    def _key(self, event: Any) -> bool:
        if event.type != gui.KeyEvent.Type.DOWN:
            return False
        return self.press(event.key)

    def press(self, key: int) -> bool:
        """Do what a key asks for; whether it asks for anything."""
        names = {ord(str(k + 1)): layer for k, layer in enumerate(self.panel.boxes)}
        actions = {
            ord("n"): lambda: self.go(1),
            ord("p"): lambda: self.go(-1),
            ord("m"): lambda: self.set_mode(MODES[(MODES.index(self.mode) + 1) % len(MODES)]),
            ord("f"): self.flip,
            ord("c"): self.panel.next_colouring,
            ord("o"): self.ask_open,
            ord("s"): self.ask_save,
            ord("h"): self.help,
            ord("q"): self.window.close,
            int(gui.KeyName.ESCAPE): self.stop_loading,
            int(gui.KeyName.LEFT): lambda: self.set_place(self.place - 0.02),
            int(gui.KeyName.RIGHT): lambda: self.set_place(self.place + 0.02),
        }
        if key in names:
            self.toggle(names[key])
        elif key in actions:
            actions[key]()
        else:
            return False
        return True

    def stop_loading(self) -> None:
        """Leave what is being loaded; what was shown stays."""
        self.worker.cancel("load")
        self.panel.say("")

    def help(self) -> None:
        """List the keys."""
        self.tell("Keys", "\n".join(f"{keys}: {what}" for keys, what in _HELP))

    def ask_open(self) -> None:
        """Ask for a scene's file."""
        kind = (".ply .egs", "3DGS scenes (.ply, .egs)")
        self._ask(gui.FileDialog.OPEN, "Open a scene", kind, self.open)

    def ask_save(self) -> None:
        """Ask where to write a picture of what is shown."""
        kind = (".png", "PNG images (.png)")
        self._ask(gui.FileDialog.SAVE, "Save a picture", kind, self.save)

    def _ask(
        self, purpose: Any, title: str, kind: tuple[str, str], then: Callable[[str], None]
    ) -> None:
        """Ask for a file of a kind, its suffixes and their description."""
        dialog = gui.FileDialog(purpose, title, self.window.theme)
        dialog.add_filter(*kind)
        dialog.set_on_cancel(self.window.close_dialog)

        def done(path: str) -> None:
            self.window.close_dialog()
            then(path)

        dialog.set_on_done(done)
        self.window.show_dialog(dialog)

    def save(self, path: str) -> None:
        """Write a picture of what is shown, drawn in software."""
        if self.pose is None:
            return
        scenes, pose, shown, mode, place = self.scenes, self.pose, self.shown, self.mode, self.place
        if mode == "flip" and len(scenes) > 1:
            scenes, mode = [scenes[self.front]], "side"
        size = (self._width, self._height)

        def draw(stale: Stale) -> None:
            save_picture(compose(scenes, pose, shown, mode, place, size), Path(path))

        def done(_: None) -> None:
            self.panel.say(f"{Path(path).name} is written")

        self.worker.submit("save", draw, done, self.fail)

    def _close(self) -> bool:
        self.worker.end()
        return True


def _cut(image: NDArray, place: tuple[int, int, int, int], coarse: int) -> NDArray[np.float32]:
    """A pane's part of its picture."""
    start, stop, _, left = place
    first = left // coarse
    part = image[:, first : max(first + (stop - start) // coarse, first + 1)]
    return np.clip(part, 0, 1)


def run(request: Request, device: Literal["gpu", "cpu"]) -> None:
    """Open a window and stay until it is closed."""
    app = gui.Application.instance
    app.initialize()
    Viewer(request, device)
    app.run()

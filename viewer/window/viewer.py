"""The viewer's window."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from open3d.visualization import gui

import gs_codec
from gs_codec.rendering.images import find_image
from gs_codec.rendering.photographs import read_photograph
from viewer.pictures.screenshot import compose, save_picture
from viewer.scenes.choice import MODES, Choice
from viewer.scenes.opened import Opened, Pruned, open_scene, turned
from viewer.scenes.request import Request, find_pruned, find_views, first_view
from viewer.scenes.viewpoints import Viewpoint, Views, choose_views, find_viewpoints
from viewer.window import dialogs
from viewer.window.pane import HIDDEN, picture_of
from viewer.window.panel import Panel, monospace
from viewer.window.stage import Stage
from viewer.window.worker import Stale, Worker

#: Width of the panel, in font sizes.
_PANEL_EMS = 19

#: Distance by which a key moves the wipe, relative to the width.
_WIPE = 0.02


class Viewer:
    """A window that shows one scene, or two.

    Parameters
    ----------
    request : Request
    device : {"gpu", "cpu"}
        What draws the window; splats are drawn by Open3D's shader or by gs_codec's rasteriser.

    Attributes
    ----------
    choice : Choice
    stage : Stage
    views : Views
    viewpoints : list of Viewpoint
        The overview, and cameras.
    number : int
        Index of the viewpoint visited last.
    photographed : bool
        Whether a photograph is shown beside the scenes.
    modal : Modal
        The dialog that is open, if one is.
    message : tuple of str or None
        Title and text of the dialog that is open.
    """

    def __init__(self, request: Request, device: Literal["gpu", "cpu"] = "cpu") -> None:
        self.request = request
        self.choice = Choice(
            set(request.layers), request.colouring, request.mode, octree=request.octree
        )
        self.views = Views()
        self.viewpoints: list[Viewpoint] = []
        self.number = 0
        self._moved = False
        self.message: tuple[str, str] | None = None
        self._more_views = False
        font = monospace()
        self.window = gui.Application.instance.create_window("gs-viewer", *request.size)
        self.modal = dialogs.Modal(self.window)
        self.worker = Worker(
            lambda call: gui.Application.instance.post_to_main_thread(self.window, call)
        )
        self.stage = Stage(self.window, self.worker, self.choice, device, self._pictured, self.fail)
        self.panel = Panel(self, font)
        self.photograph = gui.ImageWidget()
        self.photograph.visible = self.photographed = False
        self.window.add_child(self.photograph)
        self.window.add_child(self.panel.widget)
        self._caption = gui.Label("")
        self.window.add_child(self._caption)
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
            scenes = request.scenes(self.worker.progress(stale, self.panel.show_progress))
            return scenes, self._first_views(stale, scenes), find_pruned(request, scenes[0])

        self.panel.say("loading ...", progress=0)
        self.worker.submit("load", read, lambda found: self.show(*found), self.fail)

    def _first_views(self, stale: Stale, scenes: list[Opened]) -> Views:
        """The cameras to begin with; part of the job that loads scenes."""
        if self.request.chosen:
            told = "choosing the first view ..."
            self.worker.progress(stale, partial(self.panel.say, told))("views", 1, 1)
        return find_views(self.request, scenes[0])

    def open(self, path: str, pane: int | None = None) -> None:
        """Open a file as the first scene, the second, or in place of one of two (0 or 1).

        If two scenes are open and `pane` is None, a dialog asks which one to replace.
        """
        before = list(self.stage.scenes)
        if len(before) > 1 and pane is None:
            names = [scene.name for scene in before]
            dialogs.ask_pane(self.modal, Path(path).name, names, partial(self.open, path))
            return
        pane = len(before) if pane is None else pane

        views, chosen = self.views, self.request.chosen

        def read(stale: Stale) -> tuple[list[Opened], Views]:
            progress = self.worker.progress(stale, self.panel.show_progress)
            opened = open_scene(Path(path), progress=progress)
            scenes = [*before[:pane], opened, *before[pane + 1 :]]
            return scenes, self._first_views(stale, scenes) if chosen and not pane else views

        def done(found: tuple[list[Opened], Views]) -> None:
            self.show(*found, self.stage.pruned if pane else None)

        self.panel.say(f"loading {Path(path).name} ...", progress=0)
        self.worker.submit("load", read, done, self.fail)

    def stop_loading(self) -> None:
        """Stop loading; the scenes shown stay."""
        self.worker.cancel("load")
        self.panel.say("")

    def show(self, scenes: list[Opened], views: Views, pruned: Pruned | None) -> None:
        """Show opened scenes instead of the present ones."""
        same = self.stage.scenes[:1] == scenes[:1]
        self.stage.put(scenes, pruned)
        self.panel.say("")
        if same:  # keep the present pose
            self.refresh()
            return
        self.worker.cancel("cameras")
        self.views = views
        self.choice.up = self.request.up or views.ups[0]
        self._find_viewpoints()
        self.refresh()
        self.go_to(first_view(self.request, views))
        # Choosing views takes seconds; if the rasteriser draws, do it after the first full picture.
        self._more_views = views.chosen and len(views.cameras) == 1
        if not self.stage.by_hand:
            self._choose_views()

    def _find_viewpoints(self) -> None:
        self.viewpoints = find_viewpoints(self.stage.scenes[0], self.views, self.choice.up)
        self.stage.navigator.up = self.views.up_axis(self.choice.up)

    def _pictured(self) -> None:
        self.panel.refresh()
        if self.stage.resting:
            self._choose_views()

    def _choose_views(self) -> None:
        """Choose other views of the scene after the overview, which does not change."""
        if not self._more_views:
            return
        self._more_views = False
        scene, up = self.stage.scenes[0], self.request.up

        def choose(stale: Stale) -> Views:
            return choose_views(scene, up)

        def done(views: Views) -> None:
            self.panel.say("")
            here = self.viewpoints[0]
            self.views = views
            self._find_viewpoints()
            self.viewpoints[0] = here
            self.panel.refresh()

        self.panel.say("choosing views ...")
        self.worker.submit("cameras", choose, done, lambda error: self.panel.say(str(error)))

    def fail(self, error: Exception) -> None:
        """Show an error in a dialog; the scenes shown stay."""
        if not isinstance(error, (gs_codec.GsCodecError, OSError, MemoryError)):
            raise error
        self.panel.say("")
        self.tell("Not possible", str(error))

    def tell(self, title: str, text: str) -> None:
        """Open a dialog."""
        self.message = (title, text)
        dialogs.show_message(self.modal, title, text, self.dismiss)

    def dismiss(self) -> None:
        """Close the dialog."""
        self.message = None
        self.modal.close_dialog()

    # What is shown

    def refresh(self) -> None:
        """Update panes and panel to the choice."""
        self.stage.refresh()
        self.panel.refresh()

    def toggle(self, layer: str) -> None:
        """Switch a layer on or off."""
        self.choice.layers ^= {layer}
        self.refresh()

    def set_colouring(self, colouring: str) -> None:
        """Colour centres by another quantity."""
        self.choice.colouring = colouring
        self.refresh()

    def set_octree(self, **changes: Any) -> None:
        """Change the depth or the colouring of the octree's cells."""
        self.choice.octree = replace(self.choice.octree, **changes)
        self.stage.show_octree()

    def set_mode(self, mode: str) -> None:
        """Set how two scenes are shown."""
        self.choice.mode = mode
        self.refresh()

    def set_wipe(self, wipe: float) -> None:
        """Move the wipe."""
        self.stage.wipe_to(wipe)

    def flip(self) -> None:
        """Show the other of two scenes, in one view."""
        choice = self.choice
        choice.mode, choice.front = "flip", 1 - choice.front if choice.mode == "flip" else 0
        self.refresh()

    def set_up(self, up: str) -> None:
        """Set the up axis, for the overview and for cameras chosen from the scene."""
        self.choice.up = up
        if self.viewpoints:
            self._find_viewpoints()
            self.go_to(self.number if self.request.chosen else 0)

    def turn(self) -> None:
        """Convert B from the other coordinate system, or back; for files that do not state it."""
        if len(self.stage.scenes) < 2:
            return
        first, second = self.stage.scenes

        def done(scene: Opened) -> None:
            self.show([first, scene], self.views, self.stage.pruned)

        self.worker.submit("load", lambda stale: turned(second), done, self.fail)

    def go(self, step: int) -> None:
        """Go to the next or previous viewpoint."""
        if self.viewpoints:
            self.go_to((self.number + step) % len(self.viewpoints))

    def reset(self) -> None:
        """Go back to the viewpoint visited last."""
        if self.viewpoints:
            self.go_to(self.number)

    def overview(self) -> None:
        """Go to the overview."""
        if self.viewpoints:
            self.go_to(0)

    def go_to(self, number: int) -> None:
        """Go to a viewpoint by its index."""
        self.number = number
        self._show_photograph()
        self.stage.look_from(self.viewpoints[number].pose)
        self.panel.refresh()

    @property
    def moved(self) -> bool:
        """Whether the pose has moved away from the viewpoint visited last."""
        return bool(self.viewpoints) and self.stage.pose is not self.viewpoints[self.number].pose

    @property
    def where(self) -> str:
        """Text that describes the present viewpoint."""
        count = len(self.viewpoints) - 1
        text = f"overview; {count} views"
        if self.number:
            index, count = self.number - self.views.first, len(self.views.cameras)
            text = f"view {index} of {count}: {self.viewpoints[self.number].name}"
        return f"moved away from {text} (R goes back)" if self.moved else text

    def _tick(self) -> bool:
        drawn = self.stage.tick()
        if self.moved != self._moved:
            self._moved = self.moved
            self.panel.refresh()
        return drawn

    @property
    def busy(self) -> bool:
        """Whether the window is still loading or drawing."""
        return self.worker.busy or not self.stage.resting

    def _show_photograph(self) -> None:
        self.photographed = False
        if self.request.images is not None and self.number:
            try:
                shown = self.viewpoints[self.number]
                path = find_image(self.request.images, shown.name)
                _, image = read_photograph(shown.camera, path)
            except gs_codec.GsCodecError as error:
                self.panel.say(str(error))
            else:
                pixels = np.rint(255 * image).astype(np.uint8)
                self.photograph.update_image(picture_of(pixels))
                self.photograph.visible = self.photographed = True
                self.panel.say("")
        self.window.set_needs_layout()

    def _lay_out(self, context: Any) -> None:
        rect = self.window.content_rect
        wide = int(_PANEL_EMS * self.window.theme.font_size)
        wide = min(wide, rect.width // 2)
        self.panel.widget.frame = gui.Rect(rect.get_right() - wide, rect.y, wide, rect.height)
        width = rest = rect.width - wide
        # Hide it behind the panel, because Open3D makes it larger than HIDDEN.
        self.photograph.frame = gui.Rect(rect.get_right() - wide // 2, rect.y, *HIDDEN)
        self._caption.visible = self.photographed
        if self.photographed:
            panes = 1 if self.choice.mode == "wipe" else max(len(self.stage.visible), 1)
            width -= width // (panes + 1)
            left, line = rect.x + width, self.stage.caption_height
            below = gui.Rect(left, rect.y + line, rest - width, rect.height - line)
            self.photograph.frame = below
            self._caption.frame = gui.Rect(left, rect.y, rest - width, line)
            photograph = f" photograph of {self.viewpoints[self.number].name}"
            self._caption.text = photograph + (" (you have moved away)" if self.moved else "")
        self.stage.lay_out(rect.x, rect.y, width, rect.height)

    # Keys and files

    def _key(self, event: Any) -> bool:
        if self.modal.key(event):
            return True
        return event.type == gui.KeyEvent.Type.DOWN and self.press(event.key)

    def press(self, key: int) -> bool:
        """Do the action of a key; tell whether it has one."""
        wipe = self.choice.wipe
        modes = MODES[1:] + MODES[:1]
        actions: dict[int, Callable[[], None]] = {
            ord("n"): lambda: self.go(1),
            ord("p"): lambda: self.go(-1),
            ord("m"): lambda: self.set_mode(modes[MODES.index(self.choice.mode)]),
            ord("f"): self.flip,
            ord("c"): self.panel.next_colouring,
            ord("r"): self.reset,
            ord("u"): self.panel.next_up,
            ord("t"): self.turn,
            int(gui.KeyName.HOME): self.overview,
            ord("o"): self.ask_open,
            ord("s"): self.ask_save,
            ord("h"): self.help,
            ord("q"): self.window.close,
            int(gui.KeyName.BACKSPACE): self.stop_loading,
            int(gui.KeyName.LEFT): lambda: self.set_wipe(wipe - _WIPE),
            int(gui.KeyName.RIGHT): lambda: self.set_wipe(wipe + _WIPE),
        }
        for number, layer in enumerate(self.panel.boxes, 1):
            actions[ord(str(number))] = partial(self.toggle, layer)
        if key not in actions:
            return False
        actions[key]()
        return True

    def help(self) -> None:
        """List the keys."""
        self.tell("Keys", dialogs.HELP)

    def ask_open(self) -> None:
        """Ask for a scene's file, and open it."""
        dialogs.ask_open(self.modal, self.open)

    def ask_save(self) -> None:
        """Ask where to write a picture, and write it."""
        dialogs.ask_save(self.modal, self.save)

    def save(self, path: str) -> None:
        """Write a picture of what is shown, drawn in software."""
        stage, mode, wipe = self.stage, self.choice.mode, self.choice.wipe
        if stage.pose is None:
            return
        pose, shown, size, front = stage.pose, stage.shown, stage.size, self.choice.front

        def draw(stale: Stale) -> None:
            picture = compose(pose, shown, mode, wipe, size, front=front)
            save_picture(picture, Path(path))

        def done(_: None) -> None:
            self.panel.say(f"{Path(path).name} is written")

        self.worker.submit("save", draw, done, self.fail)

    def _close(self) -> bool:
        if not self.modal.close():
            return False
        self.worker.end()
        return True


def run(request: Request, device: Literal["gpu", "cpu"]) -> None:
    """Open a window and stay until it is closed."""
    app = gui.Application.instance
    app.initialize()
    Viewer(request, device)
    app.run()

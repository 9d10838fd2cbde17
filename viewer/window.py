"""The viewer's window."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Literal

from open3d.visualization import gui

import gs_codec
from viewer import dialogs
from viewer.choice import MODES, Choice
from viewer.opened import Opened, Pruned, open_scene
from viewer.pane import HIDDEN, picture_of
from viewer.panel import Panel, monospace
from viewer.photograph import find_photograph
from viewer.pose import of_camera, overview, up_of
from viewer.request import Request, find_pruned, find_views
from viewer.screenshot import compose, save_picture
from viewer.stage import Stage
from viewer.worker import Stale, Worker

#: Width of the panel, in heights of a line.
_PANEL_EMS = 19

#: How far a key moves the wipe.
_WIPE = 0.02


class Viewer:
    """A window that shows one scene, or two.

    Parameters
    ----------
    request : Request
    device : {"gpu", "cpu"}
        What the window is drawn by; splats by Open3D's shader or by our own rasteriser.

    Attributes
    ----------
    choice : Choice
    stage : Stage
    cameras : list
        Places to look from.
    number : int
        Of the one that was gone to last.
    photographed : bool
        Whether a photograph is beside the scenes.
    modal : Modal
        The dialog that is open, if one is.
    message : tuple of str or None
        Title and text of the dialog that is open.
    """

    def __init__(self, request: Request, device: Literal["gpu", "cpu"] = "cpu") -> None:
        self.request = request
        self.choice = Choice(set(request.layers), request.colouring, request.mode)
        self.cameras: list[Any] = []
        self.number = request.view or 0
        self.message: tuple[str, str] | None = None
        self._without_cameras = False
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
        self.window.set_on_layout(self._lay_out)
        self.window.set_on_tick_event(self.stage.tick)
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
            return scenes, find_views(request, scenes[0]), find_pruned(request, scenes[0])

        self.panel.say("loading ...", progress=0)
        self.worker.submit("load", read, lambda found: self.show(*found), self.fail)

    def open(self, path: str) -> None:
        """Open a file: as the first scene, or as the second if there is one already."""
        before = self.stage.scenes[:1]

        def read(stale: Stale) -> list[Opened]:
            progress = self.worker.progress(stale, self.panel.show_progress)
            return [*before, open_scene(Path(path), progress=progress)]

        def done(scenes: list[Opened]) -> None:
            self.show(scenes, self.cameras, self.stage.pruned)

        self.panel.say(f"loading {Path(path).name} ...", progress=0)
        self.worker.submit("load", read, done, self.fail)

    def stop_loading(self) -> None:
        """Leave what is being loaded; what was shown stays."""
        self.worker.cancel("load")
        self.panel.say("")

    def show(self, scenes: list[Opened], cameras: list[Any], pruned: Pruned | None) -> None:
        """Show opened scenes in place of those that are there."""
        self.worker.cancel("cameras")
        self.cameras = cameras
        self.number = min(self.number, max(len(cameras) - 1, 0))
        first = scenes[0]
        self.stage.put(scenes, pruned)
        if cameras:
            self.stage.navigator.up = up_of([camera.rotation for camera in cameras])
        self.stage.look_from(
            of_camera(cameras[self.number])
            if cameras
            else overview(first.positions, first.opacities)
        )
        self.panel.say("")
        self.refresh()
        self._show_photograph()
        # Places to look from take seconds to choose: after the first picture, where one is drawn.
        self._without_cameras = not cameras
        if not self.stage.by_hand:
            self._choose_cameras()

    def _pictured(self) -> None:
        self.panel.refresh()
        self._choose_cameras()

    def _choose_cameras(self) -> None:
        """Choose places to look from where there are none, and go to the first.

        If nobody has moved meanwhile.
        """
        if not self._without_cameras:
            return
        self._without_cameras = False
        scene, pose = self.stage.scenes[0], self.stage.pose

        def choose(stale: Stale) -> list[Any]:
            return gs_codec.render(scene.cloud, "auto").cameras

        def done(cameras: list[Any]) -> None:
            self.panel.say("")
            self.cameras, self.number = cameras, 0
            if self.stage.pose is pose:
                self.stage.look_from(of_camera(cameras[0]))
            self.panel.refresh()

        self.panel.say("choosing views ...")
        self.worker.submit("cameras", choose, done, lambda error: self.panel.say(str(error)))

    def fail(self, error: Exception) -> None:
        """Say what went wrong; what was shown stays."""
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
        """Bring panes and panel up to what was chosen."""
        self.stage.refresh()
        self.panel.refresh()

    def toggle(self, layer: str) -> None:
        """Switch a layer on or off."""
        self.choice.layers ^= {layer}
        self.refresh()

    def set_colouring(self, colouring: str) -> None:
        """Colour centres by something else."""
        self.choice.colouring = colouring
        self.refresh()

    def set_mode(self, mode: str) -> None:
        """Show two scenes in another way."""
        self.choice.mode = mode
        self.refresh()

    def set_place(self, place: float) -> None:
        """Move the wipe."""
        self.choice.place = min(max(place, 0.0), 1.0)
        self.stage.arrange()

    def flip(self) -> None:
        """Show the other scene in the one view."""
        choice = self.choice
        choice.mode, choice.front = "flip", 1 - choice.front if choice.mode == "flip" else 0
        self.refresh()

    def go(self, step: int) -> None:
        """Go to the next camera or the one before."""
        if self.cameras:
            self.number = (self.number + step) % len(self.cameras)
            self._show_photograph()
            self.stage.look_from(of_camera(self.cameras[self.number]))
            self.panel.refresh()

    @property
    def busy(self) -> bool:
        """Whether what is seen is not yet all that is to be seen."""
        return self.worker.busy or not self.stage.resting

    def _show_photograph(self) -> None:
        self.photographed = False
        if self.request.images is not None and self.cameras:
            try:
                image = find_photograph(self.request.images, self.cameras[self.number].name)
            except gs_codec.GsCodecError as error:
                self.panel.say(str(error))
            else:
                self.photograph.update_image(picture_of(image))
                self.photograph.visible = self.photographed = True
                self.panel.say("")
        self.window.set_needs_layout()

    def _lay_out(self, context: Any) -> None:
        rect = self.window.content_rect
        wide = int(_PANEL_EMS * self.window.theme.font_size)
        wide = min(wide, rect.width // 2)
        self.panel.widget.frame = gui.Rect(rect.get_right() - wide, rect.y, wide, rect.height)
        width = rest = rect.width - wide
        # Behind the panel, as Open3D makes it larger than that.
        self.photograph.frame = gui.Rect(rect.get_right() - wide // 2, rect.y, *HIDDEN)
        if self.photographed:
            panes = 1 if self.choice.mode == "wipe" else max(len(self.stage.visible), 1)
            width -= width // (panes + 1)
            self.photograph.frame = gui.Rect(rect.x + width, rect.y, rest - width, rect.height)
        self.stage.lay_out(rect.x, rect.y, width, rect.height)

    # Keys and files

    def _key(self, event: Any) -> bool:
        if self.modal.key(event):
            return True
        return event.type == gui.KeyEvent.Type.DOWN and self.press(event.key)

    def press(self, key: int) -> bool:
        """Do what a key asks for; whether it asks for anything."""
        place = self.choice.place
        modes = MODES[1:] + MODES[:1]
        actions: dict[int, Callable[[], None]] = {
            ord("n"): lambda: self.go(1),
            ord("p"): lambda: self.go(-1),
            ord("m"): lambda: self.set_mode(modes[MODES.index(self.choice.mode)]),
            ord("f"): self.flip,
            ord("c"): self.panel.next_colouring,
            ord("o"): self.ask_open,
            ord("s"): self.ask_save,
            ord("h"): self.help,
            ord("q"): self.window.close,
            int(gui.KeyName.BACKSPACE): self.stop_loading,
            int(gui.KeyName.LEFT): lambda: self.set_place(place - _WIPE),
            int(gui.KeyName.RIGHT): lambda: self.set_place(place + _WIPE),
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
        stage, mode, place = self.stage, self.choice.mode, self.choice.place
        if stage.pose is None:
            return
        scenes, pose, shown, size = stage.scenes, stage.pose, stage.shown, stage.size
        if mode == "flip" and len(scenes) > 1:
            scenes, mode = [scenes[self.choice.front]], "side"

        def draw(stale: Stale) -> None:
            save_picture(compose(scenes, pose, shown, mode, place, size), Path(path))

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

"""The viewer's window."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from open3d.visualization import gui, rendering

import gs_codec
from gs_codec.runtime.arrays import release_large_when_freed
from viewer.pictures.screenshot import compose, save_picture
from viewer.scenes.choice import COLOURINGS, MODES, SCALES, Choice
from viewer.scenes.typed_paths import PICTURES
from viewer.scenes.view_request import Request
from viewer.window import dialogs
from viewer.window.background_encoding import Encoding
from viewer.window.dock import Dock
from viewer.window.editor import Editor
from viewer.window.file_dialog import Files
from viewer.window.keys import Keys, help_text
from viewer.window.loading import Loading
from viewer.window.mouse import Place
from viewer.window.navigation import field_of_view, framing, with_field_of_view
from viewer.window.notice import Notice
from viewer.window.pane import Pane
from viewer.window.panel import EMS, Panel
from viewer.window.picking import Picking
from viewer.window.saved import Saved
from viewer.window.stage import Stage
from viewer.window.visits import Visits
from viewer.window.widgets import monospace
from viewer.window.worker import Stale, Worker

#: Longest step of a flight, seconds, after frames that took long.
_STEP = 0.2

#: Fields of view that differ by less are the same, degrees.
_SAME_ANGLE = 0.01


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
    visits : Visits
    loading : Loading
    saved : Saved
    picking : Picking
    encoding : Encoding
    panel : Panel
    dock : Dock
    editor : Editor
    keys : Keys
    notice : Notice
    modal : Modal
        The dialog that is open, if one is.
    files : Files
    message : tuple of str or None
        Title and text of the dialog that is open.
    """

    def __init__(self, request: Request, device: Literal["gpu", "cpu"] = "cpu") -> None:
        self.request = request
        self.choice = Choice(
            set(request.layers), request.colouring, request.mode, octree=request.octree
        )
        if request.scale is not None:
            self.choice.scales[request.colouring] = request.scale
        self.message: tuple[str, str] | None = None
        # Else pictures of ever other sizes leave gaps in the process's memory.
        release_large_when_freed()
        font = monospace()
        self.window = gui.Application.instance.create_window("gs-viewer", *request.size)
        self.modal, self.files = dialogs.Modal(self.window), Files(self)
        self.worker = Worker(self.post)
        self.stage = Stage(
            self.window,
            self.worker,
            self.choice,
            device,
            self._pictured,
            self.fail,
            self._clicked,
            self._focused,
        )
        self.visits, self.loading, self.saved = Visits(self), Loading(self), Saved(self)
        self.picking, self.editor, self.encoding = Picking(self), Editor(self), Encoding(self)
        self.dock = Dock(self, self.editor.select_range)
        self.panel, self.keys, self.notice = Panel(self, font), Keys(self), Notice(self)
        self._ticked = time.monotonic()
        self._unseen = rendering.Open3DScene(self.window.renderer)
        self.window.set_on_layout(self._lay_out)
        self.window.set_on_tick_event(self._tick)
        self.window.set_on_key(self.keys.event)
        self.window.set_on_close(self._close)
        self.panel.refresh()
        if request.a is not None:
            self.loading.begin()

    def post(self, call: Callable[[], None]) -> None:
        """Make the window's thread call a function."""
        gui.Application.instance.post_to_main_thread(self.window, call)

    def _pictured(self) -> None:
        self.panel.refresh()
        if self.stage.resting:
            self.visits.choose_more()

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
        """Update panes, dock and panel to the choice."""
        self.stage.refresh()
        self.refresh_panel()

    def refresh_panel(self) -> None:
        """Update dock and panel, the panes being as they should be."""
        self.dock.refresh()
        self.panel.refresh()

    def toggle(self, layer: str) -> None:
        """Switch a layer on or off."""
        self.choice.layers ^= {layer}
        self.refresh()

    def set_colouring(self, colouring: str) -> None:
        """Colour centres by another quantity."""
        self.choice.colouring = colouring
        self.refresh()

    def next_colouring(self) -> None:
        """Colour centres by the next of `COLOURINGS`."""
        index = (COLOURINGS.index(self.choice.colouring) + 1) % len(COLOURINGS)
        self.set_colouring(COLOURINGS[index])

    def set_logarithmic(self, logarithmic: bool) -> None:
        """Set whether the scale of the present colours of centres is logarithmic."""
        self.choice.scales[self.choice.colouring] = SCALES[logarithmic]
        self.refresh()

    def set_octree(self, **changes: Any) -> None:
        """Change the depth or the colouring of the octree's cells."""
        self.choice.octree = replace(self.choice.octree, **changes)
        self.stage.show_octree()

    def set_exact(self, exact: bool) -> None:
        """Set whether splats are drawn by gs_codec's rasteriser on a graphics card, too."""
        self.choice.exact = exact
        self.refresh()

    def set_appearance(self, **changes: Any) -> None:
        """Change how splats are drawn: fields of `Appearance`."""
        appearance = replace(self.choice.appearance, **changes)
        # A slider also reports what it is set to.
        if appearance != self.choice.appearance:
            self.choice.appearance = appearance
            self.stage.restyle()
            self.panel.refresh()

    def set_mode(self, mode: str) -> None:
        """Set how two scenes are shown."""
        self.choice.mode = mode
        self.refresh()

    def next_mode(self) -> None:
        """Show two scenes in the next of `MODES`."""
        self.set_mode(MODES[(MODES.index(self.choice.mode) + 1) % len(MODES)])

    def set_wipe(self, wipe: float) -> None:
        """Move the wipe."""
        self.stage.wipe_to(wipe)

    def flip(self) -> None:
        """Show the other of two scenes, in one view."""
        choice = self.choice
        choice.mode, choice.front = "flip", 1 - choice.front if choice.mode == "flip" else 0
        self.refresh()

    def set_dock(self, dock: str) -> None:
        """Show another of `DOCKS` below the panes."""
        self.choice.dock = dock
        self.window.set_needs_layout()
        self.stage.arrange()
        self.refresh_panel()

    def next_dock(self) -> None:
        """Show the next of `DOCKS` below the panes."""
        self.set_dock(self.dock.next())

    # Where one looks from

    def set_flying(self, flying: bool) -> None:
        """Make drags look around, or turn about the point ahead."""
        self.choice.flying = flying
        self.panel.refresh()

    def set_field_of_view(self, degrees: float) -> None:
        """Set the vertical field of view of the frame."""
        pose = self.stage.pose
        # A slider also reports what it is set to.
        if pose is not None and abs(degrees - field_of_view(pose)) > _SAME_ANGLE:
            self.stage.steer(with_field_of_view(pose, degrees))

    def frame_all(self) -> None:
        """Go back, or nearer, until all of the scene is seen."""
        if self.stage.pose is not None:
            scene = self.stage.scenes[0]
            self.stage.look_from(*framing(self.stage.pose, scene.positions, scene.opacities))

    def _clicked(self, pane: Pane, at: Place) -> None:
        self.picking.click(pane, at)

    def _focused(self, pane: Pane, at: Place) -> None:
        self.stage.focus(pane, at)

    def _tick(self) -> bool:
        now = time.monotonic()
        seconds, self._ticked = min(now - self._ticked, _STEP), now
        thrust, pose = self.keys.thrust, self.stage.pose
        if thrust is not None and pose is not None:
            self.stage.steer(self.stage.navigator.flown(pose, thrust, seconds))
        flown = self.saved.tick()
        worked = self.modal.tick() | self.notice.tick()
        drawn = self.stage.tick()
        self.visits.tick()
        return drawn or flown or worked or (thrust is not None and not self.stage.painter.leads)

    @property
    def busy(self) -> bool:
        """Whether the window is still loading or drawing."""
        working = self.worker.busy or self.editor.worker.busy
        drawing = self.saved.flying or not self.stage.resting
        return working or drawing or self.notice.compiles

    def _lay_out(self, context: Any) -> None:
        rect = self.window.content_rect
        wide = min(int(EMS * self.window.theme.font_size), rect.width // 2)
        beside = gui.Rect(rect.get_right() - wide, rect.y, wide, rect.height)
        self.panel.lay_out(beside, context)
        below = min(self.dock.height, rect.height // 2)
        space = gui.Rect(rect.x, rect.y, rect.width - wide, rect.height - below)
        hidden = gui.Rect(beside.x + wide // 2, rect.y, 1, 1)
        self.dock.lay_out(gui.Rect(space.x, space.get_bottom(), space.width, below), hidden)
        panes = 1 if self.choice.mode == "wipe" else max(len(self.stage.visible), 1)
        width = self.visits.lay_out(space, panes, self.stage.caption_height, hidden)
        self.stage.lay_out(space.x, space.y, width, space.height)
        self.notice.lay_out(space, context)
        # Open3D waits for the device before it draws a picture that was asked for, and then does
        # not skip the frame. After a skipped one the interface could still use the old pictures of
        # widgets when these change their sizes again, and Open3D would abort.
        self._unseen.scene.render_to_image(lambda _: None)

    # Files

    def help(self) -> None:
        """List the keys."""
        self.tell("Keys", help_text())

    def ask_save(self) -> None:
        """Ask where to write a picture, and write it."""
        self.files.ask_save("Save a picture", PICTURES, self.save)

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
        if not self.modal.close() or self.editor.ask_unsaved((0, 1), self.window.close):
            return False
        self.worker.end()
        self.encoding.close()
        return True


def run(request: Request, device: Literal["gpu", "cpu"]) -> None:
    """Open a window and stay until it is closed."""
    app = gui.Application.instance
    app.initialize()
    Viewer(request, device)
    app.run()

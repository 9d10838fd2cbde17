"""The viewer's window."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Literal

from open3d.visualization import gui, rendering

import gs_codec
from gs_codec.cli.main import describe_error
from gs_codec.runtime.arrays import release_large_when_freed
from viewer.scenes.choice import Choice
from viewer.scenes.view_request import Request
from viewer.scenes.worker import Result, Stale, Worker
from viewer.window import dialogs
from viewer.window.annotating import Annotating
from viewer.window.background_encoding import Encoding
from viewer.window.controls import Controls
from viewer.window.dock import Dock
from viewer.window.editor import Editor
from viewer.window.file_dialog import Files
from viewer.window.keys import Keys, help_text
from viewer.window.loading import Loading
from viewer.window.measuring import Measuring
from viewer.window.mouse import Place
from viewer.window.notice import Notice
from viewer.window.pane import Pane
from viewer.window.panel import EMS, Panel, divided
from viewer.window.picking import Picking
from viewer.window.placing import Placing
from viewer.window.player import Player
from viewer.window.stage import Stage
from viewer.window.start import Start
from viewer.window.timeline import Timeline
from viewer.window.visits import Visits
from viewer.window.watching import Watching
from viewer.window.widgets import monospace

#: Maximum time step of a flight, seconds, after slow frames.
_STEP = 0.2


class Viewer(Controls):
    """A window that shows one or two scenes.

    Parameters
    ----------
    request : Request
    device : {"gpu", "cpu"}
        Device that draws the window: splats are drawn by Open3D's shader on a GPU, or by gs_codec's
        rasteriser.

    Attributes
    ----------
    tabs : gui.TabControl
        Those of the panel.
    choice : Choice
    stage : Stage
    visits : Visits
    loading : Loading
    watching : Watching
    start : Start
    timeline : Timeline
    measuring : Measuring
    annotating : Annotating
    picking : Picking
    encoding : Encoding
    panel : Panel
    dock : Dock
    editor : Editor
    placing : Placing
    player : Player
    keys : Keys
    notice : Notice
    modal : Modal
        The open dialog, if any, and Esc.
    files : Files
    message : tuple of str or None
        Title and text of the open dialog.
    """

    def __init__(self, request: Request, device: Literal["gpu", "cpu"] = "cpu") -> None:
        self.request = request
        self.choice = Choice(
            set(request.layers), request.colouring, request.mode, octree=request.octree
        )
        if request.scale is not None:
            self.choice.scales[request.colouring] = request.scale
        self.message: tuple[str, str] | None = None
        self.loads = ""
        self._later: list[tuple[str, str]] = []
        # Otherwise changing picture sizes would fragment the heap.
        release_large_when_freed()
        font = monospace()
        self.window = gui.Application.instance.create_window("gs-viewer", *request.size)
        wide, high = request.size
        self.window.size = gui.Size(max(wide, EMS * self.window.theme.font_size), high)
        # The first child: if one before it comes or goes, Open3D selects the first tab.
        self.tabs = gui.TabControl()
        self.window.add_child(self.tabs)
        self.modal = dialogs.Modal(self.window)
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
        self.files = Files(self.modal, self.stage)
        self.visits, self.picking = Visits(self), Picking(self)
        self.timeline, self.measuring = Timeline(self), Measuring(self)
        self.annotating = Annotating(self)
        self.dock = Dock(self, self.visits, self.timeline, self._select_range)
        self.editor = Editor(self, self.visits, self.dock)
        self.placing = Placing(self, self.editor)
        self.loading = Loading(self, self.visits, self.editor)
        self.watching = Watching(self, self.loading, self.editor)
        self.start = Start(self, self.loading)
        self.encoding = Encoding(self, self.visits, self.loading, self._encoding_changed)
        self.player = Player(self, self.visits, self.editor, self.loading, self.encoding)
        self.panel: Panel = Panel(self, font)
        self.keys, self.notice = Keys(self), Notice(self)
        self._ticked, self._closes = time.monotonic(), False
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
        self._closes = False
        if not isinstance(error, (gs_codec.GsCodecError, OSError, MemoryError)):
            raise error
        self.panel.say("")
        self.tell("Not possible", describe_error(error))

    def tell(self, title: str, text: str) -> None:
        """Open a dialog, after the one that is open."""
        if self.modal.dialog is not None:
            if (title, text) not in (self.message, *self._later):
                self._later.append((title, text))
            return
        self.message = (title, text)
        dialogs.show_message(self.modal, title, text, self.dismiss)

    def dismiss(self) -> None:
        """Close the dialog."""
        self.message = None
        self.modal.close_dialog()

    def may_load(self) -> bool:
        """Whether loading may begin; a dialog says if something else is being loaded."""
        if self.loads:
            self.tell("Not possible", f"{self.loads}: wait for it, or stop it (Backspace)")
        return not self.loads

    def load(
        self,
        text: str,
        job: Callable[[Stale], Result],
        done: Callable[[Result], None],
        failed: Callable[[Exception], None] | None = None,
    ) -> None:
        """Load something in the background if `may_load`; `failed` is by default `fail`."""
        if self.may_load():
            self.loads = text
            self.panel.say(f"{text} ...", progress=0)
            self.worker.submit("load", job, self._ended(done), self._ended(failed or self.fail))

    def _ended(self, call: Callable[[Result], None]) -> Callable[[Result], None]:
        def end(result: Result) -> None:
            self.loads = ""
            call(result)

        return end

    def _select_range(self, name: str, low: float, high: float) -> None:
        self.editor.select_range(name, low, high)

    def _encoding_changed(self) -> None:
        self.panel.rate.refresh()

    def _clicked(self, pane: Pane, at: Place) -> None:
        tools = (self.measuring, self.annotating)
        next((tool for tool in tools if tool.on), self.picking).click(pane, at)

    def _focused(self, pane: Pane, at: Place) -> None:
        self.stage.focus(pane, at)

    def _tick(self) -> bool:
        now = time.monotonic()
        seconds, self._ticked = min(now - self._ticked, _STEP), now
        thrust, pose = self.keys.thrust, self.stage.pose
        if thrust is not None and pose is not None:
            self.stage.steer(self.stage.navigator.flown(pose, thrust, seconds))
        flown = self.timeline.tick()
        self.player.tick()
        worked = self.modal.tick() | self.notice.tick()
        tool = self.annotating if self.annotating.on else self.measuring
        worked |= self.stage.show_tag(*tool.tag)
        drawn = self.stage.tick()
        self.panel.show_speed(self.stage.painter.seconds)
        self.visits.tick()
        self.watching.tick()
        if self._later and self.modal.dialog is None:
            self.tell(*self._later.pop(0))
        if self._closes and not self._saving and not self.timeline.filming:
            self.post(self._close_saved)  # after the result of saving
        return drawn or flown or worked or (thrust is not None and not self.stage.painter.leads)

    @property
    def busy(self) -> bool:
        """Whether the window is still loading or drawing."""
        working = self.worker.busy or self.editor.worker.busy
        drawing = self.timeline.flying or self.player.busy or not self.stage.resting
        return working or drawing or self.notice.compiles

    def _lay_out(self, context: gui.LayoutContext) -> None:
        side, room = divided(self.window.content_rect, self.window.theme.font_size)
        self.panel.lay_out(side, context)
        below = min(self.dock.height, room.height // 2)
        bar = self.player.bar.height
        space = gui.Rect(room.x, room.y, room.width, room.height - below - bar)
        hidden = gui.Rect(side.x + side.width // 2, side.y, 1, 1)
        self.player.bar.lay_out(gui.Rect(space.x, space.get_bottom(), space.width, bar), hidden)
        top = space.get_bottom() + bar
        self.dock.lay_out(gui.Rect(space.x, top, space.width, below), hidden)
        panes = 1 if self.choice.mode == "wipe" else max(len(self.stage.visible), 1)
        width = self.visits.lay_out(space, panes, self.stage.caption_height, hidden)
        self.stage.lay_out(space.x, space.y, width, space.height)
        self.notice.lay_out(space, context)
        self.start.lay_out(space, context)
        # Requesting a picture makes Open3D wait for the device, so it does not skip the frame.
        # After a skipped frame, the interface could still use old pictures of widgets while these
        # are resized again, and Open3D would abort.
        self._unseen.scene.render_to_image(lambda _: None)

    # Files

    def help(self) -> None:
        """Show the list of keys."""
        self.tell("Keys", help_text())

    @property
    def _saving(self) -> bool:
        kinds = self.worker.kinds | self.editor.worker.kinds
        return any(kind.startswith("save ") for kind in kinds)

    def _close_later(self) -> None:
        """Close the window after what is being written."""
        self._closes = not self._later  # no failure to show

    def _close_saved(self) -> None:
        """Close the window, unless saving has failed."""
        if self._closes:
            self._closes = False
            self.window.close()

    def _close(self) -> bool:
        if not self.modal.close():
            return False
        if self._saving:
            self._close_later()
            return False
        if self.editor.ask_unsaved((0, 1), self.window.close):
            return False
        if any(each.ask_unsaved(self.window.close) for each in (self.annotating, self.timeline)):
            return False
        self._closes = False
        if self.timeline.ask_unfinished(self._close_later, self.window.close):
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

"""Playing sequences: a bar with a slider, and the frames of all sequences at the same moment."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from open3d.visualization import gui

from viewer.scenes.clip import Moment
from viewer.scenes.frame_scenes import at_moment, first_moment
from viewer.scenes.opened import Opened
from viewer.scenes.worker import Stale
from viewer.window.background_encoding import Encoding
from viewer.window.editor import Editor
from viewer.window.loading import Loading
from viewer.window.pane import HIDDEN
from viewer.window.shared import Host
from viewer.window.visits import Visits
from viewer.window.widgets import Widgets


class Player:
    """The frame shown of the first sequence of a window; others follow in time.

    Frames are read in a thread of their own: while one plays, the next.

    Parameters
    ----------
    viewer : Host
    visits : Visits
    editor : Editor
    loading : Loading
    encoding : Encoding

    Attributes
    ----------
    wanted : int
        Number of the frame to show next, which the slider names.
    playing, loop : bool
    bar : Bar
    """

    def __init__(
        self, viewer: Host, visits: Visits, editor: Editor, loading: Loading, encoding: Encoding
    ) -> None:
        self._viewer, self._visits, self._editor = viewer, visits, editor
        self._loading, self._encoding = loading, encoding
        self._worker = viewer.worker.another()
        self._scenes: Sequence[Opened] = ()
        self._coming: list[Opened] | None = None
        self.wanted, self.playing, self.loop = 0, False, True
        # When the frame was put on the screen, how long until it was drawn, and frames from one
        # shown to the next.
        self._begun, self._took, self._step = 0.0, 0.0, 1
        self.bar = Bar(self, viewer.window)

    @property
    def moment(self) -> Moment | None:
        """The frame shown; None if no scene is of a sequence."""
        return first_moment(self._viewer.stage.scenes)

    @property
    def busy(self) -> bool:
        """Whether it plays, or another frame is wanted than that shown."""
        moment = self.moment
        return moment is not None and (self.playing or self.wanted != moment.number)

    def toggle(self) -> None:
        """Play, after the end from the beginning, or stop."""
        moment = self.moment
        if self.playing:
            self.stop()
        elif moment is not None and self._may_leave(self.toggle):
            self.playing, self._step = True, 1
            self._begun, self._took = time.monotonic(), 0.0
            if moment.number and moment.after(1, self.loop) is None:
                self._want(0)
            else:
                self._next(moment)

    def stop(self) -> None:
        """Stop at the frame shown."""
        if self.playing and self.moment is not None:
            self.playing = False
            self._want(self.moment.number)
            self._viewer.stage.painter.rest()
            self._viewer.refresh_panel()

    def go(self, step: int) -> None:
        """Stop, and go some frames forward or back."""
        self.stop()
        self.seek(self.wanted + step)

    def seek(self, number: int) -> None:
        """Go to a frame."""
        moment = self.moment
        if moment is None:
            return
        number = min(max(number, 0), moment.clip.count - 1)
        if number == self.wanted:
            return
        self.stop()
        if self._may_leave(lambda: self.seek(number)):
            self._want(number)

    def _may_leave(self, then: Callable[[], None]) -> bool:
        """Whether no edits would be lost; otherwise asks, and then calls `then`."""
        scenes = self._viewer.stage.scenes
        frames = [k for k, scene in enumerate(scenes) if scene.moment is not None]
        may = not self._editor.ask_unsaved(frames, then)
        self.bar.refresh()
        return may

    def _next(self, moment: Moment) -> None:
        """Want the frame after that shown; stop at the end, unless the sequence is repeated."""
        number = moment.after(self._step, self.loop)
        if number is None:
            self.stop()
        else:
            self._want(number)

    def _want(self, number: int) -> None:
        """Read a frame unless it is shown."""
        self.wanted, self._coming = number, None
        self._worker.cancel("frame")
        self.bar.refresh()
        scenes = [each for each in self._viewer.stage.scenes if not self._encoding.is_trial(each)]

        def read(stale: Stale) -> list[Opened]:
            return at_moment(scenes, number, self._worker.progress(stale, lambda _: None))

        def done(found: list[Opened]) -> None:
            self._coming = found

        def failed(error: Exception) -> None:
            self.playing = False
            if self.moment is not None:
                self.wanted = self.moment.number
            self._viewer.fail(error)
            self.bar.refresh()

        self._worker.submit("frame", read, done, failed)

    def tick(self) -> None:
        """Show the frame that was read, when its time has come; follow scenes opened otherwise."""
        scenes, stage, moment = self._viewer.stage.scenes, self._viewer.stage, self.moment
        if scenes != self._scenes:
            self._follow(moment)
        if moment is None or not stage.painter.drafted:
            return
        now = time.monotonic()
        self._took = self._took or now - self._begun
        if self._coming is not None and not (
            self.playing and now - self._begun < self._step * moment.clip.seconds
        ):
            self._show(self._coming)

    def _follow(self, moment: Moment | None) -> None:
        """Go to the same moment in scenes that were opened; stay at a frame that was edited."""
        before, self._scenes = self._scenes, self._viewer.stage.scenes
        self.bar.refresh()
        moment_before = first_moment(before)
        if (moment is None) != (moment_before is None):
            self._viewer.stage.arrange()
        if moment is None:
            self.playing, self._coming = False, None
        elif {k for k, each in enumerate(self._scenes) if each.moment} & {*self._editor.unsaved}:
            self.stop()
            self._want(moment.number)
        else:
            self._want(self.wanted if moment is moment_before else moment.number)

    def _show(self, scenes: list[Opened]) -> None:
        stage, self._coming = self._viewer.stage, None
        if scenes == stage.scenes:
            return
        if scenes[0] is not stage.scenes[0]:
            stage.put_pruned(None)
        if len(scenes) == len(stage.scenes):
            stage.exchange(scenes)
            self._editor.put(scenes)
        else:
            self._loading.show(scenes, self._visits.views, None, stay=True)
            self._viewer.panel.say("B was a trial encoding of another frame")
        self._scenes = stage.scenes
        moment = self.moment
        if self.playing and moment is not None:
            self._step = max(1, round(self._took / moment.clip.seconds))
            self._begun, self._took = time.monotonic(), 0.0
            self._next(moment)
        else:
            self._viewer.refresh_panel()


class Bar:
    """Buttons, a slider over the frames, and the time, below the panes.

    Attributes
    ----------
    play, back, forward : gui.Button
    slider : gui.Slider
    loop : gui.Checkbox
    """

    def __init__(self, player: Player, window: gui.Window) -> None:
        self._player, self._window = player, window
        self._em = em = window.theme.font_size
        widgets = Widgets(em)
        self._row = gui.Horiz(0.3 * em, gui.Margins(0.5 * em, 0.25 * em, 0.5 * em, 0.25 * em))
        self.play = widgets.button("Play", player.toggle, "Play or stop (space).")
        self.back = widgets.button("<", lambda: player.go(-1), "One frame back (,).")
        self.forward = widgets.button(">", lambda: player.go(1), "One frame forward (.).")
        self.slider = gui.Slider(gui.Slider.INT)
        self.slider.set_on_value_changed(lambda value: player.seek(round(float(value))))
        self._said = gui.Label("")
        self.loop = widgets.checkbox("loop", self._set_loop)
        self.loop.checked = player.loop
        for widget in (self.play, self.back, self.forward, self.loop, self._said, self.slider):
            self._row.add_child(widget)
        self._row.visible = False
        window.add_child(self._row)

    def _set_loop(self, loop: bool) -> None:
        self._player.loop = loop

    @property
    def height(self) -> int:
        """Its height, pixels; 0 without a sequence."""
        return 2 * self._em if self._row.visible else 0

    def refresh(self) -> None:
        """Name the frame that is wanted or, while playing, shown."""
        player, moment = self._player, self._player.moment
        self._row.visible = moment is not None
        if moment is not None:
            number = moment.number if player.playing else player.wanted
            last, seconds = moment.clip.count - 1, number * moment.clip.seconds
            self.slider.set_limits(0, last)
            self.slider.int_value = number
            self.play.text = "Stop" if player.playing else "Play"
            self._said.text = f"{seconds:7.2f} s, frame {number} of 0-{last}"
        self._window.post_redraw()

    def lay_out(self, rect: gui.Rect, hidden: gui.Rect) -> None:
        """Place it in a part of the window."""
        self._row.frame = rect if rect.height else gui.Rect(hidden.x, hidden.y, *HIDDEN)

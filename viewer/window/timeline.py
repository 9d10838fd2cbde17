"""The camera path of a window: keyframes on a timeline, flights, films and files."""

from __future__ import annotations

import time
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from numpy.typing import NDArray
from open3d.visualization import gui

from gs_codec.runtime.wording import counted
from viewer.pictures.film import write_frames
from viewer.pictures.reels import check_reel
from viewer.pictures.screenshot import compose
from viewer.pictures.timeline_chart import TimelineChart, span_of
from viewer.scenes.flight import LEG, CameraPath, evenly, read_path, write_path
from viewer.scenes.pose import Pose, moved
from viewer.scenes.typed_paths import FILMS, POSES
from viewer.scenes.worker import Stale
from viewer.window import dialogs
from viewer.window.shared import Host

#: Keyframes nearer than this are the same moment, seconds.
_SAME = 0.02


class Timeline:
    """Keyframes, and the time of the path that the window shows.

    Attributes
    ----------
    path : CameraPath
    chosen : int or None
        Index of the chosen keyframe.
    now : float
        Time on the path, seconds.
    redraw : callable
        Called after a change of the chart alone.
    """

    def __init__(self, viewer: Host) -> None:
        self._viewer = viewer
        self._films = viewer.worker.another()
        self.path = self._saved = CameraPath()
        self.chosen: int | None = None
        self.now = 0.0
        self.redraw: Callable[[], None] = lambda: None
        self._between = False  # whether `now` was chosen, so that a keyframe can be put there
        self._begun: float | None = None
        self._last: Pose | None = None
        self._held: int | None = None
        self._span = 0.0

    # Keyframes

    def keep(self) -> None:
        """Add the view: at the time chosen between keyframes, otherwise after them."""
        pose, path = self._viewer.stage.pose, self.path
        if pose is None:
            return
        at = next((each for each in path.times if abs(each - self.now) < _SAME), self.now)
        if not self._between:
            at = path.seconds + LEG if path.poses else 0.0
        self._put(path.with_keys(path.keys | {at: pose}), bisect_left(path.times, at))

    def replace(self) -> None:
        """Replace the pose of the chosen keyframe by the view."""
        pose, path = self._viewer.stage.pose, self.path
        if pose is not None and self.chosen is not None:
            self._put(path.with_keys(path.keys | {path.times[self.chosen]: pose}), self.chosen)

    def drop(self) -> None:
        """Remove the chosen keyframe, or the last."""
        left = self.path.keys
        if left:
            del left[self.path.times[-1 if self.chosen is None else self.chosen]]
            last = len(left) - 1
            chosen = last if self.chosen is None else min(self.chosen, last)
            self._put(self.path.with_keys(left), chosen if left else None)

    def even(self) -> None:
        """Let the camera move at an even speed, in the same time."""
        path = self.path
        self._put(evenly(path.poses, path.seconds, path.fps), self.chosen)

    def set_seconds(self, seconds: float) -> None:
        """Set the duration of the path."""
        if seconds > 0 and len(self.path.poses) > 1:
            factor, keys = seconds / self.path.seconds, self.path.keys.items()
            path = self.path.with_keys({factor * time: pose for time, pose in keys})
            self._put(path, self.chosen)

    def set_fps(self, fps: float) -> None:
        """Set the frames per second of films."""
        self._put(replace(self.path, fps=min(max(int(fps), 1), 120)), self.chosen)

    def choose(self, index: int) -> None:
        """Choose a keyframe, and look from it."""
        self.stop()
        self._put(self.path, index)
        self._viewer.stage.look_from(self.path.poses[index])

    def follow(self, matrix: NDArray) -> None:
        """Move the keyframes by a matrix ``(4, 4)``."""
        if self.path.poses:
            poses = tuple(moved(pose, matrix) for pose in self.path.poses)
            self.path = replace(self.path, poses=poses)

    def _put(self, path: CameraPath, chosen: int | None) -> None:
        self.path, self.chosen, self._between = path, chosen, False
        self.now = 0.0 if chosen is None else path.times[chosen]
        self._begun = self._begun if len(path.poses) > 1 else None
        self._viewer.refresh_panel()

    @property
    def text(self) -> str:
        """Text with the number of keyframes, and the duration."""
        count = len(self.path.poses)
        return f"camera path: {counted(count, 'keyframe')}, {self.path.seconds:.4g} s"

    # Timeline

    @property
    def chart(self) -> TimelineChart:
        """The timeline as a chart."""
        path = self.path
        span = self._span or span_of(path.times)
        return TimelineChart(path.times, path.fps, self.now, self.chosen, span)

    def mouse(self, event: gui.MouseEvent, x: float, width: int) -> None:
        """Choose and drag keyframes; look along the path elsewhere."""
        kind, chart = gui.MouseEvent.Type, self.chart
        if event.type == kind.BUTTON_DOWN:
            self.stop()
            self._held, self._span = chart.key_at(x, width), span_of(self.path.times)
            if self._held is not None:
                self.choose(self._held)
                return
        if event.type in (kind.BUTTON_DOWN, kind.DRAG) and self._span:
            if self._held is None:
                self._look(chart.time_at(x, width))
            elif self._held and chart.key_at(x, width) != self._held:
                self._put(self.path.retimed(self._held, chart.time_at(x, width)), self._held)
        elif event.type == kind.BUTTON_UP:
            self._span = 0.0
            self._viewer.stage.painter.rest()
            self._viewer.refresh_panel()

    def _look(self, now: float) -> None:
        """Look from the path at a time."""
        path = self.path
        if len(path.poses) > 1:
            self.now, self._between = min(now, path.seconds), True
            self._viewer.stage.steer(path.at([self.now])[0])
            self.redraw()

    # Flight

    @property
    def flying(self) -> bool:
        """Whether the window shows a flight along the path."""
        return self._begun is not None

    def fly(self) -> None:
        """Fly along the path from the time shown, or from its beginning; stop if flying."""
        if self.flying or len(self.path.poses) < 2:
            self.stop()
            return
        self.now = self.now if self.now < self.path.seconds - _SAME else 0.0
        self._begun, self._last = time.monotonic() - self.now, None

    def stop(self) -> None:
        """Stop flying."""
        if self.flying:
            self._begun = None
            self._viewer.stage.painter.rest()
            self._viewer.refresh_panel()

    def tick(self) -> bool:
        """Continue the flight until its end, or until the camera is moved otherwise."""
        if self._begun is None:
            return False
        stage, now = self._viewer.stage, time.monotonic() - self._begun
        if self._last not in (None, stage.pose):
            self._begun = None
            return False
        self._look(now)
        self._last = stage.pose
        if now >= self.path.seconds:
            stage.look_from(self.path.poses[-1])
            self._begun, self._between = None, False
            self._viewer.refresh_panel()
        return True

    # Films and files

    @property
    def filming(self) -> bool:
        """Whether a film is being written."""
        return self._films.busy

    def ask_film(self) -> None:
        """Ask where to write a film of the path, and write it; stop the one being written."""
        if self.filming:
            self._films.cancel("film")
            self._viewer.panel.say("film stopped")
        else:
            self._viewer.files.ask_save("Write a film of the path", FILMS, self.film, "-film")

    def film(self, path: str) -> None:
        """Write a film of the path, with all that the panes show, in the background."""
        viewer, stage, target = self._viewer, self._viewer.stage, Path(path)
        flight = self.path
        (wide, high), choice = stage.saved_size, viewer.choice
        size = wide // 2 * 2, high // 2 * 2
        look = {"shown": stage.shown, "mode": choice.mode, "wipe": choice.wipe}
        draw = partial(compose, **look, size=size, front=choice.front)  # type: ignore[arg-type]

        def say(share: float) -> None:
            viewer.panel.say(f"writing {target.name}: {100 * share:.0f} % (Film stops)")

        def write(stale: Stale) -> int:
            check_reel(target, size, True)
            progress, poses = self._films.progress(stale, say), flight.frames()
            write_frames(target, poses, flight.fps, size, draw, progress)
            return len(poses)

        def done(count: int) -> None:
            viewer.panel.say(f"{target.name} saved: {counted(count, 'frame')}")
            viewer.panel.refresh()

        say(0.0)
        self._films.submit("film", write, done, viewer.fail)
        viewer.panel.refresh()

    def ask_unfinished(self, finish: Callable[[], None], then: Callable[[], None]) -> bool:
        """Ask whether to `finish` the film being written, if any, or to drop it and call `then`.

        Returns
        -------
        bool
            Whether it asked; if not, nothing is called.
        """
        if not self.filming:
            return False

        def drop() -> None:
            self.close()
            then()

        choices = [("Finish it, then close", finish), ("Drop the film", drop)]
        text = "A film is being written."
        dialogs.ask_among(self._viewer.modal, "Unfinished film", text, choices)
        return True

    def close(self) -> None:
        """Stop writing a film, so that nothing of it is left."""
        self._films.cancel("film")
        while self._films.busy:
            time.sleep(0.01)

    def write(self, path: str, then: Callable[[], None] = lambda: None) -> None:
        """Write the path to a file, and then call `then`."""
        viewer = self._viewer
        try:
            write_path(Path(path), self.path)
        except Exception as error:
            viewer.fail(error)
        else:
            self._saved = self.path
            viewer.panel.say(f"{Path(path).name} saved")
            then()

    def open(self, path: str) -> None:
        """Replace the path by that of a file of a path or cameras; ask about an unsaved one."""
        if self.ask_unsaved(partial(self.open, path)):
            return

        def done(found: CameraPath) -> None:
            self.stop()
            self._saved = found
            self._put(found, None)

        submit = self._viewer.worker.submit
        submit("poses", lambda stale: read_path(Path(path)), done, self._viewer.fail)

    def ask_unsaved(self, then: Callable[[], None]) -> bool:
        """Ask what to do with an unsaved path, if any, before calling `then`.

        Returns
        -------
        bool
            Whether it asked; if not, `then` is not called.
        """
        count = len(self.path.poses)
        if self.path is self._saved or count < 2:
            return False

        def discard() -> None:
            self._saved = self.path
            then()

        text = f"A camera path of {count} keyframes, not saved."
        choices = [("Save as ...", lambda: self.ask_write(then)), ("Discard it", discard)]
        dialogs.ask_among(self._viewer.modal, "Unsaved camera path", text, choices)
        return True

    def ask_write(self, then: Callable[[], None] = lambda: None) -> None:
        """Ask where to write the path, write it, and then call `then`."""

        def write(path: str) -> None:
            self.write(path, then)

        self._viewer.files.ask_save("Save the path", POSES, write, "-path")

    def ask_open(self) -> None:
        """Ask for a file of a path or cameras, and open it."""
        self._viewer.files.ask_open("Open a path", POSES, self.open)

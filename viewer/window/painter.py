"""Pictures of the panes, drawn in the background, and the quality measured afterwards."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from open3d.visualization import gui

from viewer.pictures.drawer import Drawer, measure
from viewer.pictures.picture import Shown, picture
from viewer.scenes.opened import Opened
from viewer.scenes.pose import Pose
from viewer.scenes.worker import Stale, Worker
from viewer.window.pace import Pace, Step
from viewer.window.pane import Pane

#: Columns of a pane: start and stop in the window, picture width, and first picture column.
Columns = tuple[int, int, int, int]


class Painted(Protocol):
    """The stage whose panes show the pictures; see `viewer.window.stage.Stage`."""

    window: gui.Window
    worker: Worker
    scenes: list[Opened]
    views: dict[Opened, Drawer]
    pose: Pose | None
    size: tuple[int, int]

    @property
    def shown(self) -> Shown:
        """Settings for drawing."""

    @property
    def by_hand(self) -> bool:
        """Whether gs_codec's rasteriser draws splats."""

    @property
    def visible(self) -> list[Pane]:
        """The visible panes, from left to right."""

    @property
    def columns(self) -> list[Columns]:
        """Columns of each visible pane."""

    def see(self, pose: Pose) -> None:
        """Make the panes look from a pose."""


class Painter:
    """Draws the pictures of a stage's panes: drafts during motion, full pictures at rest.

    Pictures have their own thread, so they need not wait for long jobs. Pictures to be measured are
    always drawn by the exact renderer, in the window's worker thread.

    Parameters
    ----------
    stage : Painted
    changed : callable
        Called when a picture or measurement is ready.
    failed : callable
        Called with the exception of a failed job.

    Attributes
    ----------
    until : callable or None
        Drawing waits until it returns True.
    seconds : float
        Time from the last move to the full pictures on the screen.
    """

    def __init__(
        self, stage: Painted, changed: Callable[[], None], failed: Callable[[Exception], None]
    ) -> None:
        self._stage, self._changed, self._failed = stage, changed, failed
        self._worker = stage.worker.another()
        self._pace = Pace()
        self._measured: tuple[Pose | None, str] = (None, "")
        self._painted = False
        self._moved, self._fresh, self.seconds = 0.0, False, 0.0
        self.until: Callable[[], bool] | None = None

    def put(self, scenes: list[Opened]) -> None:
        """Draw other scenes; the panes start without pictures."""
        self._worker.cancel("picture")
        self._stage.worker.cancel("measure")
        self._pace.put(sum(scene.count for scene in scenes))
        self._measured, self._painted = (None, ""), False

    def follow(self) -> None:
        """Draw other frames of the same scenes; the pictures stay until then."""
        self._stage.worker.cancel("measure")
        self._measured = (None, "")

    def move(self) -> None:
        """Redraw; more motion may follow."""
        self._moved = time.monotonic()
        self._pace.move(self._moved)

    def rest(self) -> None:
        """Redraw in full, because the motion has ended."""
        self._pace.rest()

    @property
    def waits(self) -> bool:
        """Whether drawing has to wait."""
        return self.until is not None and not self.until()

    @property
    def resting(self) -> bool:
        """Whether the panes show full pictures."""
        return self._pace.resting and not self.waits

    @property
    def drafted(self) -> bool:
        """Whether the panes show at least drafts."""
        return self._pace.drafted and not self.waits

    @property
    def leads(self) -> bool:
        """Whether the panes' poses follow their pictures."""
        return self._painted and self._stage.by_hand

    @property
    def quality(self) -> str:
        """PSNR and SSIM of B against A in the frame of the current view; empty until measured."""
        pose, text = self._measured
        return text if pose is self._stage.pose else ""

    def tick(self, pose: Pose) -> bool:
        """Start the next picture if it is due; return whether one was started."""
        if self._fresh:  # the full pictures have been drawn since
            self.seconds, self._fresh = time.monotonic() - self._moved, False
        step = None if self.waits else self._pace.next(time.monotonic())
        if step is None:
            return False
        stage, shown = self._stage, self._stage.shown
        wanted = [stage.by_hand or shown.shows_error(pane.scene) for pane in stage.visible]
        if any(wanted):
            self._draw(step, shown, wanted, pose)
        else:
            self._pace.drop()
            self._show(pose, stage.visible, [None] * len(wanted))
            self._fresh = step.full
            if step.full:
                self._measure(pose)
                self._changed()
        return True

    def _draw(self, step: Step, shown: Shown, wanted: list[bool], pose: Pose) -> None:
        """Draw the pictures of the visible panes that want one."""
        stage, views = self._stage, self._stage.views
        visible, columns, (_, height) = list(stage.visible), stage.columns, stage.size
        width, high = max(columns[0][2] // step.shrink, 1), max(height // step.shrink, 1)

        def draw(stale: Stale) -> tuple[list[NDArray | None], float] | None:
            begun, pictures = time.monotonic(), []
            for pane, cut, want in zip(visible, columns, wanted, strict=True):
                if stale():
                    return None
                # Final error pictures come from exact renders, because errors have a scale.
                exact = step.full and shown.shows_error(pane.scene)
                every = 0 if exact else step.every
                image = None
                if want:
                    image = picture(views, pane.scene, pose, width, high, shown, every)
                    image = _cut(image, cut, step.shrink)
                pictures.append(image)
            return pictures, time.monotonic() - begun

        def done(found: tuple[list[NDArray | None], float] | None) -> None:
            if found is None:
                self._pace.drop()
                return
            self._pace.done(step, found[1])
            self._show(pose, visible, found[0])
            self._fresh = step.full
            if step.full:  # not earlier, because it would delay the picture
                self._measure(pose)
            self._changed()

        def failed(error: Exception) -> None:
            self._pace.drop()
            self._failed(error)

        self._worker.submit("picture", draw, done, failed)

    def _show(self, pose: Pose, panes: list[Pane], pictures: list[NDArray | None]) -> None:
        """Put pictures on panes, and make the panes look from the pictures' pose."""
        self._painted = any(image is not None for image in pictures)
        self._stage.see(pose)
        for pane, image in zip(panes, pictures, strict=True):
            pane.show_picture(image)
        self._stage.window.post_redraw()

    def _measure(self, pose: Pose) -> None:
        """Start measuring B in the frame of the current view, unless already measured."""
        stage, views = self._stage, self._stage.views
        scenes = list(stage.scenes)
        if len(scenes) < 2 or self._measured[0] is pose:
            return

        def done(text: str) -> None:
            self._measured = pose, text
            self._changed()

        def work(stale: Stale) -> str:
            return measure(views, scenes, pose)

        stage.worker.submit("measure", work, done, self._failed)


def _cut(image: NDArray, cut: Columns, shrink: int) -> NDArray[np.float32]:
    """Crop a picture to the part that a pane shows."""
    start, stop, _, left = cut
    first = min(left // shrink, image.shape[1] - 1)
    return image[:, first : first + max((stop - start) // shrink, 1)]

"""Measuring: the distance between two clicked points, and the scale that a known length sets."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from viewer.pictures.drawer import depth_at
from viewer.pictures.marker import measure_lines
from viewer.scenes.pose import placed, scale_of
from viewer.scenes.worker import Stale
from viewer.window.mouse import Place
from viewer.window.pane import Pane
from viewer.window.shared import Host


class Measuring:
    """Two points on what the panes show; a third click begins again.

    Attributes
    ----------
    on : bool
        Whether clicks choose points.
    points : list of ndarray, shape (3,)
    unit : float
        Length of a scene unit, from a known length; 1 until then.
    """

    def __init__(self, viewer: Host) -> None:
        self._viewer = viewer
        self.on, self.unit = False, 1.0
        self.points: list[NDArray[np.float64]] = []
        viewer.stage.overlays["measure"] = lambda *view: measure_lines(self.points, *view)
        viewer.modal.cancels.append(self._cancel)

    def toggle(self) -> None:
        """Let clicks choose points, or pick Gaussians again."""
        self.on = not self.on
        say_unless_loading(self._viewer, "")
        self._put([])
        self._viewer.panel.show("Pick")

    def click(self, pane: Pane, at: Place) -> None:
        """Choose the point seen at a pixel of a pane's picture."""

        def done(point: NDArray[np.float64]) -> None:
            self._put([*(self.points if len(self.points) < 2 else []), point])

        find_point(self._viewer, "measure", pane, at, lambda: self.on, done)

    def follow(self, matrix: NDArray) -> None:
        """Move the points by a matrix ``(4, 4)``; a known length stays."""
        if self.unit != 1:
            self.unit /= scale_of(matrix)
        self._put([placed(point, matrix) for point in self.points])

    def _put(self, points: list[NDArray[np.float64]]) -> None:
        self.points = points
        self._viewer.stage.arrange()
        self._viewer.panel.refresh()

    def _cancel(self) -> bool:
        """Clear the points, or stop measuring; return whether there was anything to end."""
        was = self.on
        if self.points:
            self._put([])
        elif self.on:
            self.toggle()
        return was

    @property
    def distance(self) -> float | None:
        """Distance of the two points, scene units; None if there are fewer."""
        if len(self.points) < 2:
            return None
        return float(np.linalg.norm(self.points[1] - self.points[0]))

    def set_length(self, length: float) -> None:
        """Set the scale: the two points are this far apart."""
        if self.distance and length > 0:
            self.unit = length / self.distance
            self._viewer.panel.refresh()

    def take_unit(self) -> float:
        """The scale, for scaling the scene by it: what is measured next has scene units again."""
        unit, self.unit = self.unit, 1.0
        self._put([])
        return unit

    @property
    def text(self) -> str:
        """What was measured, and the command that scales the scene."""
        if self.distance is None:
            return "Click two points.\n" if self.on else ""
        text = f"{self.distance:.5g} scene units"
        if self.unit == 1:
            return f"{text}\n"
        return f"{text} = {self.unit * self.distance:.5g}\ngs-codec convert --scale {self.unit:.6g}"

    @property
    def tag(self) -> tuple[str, NDArray[np.float64] | None]:
        """The distance, and the pixel of the picture that it belongs to, if it is seen."""
        stage, distance = self._viewer.stage, self.distance
        if distance is None or stage.seen is None:
            return "", None
        lines = measure_lines(self.points, stage.seen, *stage.picture_size)
        middle = lines[0].mean(axis=0) if len(lines) == 3 else None
        return f"{self.unit * distance:.4g}", middle


def find_point(
    viewer: Host,
    name: str,
    pane: Pane,
    at: Place,
    is_on: Callable[[], bool],
    done: Callable[[NDArray[np.float64]], None],
) -> None:
    """Find the point ``(3,)`` seen at a pixel of a pane's picture, in the background.

    If the tool of this name `is_on` then, it gets the point, or the panel says that there is none.
    """
    stage = viewer.stage
    pose, size, scene, views = stage.pose, stage.picture_size, pane.scene, stage.views
    look = stage.shown.look(scene)
    if pose is None:
        return

    def find(stale: Stale) -> NDArray[np.float64] | None:
        depth = depth_at(views, scene, pose, at, size, look)
        fx, fy, cx, cy = pose.lens(*size)
        ray = np.array([(at[0] - cx) / fx, (at[1] - cy) / fy, 1.0])
        return pose.position + depth * ray @ pose.rotation if depth > 0 else None

    def found(point: NDArray[np.float64] | None) -> None:
        if is_on():
            say_unless_loading(viewer, f"nothing to {name} there" if point is None else "")
            if point is not None:
                done(point)

    # Two clicks may be made before the first point is found.
    viewer.worker.submit(f"{name} point {at}", find, found, viewer.fail)


def say_unless_loading(viewer: Host, text: str) -> None:
    """Show a status line, but not in place of the progress of loading."""
    if not viewer.loads:
        viewer.panel.say(text)

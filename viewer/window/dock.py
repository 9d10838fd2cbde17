"""The dock below the panes: quality per view, thumbnails, the camera path, or a histogram."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from numpy.typing import NDArray
from open3d.visualization import gui

from gs_codec.edit import AttributeStatistics, statistics
from viewer.pictures.charts import Chart, ContactSheet, HistogramChart, Message, QualityChart
from viewer.pictures.timeline_chart import TimelineChart
from viewer.scenes.choice import DOCKS
from viewer.scenes.opened import Opened
from viewer.scenes.worker import Stale
from viewer.window.canvas import Canvas
from viewer.window.pane import HIDDEN
from viewer.window.shared import Host
from viewer.window.timeline import Timeline
from viewer.window.view_survey import Survey
from viewer.window.visits import Visits

#: Share of the window's height that it takes.
_SHARE = 0.25

#: Maximum height, pixels.
_HIGHEST = 170


class Dock:
    """The dock with a chart, below the panes.

    Parameters
    ----------
    viewer : Host
    visits : Visits
    timeline : Timeline
    selected : callable
        Called with a quantity and the range of its values dragged in a histogram.

    Attributes
    ----------
    survey : Survey
    chart : Chart
    canvas : Canvas
    """

    def __init__(
        self,
        viewer: Host,
        visits: Visits,
        timeline: Timeline,
        selected: Callable[[str, float, float], None],
    ) -> None:
        self._viewer, self._visits, self._selected = viewer, visits, selected
        self._timeline = timeline
        timeline.redraw = self._timed
        self.survey = Survey(viewer, visits, self._surveyed)
        self._statistics: dict[Opened, dict[str, AttributeStatistics]] = {}
        self._first = 0.0
        self._held: float | None = None
        self.chart: Chart = Message("")
        self.canvas = Canvas(viewer.window, self._draw, self._mouse)

    @property
    def height(self) -> int:
        """Height of the dock, pixels."""
        if self._viewer.choice.dock == "nothing":
            return 0
        return min(int(_SHARE * self._viewer.window.content_rect.height), _HIGHEST)

    def lay_out(self, rect: gui.Rect, corner: gui.Rect) -> None:
        """Place it in a part of the window; if nothing is shown, in a corner."""
        hidden = gui.Rect(corner.x, corner.y, *HIDDEN)
        self.canvas.move_to(rect if rect.height > 0 else hidden)

    def refresh(self) -> None:
        """Update the dock to the choice and the scenes."""
        viewer = self._viewer
        shown, scenes = viewer.choice.dock, viewer.stage.scenes
        views = [each.name for each in self._visits.viewpoints]
        self.survey.ask("decibels", shown == "PSNR of views" and len(scenes) > 1)
        self.survey.ask("pictures", shown == "views" and bool(scenes))
        if not scenes:
            self.chart = Message("No scene is open.")
        elif shown == "PSNR of views":
            self.chart = self._qualities(views)
        elif shown == "views":
            here = None if self._visits.moved else self._visits.number
            self.chart = ContactSheet(views, self.survey.pictures, here, self._first)
        elif shown == "camera path":
            self.chart = self._timeline.chart
        elif shown != "nothing":
            self.chart = self._histogram(shown.removeprefix("histogram: "))
        if shown != "nothing":
            self.canvas.redraw()

    def _timed(self) -> None:
        """Show another time of the camera path."""
        if isinstance(self.chart, TimelineChart):
            self.chart = self._timeline.chart
            self.canvas.redraw()

    def _surveyed(self) -> None:
        self.refresh()
        self._viewer.panel.refresh()

    def _qualities(self, views: list[str]) -> Chart:
        viewer = self._viewer
        if len(viewer.stage.scenes) < 2:
            return Message("PSNR of views needs two scenes: open another version as B.")
        first = self._visits.views.first
        if len(views) <= first:
            return Message("No views yet: open cameras, or wait for estimated ones.")
        measured = {k - first: value for k, value in self.survey.decibels.items()}
        here = None if self._visits.moved else self._visits.number - first
        return QualityChart(views[first:], measured, here)

    def _histogram(self, name: str) -> Chart:
        """The histogram of an attribute; statistics of scenes are cached."""
        scenes = self._viewer.stage.scenes
        self._statistics = {s: self._statistics[s] for s in scenes if s in self._statistics}
        missing = [scene for scene in scenes if scene not in self._statistics]
        if missing:
            self._describe(missing[0])
            return Message("histogram: counting ...")
        known = [self._statistics[scene].get(name) for scene in scenes]
        some = next(filter(None, known), None)
        if some is None:
            return Message(f"No {name}: the SH degree is lower.")
        # A scene of a lower SH degree has no outline.
        found = [each or replace(some, counts=(), edges=()) for each in known]
        before = self.chart
        kept = isinstance(before, HistogramChart) and before.scenes[0].name == name
        return HistogramChart(found, before.chosen if kept else None)  # type: ignore[attr-defined]

    def _describe(self, scene: Opened) -> None:
        def find(stale: Stale) -> dict[str, AttributeStatistics]:
            return {each.name: each for each in statistics(scene.cloud).attributes}

        def done(found: dict[str, AttributeStatistics]) -> None:
            self._statistics[scene] = found
            self.refresh()

        if "statistics" not in self._viewer.worker.kinds:
            self._viewer.worker.submit("statistics", find, done, self._viewer.fail)

    def _draw(self, width: int, height: int) -> NDArray:
        return self.chart.draw(width, height)

    # Mouse

    def _mouse(self, event: gui.MouseEvent) -> None:
        kind, frame = gui.MouseEvent.Type, self.canvas.widget.frame
        x, chart = event.x - frame.x, self.chart
        if isinstance(chart, HistogramChart):
            if chart.selects:
                self._range(chart, event, x)
        elif isinstance(chart, TimelineChart):
            self._timeline.mouse(event, x, frame.width)
        elif event.type == kind.WHEEL and isinstance(chart, ContactSheet):
            self._first = chart.scrolled(-event.wheel_dy, frame.width, frame.height)
            self.refresh()
        elif event.type == kind.BUTTON_DOWN:
            view = None
            if isinstance(chart, ContactSheet):
                view = chart.view_at(x, frame.height)
            elif isinstance(chart, QualityChart):
                view = chart.view_at(x, frame.width)
                view = None if view is None else view + self._visits.views.first
            if view is not None:
                self._visits.go_to(view)

    def _range(self, chart: HistogramChart, event: gui.MouseEvent, x: float) -> None:
        """Mark the range being dragged; select it at the end of the drag."""
        kind, width = gui.MouseEvent.Type, self.canvas.widget.frame.width
        if event.type == kind.BUTTON_DOWN:
            self._held = x
        elif event.type == kind.DRAG and self._held is not None:
            self.chart = replace(chart, chosen=chart.between(self._held, x, width))
            self.canvas.redraw()
        elif event.type == kind.BUTTON_UP and self._held is not None:
            self._held = None
            if chart.chosen is not None:
                self._selected(chart.scenes[0].name, *chart.chosen)

    def mark(self, name: str, low: float, high: float) -> None:
        """Mark the selected range of a quantity, if its histogram is shown."""
        chart = self.chart
        if isinstance(chart, HistogramChart) and chart.scenes[0].name == name:
            self.chart = replace(chart, chosen=(low, high))
            self.canvas.redraw()

    def unmark(self) -> None:
        """Remove the mark, because something else was selected."""
        if isinstance(self.chart, HistogramChart):
            self.chart = replace(self.chart, chosen=None)

    def next(self) -> str:
        """The next choice of `DOCKS` after the current one."""
        return DOCKS[(DOCKS.index(self._viewer.choice.dock) + 1) % len(DOCKS)]

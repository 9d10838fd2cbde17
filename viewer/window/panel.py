"""The panel next to the scenes: current activity, tabs, legends."""

from __future__ import annotations

from itertools import zip_longest
from typing import Protocol

import numpy as np
from open3d.visualization import gui

from viewer.pictures.centres import KINDS
from viewer.pictures.layers import Legend
from viewer.window.backdrop import picture_of
from viewer.window.controls import Controls
from viewer.window.dialogs import folded
from viewer.window.edit_tab import EditTab
from viewer.window.path_tab import PathTab
from viewer.window.pick_tab import PickTab
from viewer.window.place_tab import PlaceTab
from viewer.window.rate_tab import RateTab
from viewer.window.scene_tab import SceneTab
from viewer.window.view_tab import ViewTab
from viewer.window.widgets import Widgets

#: Width of the panel, in font sizes.
EMS = 22

#: Its largest height below the panes, and the least height of these, in font sizes.
_HIGH, _PANES = 28, 6

#: Width of its text, in characters.
_COLUMNS = 38


#: Number of values in a legend.
_VALUES = 5


class Tab(Protocol):
    """A tab of the panel."""

    widget: gui.Widget

    def refresh(self) -> None:
        """Update controls and numbers from the viewer."""


class Panel:
    """Status, tabs and legends of a viewer.

    Attributes
    ----------
    scene, view, path, rate, pick, edit : SceneTab, ViewTab, PathTab, RateTab, PickTab, EditTab
    place : PlaceTab
    """

    def __init__(self, viewer: Controls, font: int) -> None:
        self._viewer = viewer
        em = viewer.window.theme.font_size
        widgets = Widgets(em)
        margins = gui.Margins(0.6 * em, 0.3 * em, 0.6 * em, 0.3 * em)
        self._head = gui.Vert(0.25 * em, margins)
        self.status = gui.Label("")
        self.speed = gui.Label("")
        self._head.add_child(self.status)
        self._head.add_child(self.speed)
        self.progress = gui.ProgressBar()
        self.stop = widgets.button("Stop", viewer.loading.stop)
        self._loading = gui.Vert(0.3 * em)
        self._loading.add_child(self.progress)
        self._loading.add_child(self.stop)
        self._loading.visible = False
        self._head.add_child(self._loading)
        self.scene, self.view = SceneTab(viewer, widgets, font), ViewTab(viewer, widgets)
        self.pick, self.edit = PickTab(viewer, widgets, font), EditTab(viewer, widgets)
        self.path, self.rate = PathTab(viewer, widgets), RateTab(viewer, widgets, font)
        self.place = PlaceTab(viewer, widgets)
        self._named: dict[str, Tab] = {
            "Scene": self.scene,
            "View": self.view,
            "Path": self.path,
            "Rate": self.rate,
            "Pick": self.pick,
            "Edit": self.edit,
            "Place": self.place,
        }
        self.tabs = viewer.tabs
        for name, tab in self._named.items():
            self.tabs.add_tab(name, tab.widget)
        self._legend = _Legends(em, margins)
        for part in (self._head, self._legend.widget):
            viewer.window.add_child(part)

    def lay_out(self, rect: gui.Rect, context: gui.LayoutContext) -> None:
        """Place the panel in a part of the window."""
        bottom = rect.get_bottom()
        for part, at_bottom in ((self._legend.widget, True), (self._head, False)):
            high = part.calc_preferred_size(context, gui.Widget.Constraints()).height
            high = min(high, rect.height // 3)
            top = bottom - high if at_bottom else rect.y
            part.frame = gui.Rect(rect.x, top, rect.width, high)
            bottom = top if at_bottom else bottom
        top = self._head.frame.get_bottom()
        self.tabs.frame = gui.Rect(rect.x, top, rect.width, max(bottom - top, 1))

    @property
    def doing(self) -> str:
        """Current activity and its progress, as text; empty if idle."""
        if not self._loading.visible:
            return ""
        return f"{' '.join(self.status.text.split())} {100 * self.progress.value:.0f} %"

    def show(self, name: str) -> None:
        """Bring a tab to the front, by its name."""
        self.tabs.selected_tab_index = list(self._named).index(name)

    def say(self, text: str, progress: float | None = None) -> None:
        """Show a status line; with `progress` (0-1), also a progress bar and a Stop button."""
        self.status.text = "\n".join(folded(text, _COLUMNS))
        self._loading.visible = progress is not None
        self.show_progress(progress or 0.0)
        self.status.visible, self.speed.visible = bool(text), not text
        self._viewer.window.set_needs_layout()

    def show_speed(self, seconds: float) -> None:
        """Show how long the last pictures took, while there is no other status."""
        text = f"at rest after {seconds:.2f} s" if seconds else ""
        if text != self.speed.text:
            self.speed.text = text
            self._viewer.window.set_needs_layout()

    def show_progress(self, progress: float) -> None:
        """Set the progress bar, 0-1."""
        self.progress.value = progress
        self._viewer.window.post_redraw()

    def refresh(self) -> None:
        """Update all controls and numbers from the viewer."""
        for tab in self._named.values():
            tab.refresh()
        self._legend.show(self._viewer.stage.legends)
        self._viewer.window.set_needs_layout()


def divided(rect: gui.Rect, em: int) -> tuple[gui.Rect, gui.Rect]:
    """Parts of a window for the panel and for the panes; em is the size of the font, pixels.

    The panel is below the panes if beside it these would be narrower than half of it.
    """
    wide = EMS * em
    room = rect.width - wide
    if 2 * room >= wide:
        panes = gui.Rect(rect.x, rect.y, room, rect.height)
        return gui.Rect(panes.get_right(), rect.y, wide, rect.height), panes
    high = max(rect.height - _HIGH * em, _PANES * em)
    panes = gui.Rect(rect.x, rect.y, rect.width, high)
    return gui.Rect(rect.x, panes.get_bottom(), rect.width, rect.height - high), panes


class _Legends:
    """The colour bar, with a row for each legend below it."""

    def __init__(self, em: float, margins: gui.Margins) -> None:
        self.widget = gui.Vert(0.25 * em, margins)
        bar = np.full((int(0.7 * em), 256, 4), 255, np.uint8)
        bar[..., :3] = np.rint(255 * Legend("", ()).bar(bar.shape[1], bar.shape[0]))
        # Hidden instead of removed; see HIDDEN in pane.py.
        self._bars = [picture_of(bar * np.uint8(seen)) for seen in (False, True)]
        self._bar = gui.ImageWidget(self._bars[False])
        self._bar.ui_image.scaling = gui.UIImage.Scaling.ANY
        self.widget.add_child(self._bar)
        self._rows = [_LegendRow(em) for _ in range(3)]
        for row in self._rows:
            self.widget.add_child(row.widget)

    def show(self, legends: list[Legend]) -> None:
        """Show these legends."""
        self._bar.update_image(self._bars[any(not legend.kinds for legend in legends)])
        for row, legend in zip_longest(self._rows, legends):
            row.show(legend)


class _LegendRow:
    """A legend: its title, and values below the colour bar or kinds in their colours."""

    def __init__(self, em: float) -> None:
        self.widget = gui.Vert(0.1 * em)
        self._title = gui.Label("")
        self._values, self._kinds = _Marks(_VALUES), _Marks(KINDS)
        for marks in (self._values, self._kinds):
            self.widget.add_child(marks.widget)
        self.widget.add_child(self._title)

    def show(self, legend: Legend | None) -> None:
        """Show a legend, or none."""
        self.widget.visible = legend is not None
        if legend is not None:
            self._title.text = legend.title
            shown, other = self._values, self._kinds
            if legend.kinds:
                shown, other = other, shown
            shown.show(legend)
            other.widget.visible = False


class _Marks:
    """The marks of a legend, from left to right."""

    def __init__(self, most: int) -> None:
        self.widget = gui.Horiz()
        self._labels = [gui.Label("") for _ in range(most)]
        for k, label in enumerate(self._labels):
            if k:
                self.widget.add_stretch()
            self.widget.add_child(label)

    def show(self, legend: Legend) -> None:
        """Show the marks of a legend."""
        self.widget.visible = True
        for k, label in enumerate(self._labels):
            label.text = legend.marks[k] if k < len(legend.marks) else ""
        for label, kind in zip(self._labels, legend.kinds, strict=False):
            label.text_color = gui.Color(*kind)

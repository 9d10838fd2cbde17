"""The view tab: navigation and the list of cameras."""

from __future__ import annotations

from open3d.visualization import gui

from viewer.pictures.charts import decibels
from viewer.scenes.choice import DOCKS
from viewer.window.controls import Controls
from viewer.window.dialogs import folded, shortened
from viewer.window.look_controls import LookControls
from viewer.window.widgets import Widgets, choose

#: Sort orders of the list of cameras.
_ORDERS = ("number", "name", "PSNR")


class ViewTab:
    """Navigation, and the list of viewpoints.

    Attributes
    ----------
    widget : gui.Widget
    up, order, dock : gui.Combobox
    look : LookControls
    list : gui.ListView
    """

    def __init__(self, viewer: Controls, widgets: Widgets) -> None:
        self._viewer = viewer
        self.widget, upper, self._below = widgets.tab()
        visits = viewer.visits
        widgets.row(
            upper,
            widgets.button("<", lambda: visits.go(-1), "previous view (P)"),
            widgets.button(">", lambda: visits.go(1), "next view (N)"),
            widgets.button("Reset", visits.reset, "return to the view (R)"),
            widgets.button("Overview", visits.overview, "Home"),
            widgets.button("All", viewer.frame_all, "show the whole scene (G)"),
        )
        self._where = gui.Label("")
        upper.add_child(self._where)
        self.look = LookControls(viewer, widgets, upper, self._below)
        self.flying = widgets.checkbox("drags look around (V); fly: WASD, QE", viewer.set_flying)
        self._below.add_child(self.flying)
        self.up = widgets.choice(
            self._below, "up axis", (), lambda k: visits.set_up(visits.views.ups[k])
        )
        self.dock = widgets.choice(self._below, "below", DOCKS, lambda k: viewer.set_dock(DOCKS[k]))
        self.order = widgets.choice(self._below, "sort views by", _ORDERS, lambda _: self.refresh())
        self.list = gui.ListView()
        self.list.set_max_visible_items(12)
        self.list.set_on_selection_changed(self._chosen)
        self._below.add_child(self.list)
        self._listed: list[str] = []
        self.places: list[int] = []

    def refresh(self) -> None:
        """Update controls and the list."""
        viewer, visits = self._viewer, self._viewer.visits
        self._where.text = "\n".join(folded(visits.where, 38)) if visits.viewpoints else ""
        self.flying.checked = viewer.choice.flying
        choose(self.up, visits.views.ups, visits.views.ups.index(viewer.choice.up))
        self.look.refresh()
        self.dock.selected_index = DOCKS.index(viewer.choice.dock)
        self._list()

    def _list(self) -> None:
        visits, known = self._viewer.visits, self._viewer.dock.survey.decibels
        points = visits.viewpoints
        order = self.order.selected_text
        places = list(range(len(points)))
        if order == "name":
            places = sorted(places, key=lambda k: points[k].name)
        elif order == "PSNR":
            places = sorted(places, key=lambda k: (known.get(k, float("inf")), k))
        self.places = places
        lines = [
            shortened(points[k].name, 26) + (f"  {decibels(known[k])}" if k in known else "")
            for k in self.places
        ]
        if lines != self._listed:
            self._listed = lines
            self.list.set_items(lines)
        here = visits.number if self.places and not visits.moved else None
        self.list.selected_index = -1 if here is None else self.places.index(here)

    def _chosen(self, _: str, __: bool) -> None:
        place = self.list.selected_index
        if 0 <= place < len(self.places):
            self._viewer.visits.go_to(self.places[place])

"""The tab for the picked Gaussian."""

from __future__ import annotations

from open3d.visualization import gui

from viewer.scenes.picked_text import picked_sections
from viewer.window.controls import Controls
from viewer.window.measuring import MeasureControls
from viewer.window.widgets import Widgets

#: Width of a row, characters.
_COLUMNS = 41

_NOTHING = "Click a pixel to pick the Gaussian\nthat contributes most to it."


class PickTab:
    """All information about the picked Gaussian.

    Attributes
    ----------
    widget : gui.Widget
    text : gui.Label
    measure : MeasureControls
    """

    def __init__(self, viewer: Controls, widgets: Widgets, font: int) -> None:
        self._viewer = viewer
        self.widget = widgets.column()

        def clear() -> None:
            viewer.picking.clear()

        self._clear = widgets.button("Clear", clear, "clear the pick (Esc)")
        widgets.row(self.widget, self._clear)
        self.measure = MeasureControls(viewer.measuring, widgets, self.widget)
        self.text = gui.Label(_NOTHING)
        self.text.font_id = font
        self.widget.add_child(self.text)

    def refresh(self) -> None:
        """Update the text."""
        picking = self._viewer.picking
        picking.follow()
        self.measure.refresh()
        self._clear.enabled = picking.hit is not None
        if picking.hit is None:
            self.text.text = "" if self._viewer.measuring.on else _NOTHING
        elif picking.picked is None:
            self.text.text = "..."
        else:
            lines = []
            for title, rows in picked_sections(picking.picked):
                lines += ["", title, *(line for row in rows for line in _row(*row))]
            self.text.text = "\n".join(lines[1:])


def _row(name: str, value: str) -> list[str]:
    """A name on the left and a value on the right; below it if there is no room."""
    if len(name) + len(value) < _COLUMNS:
        return [name + value.rjust(_COLUMNS - len(name))]
    return [name, value.rjust(_COLUMNS)]

"""The tab for the picked Gaussian, for measuring and annotating."""

from __future__ import annotations

import math

from open3d.visualization import gui

from viewer.scenes.picked_text import picked_sections
from viewer.window.controls import Controls
from viewer.window.widgets import Widgets, choose

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
    notes : NoteControls
    """

    def __init__(self, viewer: Controls, widgets: Widgets, font: int) -> None:
        self._viewer = viewer
        self.widget = widgets.column()

        def clear() -> None:
            viewer.picking.clear()

        self._clear = widgets.button("Clear", clear, "clear the pick (Esc)")
        widgets.row(self.widget, self._clear)
        self.measure = MeasureControls(viewer, widgets, self.widget)
        self.notes = NoteControls(viewer, widgets, self.widget)
        self.text = gui.Label(_NOTHING)
        self.text.font_id = font
        self.widget.add_child(self.text)

    def refresh(self) -> None:
        """Update the text."""
        picking = self._viewer.picking
        picking.follow()
        self.measure.refresh()
        self.notes.refresh()
        self._clear.enabled = picking.hit is not None
        if picking.hit is None:
            uses = self._viewer.measuring.on or self._viewer.annotating.on
            self.text.text = "" if uses else _NOTHING
        elif picking.picked is None:
            self.text.text = "..."
        else:
            lines = []
            for title, rows in picked_sections(picking.picked):
                lines += ["", title, *(line for row in rows for line in _row(*row))]
            self.text.text = "\n".join(lines[1:])


class MeasureControls:
    """A switch for measuring, the distance, and a field for a known length."""

    def __init__(self, viewer: Controls, widgets: Widgets, parent: gui.Widget) -> None:
        self._viewer = viewer
        self._measuring = measuring = viewer.measuring
        self.on = widgets.checkbox("measure distances (Y)", lambda _: viewer.measure())
        parent.add_child(self.on)
        self._said = gui.Label("")
        parent.add_child(self._said)
        self.length = widgets.number(measuring.set_length)
        tip = "Scale the scene until the line has this length."
        self.scale = widgets.button("Scale", self._scale, tip)
        self._row = widgets.row(parent, gui.Label("known length"), self.length, self.scale)

    def _scale(self) -> None:
        length = self.length.double_value
        if length > 0:
            self._measuring.set_length(length)  # the click may come before the field tells it
            self._viewer.placing.scale_all(self._measuring.take_unit())

    def refresh(self) -> None:
        """Update the controls."""
        measuring = self._measuring
        self.on.checked = measuring.on
        self._said.text = measuring.text
        self._said.visible = bool(measuring.text)
        self._row.visible = measuring.distance is not None
        if measuring.distance is not None:
            length = measuring.unit * measuring.distance
            self.length.decimal_precision = max(3, 3 - math.floor(math.log10(length or 1)))
            self.length.double_value = length
            self.scale.enabled = self._viewer.editor.edits is not None


class NoteControls:
    """A switch for annotating, the list of annotations, and the texts of the chosen one."""

    def __init__(self, viewer: Controls, widgets: Widgets, parent: gui.Widget) -> None:
        self._annotating = annotating = viewer.annotating
        self.on = widgets.checkbox("annotate (ctrl + N)", lambda _: viewer.annotate())
        parent.add_child(self.on)
        self._rows = gui.Vert(0.3 * widgets.em)
        parent.add_child(self._rows)
        self._rows.add_child(gui.Label("Click a point, or a ring to choose it."))
        self.list = widgets.choice(self._rows, "annotation", (), annotating.choose)
        self.title, self.text = gui.TextEdit(), gui.TextEdit()
        self.text.placeholder_text = "text"
        self.title.set_on_text_changed(annotating.set_title)
        self.text.set_on_text_changed(annotating.set_text)
        for field in (self.title, self.text):
            self._rows.add_child(field)
        made = (
            ("Remove", annotating.remove, "Remove this annotation."),
            ("Save", annotating.ask_save, "Save all, for gs-codec share --annotations."),
            ("Open", annotating.ask_open, "Add the annotations of a file."),
        )
        self.buttons = {name: widgets.button(name, action, tip) for name, action, tip in made}
        widgets.row(self._rows, *self.buttons.values())

    def refresh(self) -> None:
        """Update the controls."""
        annotating, chosen = self._annotating, self._annotating.chosen
        self.on.checked = self._rows.visible = annotating.on
        choose(self.list, annotating.names, chosen or 0)
        for widget in (self.list, self.title, self.text, self.buttons["Remove"]):
            widget.enabled = chosen is not None
        self.buttons["Save"].enabled = bool(annotating.notes)
        self.title.placeholder_text = "title" if chosen is None else annotating.titles[chosen]
        note = None if chosen is None else annotating.notes[chosen]
        for field, text in ((self.title, note and note.title), (self.text, note and note.text)):
            if field.text_value != (text or ""):
                field.text_value = text or ""


def _row(name: str, value: str) -> list[str]:
    """A name on the left and a value on the right; below it if there is no room."""
    if len(name) + len(value) < _COLUMNS:
        return [name + value.rjust(_COLUMNS - len(name))]
    return [name, value.rjust(_COLUMNS)]

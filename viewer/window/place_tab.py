"""The place tab: the list of scenes, and moving, turning and scaling by numbers."""

from __future__ import annotations

from collections.abc import Callable

from open3d.visualization import gui

from viewer.scenes.edits import Edits
from viewer.window.controls import Controls
from viewer.window.widgets import Widgets


class PlaceTab:
    """Scenes joined in the edited one, and numbers that place the selection.

    Attributes
    ----------
    widget : gui.Widget
    buttons : dict of str to gui.Button
    list : gui.ListView
    name : gui.TextEdit
    shift, angles : gui.VectorEdit
    factor : gui.NumberEdit
    middle : gui.Checkbox
    """

    def __init__(self, viewer: Controls, widgets: Widgets) -> None:
        self._viewer, self._widgets = viewer, widgets
        self.buttons: dict[str, gui.Button] = {}
        self.widget = widgets.column()
        self._add_list()
        self._add_numbers()

    def _add_list(self) -> None:
        placing = self._viewer.placing
        self.list = gui.ListView()
        self.list.set_max_visible_items(5)
        self.list.set_on_selection_changed(lambda _, __: self._name())
        self.name = gui.TextEdit()
        self.name.tooltip = "The name of the scene in the list; Enter sets it."
        self.name.set_on_value_changed(self._rename)
        self.widget.add_child(self.list)
        self.widget.add_child(self.name)
        self._row(
            ("Add", placing.ask_add, "Add a scene to the edited one."),
            ("Select", lambda: self._of(placing.select_part), "Select this scene."),
            (
                "Up",
                lambda: self._do(Edits.raise_part),
                "Move this scene up; files have this order.",
            ),
            ("Hide", lambda: self._do(Edits.hide_part), "Hide or show this scene."),
            ("Remove", lambda: self._of(placing.remove_part), "Remove this scene."),
        )

    def _add_numbers(self) -> None:
        placing, widgets = self._viewer.placing, self._widgets
        tip = "Arrows move, rings turn, the circle scales the selection, or all."
        self._row(("handles", lambda: self._viewer.editor.set_tool("place"), tip))
        self.buttons["handles"].toggleable = True
        self.shift, self.angles = gui.VectorEdit(), gui.VectorEdit()
        self.factor = widgets.number(lambda _: None)
        self.factor.double_value = 1
        self.middle = widgets.checkbox("about its middle, not 0", lambda _: None)
        self.middle.checked = True
        self.widget.add_child(gui.Label("move by x, y, z"))
        self.widget.add_child(self.shift)
        self.widget.add_child(gui.Label("turn by degrees about x, y, z"))
        self.widget.add_child(self.angles)
        widgets.row(self.widget, gui.Label("scale"), self.factor, self.middle)
        self._row(("Apply", self._apply, "Scale, turn, then move the selection, or all."))
        self._row(
            ("Save project", placing.ask_save, "Save the list of scenes and all edits."),
            ("Command", placing.command, "Show the same edits as a line of gs-codec convert."),
        )

    def _row(self, *made: tuple[str, Callable[[], None], str]) -> None:
        for text, action, tip in made:
            self.buttons[text] = self._widgets.button(text, action, tip)
        self._widgets.row(self.widget, *(self.buttons[text] for text, _, _ in made))

    def _of(self, action: Callable[[int], None]) -> None:
        """Do something with the scene selected in the list."""
        edits, index = self._viewer.editor.edits, self.list.selected_index
        if edits is not None and 0 <= index < len(edits.parts):
            action(edits.parts[index][0])

    def _do(self, step: Callable[[Edits, int], None]) -> None:
        self._of(lambda number: self._viewer.editor.do(lambda edits: step(edits, number)))

    def _name(self) -> None:
        edits, index = self._viewer.editor.edits, self.list.selected_index
        if edits is not None and 0 <= index < len(edits.parts):
            self.name.text_value = edits.parts[index][1]

    def _rename(self, name: str) -> None:
        self._do(lambda edits, number: edits.rename(number, name))

    def _apply(self) -> None:
        shift, angles = self.shift.vector_value.tolist(), self.angles.vector_value.tolist()
        self._viewer.placing.place(shift, angles, self.factor.double_value, self.middle.checked)

    def refresh(self) -> None:
        """Update the list and the buttons."""
        editor = self._viewer.editor
        parts = editor.edits.parts if editor.edits is not None else []
        lines = [f"{name}  {n:,}{' hidden' if hidden else ''}" for _, name, n, hidden in parts]
        index = min(max(self.list.selected_index, 0), len(lines) - 1)
        self.list.set_items(lines)
        self.list.selected_index = index
        self._name()
        self.buttons["handles"].is_on = editor.tool == "place"
        for button in self.buttons.values():
            button.enabled = bool(parts)

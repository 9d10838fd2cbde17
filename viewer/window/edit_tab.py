"""The edit tab: selecting, hiding, deleting, saving."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from open3d.visualization import gui

from viewer.pictures.layers import SELECTED
from viewer.scenes.edits import HOW, Edits
from viewer.scenes.selecting import grown, shrunk
from viewer.window.controls import Controls
from viewer.window.editor import NAVIGATE
from viewer.window.widgets import Widgets, choose

#: Tools, with their tips.
_TOOLS = {
    NAVIGATE: "Drags move the camera.",
    "box": "Drags select by boxes (X).",
    "lasso": "Drags select by lassos (L).",
    "polygon": "Clicks are corners; the first corner or Enter closes it, Esc drops it (Z).",
    "brush": "Drags select what the brush passes (B; [ and ] change its size).",
    "sphere": "Drags select by spheres around the Gaussian under the mouse (J).",
    "colour": "Clicks select this colour, within the tolerance (of 255).",
    "flood": "Clicks select connected Gaussians of this colour, within the tolerance.",
}

#: Texts for ways to select.
_HOW = {
    "replace": "select",
    "add": "add (shift)",
    "remove": "remove (ctrl)",
    "intersect": "intersect (both)",
}


class EditTab:
    """Tools and steps for the edited scene.

    Attributes
    ----------
    widget : gui.Widget
    buttons : dict of str to gui.Button
        Buttons by text; those of tools by tool.
    scene, rule : gui.Combobox
    how : gui.Combobox
    footprint, front : gui.Checkbox
    radius, tolerance : gui.NumberEdit
    low, high : gui.VectorEdit
        Corners of the box to crop to.
    """

    def __init__(self, viewer: Controls, widgets: Widgets) -> None:
        self._viewer, self._widgets = viewer, widgets
        self._editor = viewer.editor
        self.buttons: dict[str, gui.Button] = {}
        self.widget = widgets.column()
        self.scene = widgets.choice(self.widget, "scene", (), self._editor.set_number)
        self._add_tools()
        self._add_steps()
        self._add_box()
        tip = "Save the scene in any output format (ctrl + shift + S)."
        self._row(("Save as ...", self._editor.ask_save, tip))
        self._unsaved = gui.Label("")
        self.widget.add_child(self._unsaved)

    def _add_tools(self) -> None:
        """Tools for drags in panes."""
        tools = [(tool, partial(self._editor.set_tool, tool), tip) for tool, tip in _TOOLS.items()]
        for row in (tools[:4], tools[4:]):
            self._row(*row)
        for tool in _TOOLS:
            self.buttons[tool].toggleable = True
        options = self._editor.selecting

        def number(name: str, tip: str) -> gui.NumberEdit:
            edit = self._widgets.number(lambda value: setattr(options, name, round(value)), True)
            edit.int_value = getattr(options, name)
            edit.set_preferred_width(int(5.6 * self._widgets.em))
            edit.tooltip = tip
            return edit

        self.radius = number("radius", "radius of the brush, pixels ([ and ])")
        self.tolerance = number("tolerance", "largest difference of colour and flood, of 255")
        self.how = gui.Combobox()
        for how in HOW:
            self.how.add_item(_HOW[how])
        self.how.set_on_selection_changed(lambda _, k: setattr(options, "how", HOW[int(k)]))
        self.how.tooltip = "shift adds, ctrl removes, both intersect"
        self.footprint = self._widgets.checkbox(
            "footprints", lambda on: setattr(options, "footprint", on)
        )
        self.footprint.tooltip = "Regions also select by splats, not only by centres."
        self.front = self._widgets.checkbox("front", lambda on: setattr(options, "front", on))
        self.front.tooltip = "Regions select only what is seen: nothing behind a surface."
        self._widgets.row(self.widget, self.how, self.footprint, self.front)
        numbers = gui.Label("brush"), self.radius, gui.Label("tolerance"), self.tolerance
        self._widgets.row(self.widget, *numbers)

    def _add_steps(self) -> None:
        """Steps that use the selection."""

        def does(step: Callable[[Edits], None]) -> Callable[[], None]:
            return lambda: self._editor.do(step)

        self.count = gui.Label("")
        self.count.text_color = gui.Color(*SELECTED)
        self.widget.add_child(self.count)
        self._row(
            ("All", does(Edits.select_all), "ctrl + A"),
            ("None", does(Edits.select_none), "ctrl + D"),
            ("Invert", does(Edits.invert), "ctrl + I"),
            ("Grow", lambda: self._editor.neighbours(grown), "Add the neighbours."),
            ("Shrink", lambda: self._editor.neighbours(shrunk), "Remove the outermost."),
        )
        self.rule = gui.Combobox()
        button = self._widgets.button("Select", self._select_by, "Select these Gaussians.")
        self.buttons["Select"] = button
        self._widgets.row(self.widget, self.rule, button)
        self._row(
            ("Delete", does(Edits.delete), "Delete the selection (Delete)."),
            ("Hide", does(Edits.hide), "Hide the selection (ctrl + H)."),
            ("Show all", does(Edits.show_all), "Show all hidden Gaussians."),
        )
        self._row(("Undo", does(Edits.undo), "ctrl + Z"), ("Redo", does(Edits.redo), "ctrl + Y"))
        self._steps = gui.Label("")
        self.widget.add_child(self._steps)

    def _add_box(self) -> None:
        """The box to crop to."""
        self.low, self.high = gui.VectorEdit(), gui.VectorEdit()
        self.widget.add_child(gui.Label("box: lowest and highest x, y, z"))
        self.widget.add_child(self.low)
        self.widget.add_child(self.high)
        self._row(
            ("Of selection", self._take_box, "Use the box around the selection."),
            ("Crop", self._crop, "Delete everything outside the box."),
        )

    def _row(self, *made: tuple[str, Callable[[], None], str]) -> None:
        """A row of buttons, each with text, action and tooltip."""
        for text, action, tip in made:
            self.buttons[text] = self._widgets.button(text, action, tip)
        self._widgets.row(self.widget, *(self.buttons[text] for text, _, _ in made))

    def _select_by(self) -> None:
        self._editor.select_by(self.rule.selected_text)

    def _take_box(self) -> None:
        box = self._editor.box
        if box is not None:
            self.low.vector_value, self.high.vector_value = box

    def _crop(self) -> None:
        self._editor.crop(self.low.vector_value.tolist(), self.high.vector_value.tolist())

    def refresh(self) -> None:
        """Update controls and numbers."""
        editor, edits = self._editor, self._editor.edits
        scenes = self._viewer.stage.scenes
        names = [f"{letter}: {scene.name}" for letter, scene in zip("AB", scenes, strict=False)]
        choose(self.scene, names, editor.number)
        for tool in _TOOLS:
            self.buttons[tool].is_on = editor.tool == tool
        self.radius.int_value = editor.selecting.radius
        choose(self.rule, editor.rules, max(self.rule.selected_index, 0))
        for text, button in self.buttons.items():
            button.enabled = text in _TOOLS or edits is not None
        if edits is None:
            return
        hidden = f", {edits.hidden_count:,} hidden" if edits.hidden_count else ""
        self.count.text = f"{edits.count:,} of {edits.scene.count:,} selected{hidden}"
        for text in ("Delete", "Hide", "Of selection", "Grow", "Shrink"):
            self.buttons[text].enabled = bool(edits.count)
        self.buttons["Show all"].enabled = bool(edits.hidden_count)
        self.buttons["Undo"].enabled = bool(edits.undone_next)
        self.buttons["Redo"].enabled = bool(edits.redone_next)
        steps = (("undo", edits.undone_next), ("redo", edits.redone_next))
        self._steps.text = ", ".join(f"{name} {step}" for name, step in steps if step)
        self._unsaved.text = "edits are not saved" if edits.unsaved else ""

"""Widgets of the panel, each with a callback."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from open3d.visualization import gui


class Widgets:
    """Makes widgets in a common style.

    Parameters
    ----------
    em : float
        Size of the font, pixels.
    """

    def __init__(self, em: float) -> None:
        self.em = em

    def column(self) -> gui.Widget:
        """The content of a tab."""
        return gui.ScrollableVert(0.3 * self.em, self._margins)

    def tab(self) -> tuple[gui.Widget, gui.Widget, gui.Widget]:
        """A tab with sliders: the whole, its fixed upper part and its scrolling part.

        Sliders belong in the fixed part, because Open3D draws them without a track in scrolling
        parts.
        """
        upper = gui.Vert(0.3 * self.em, self._margins)
        below = self.column()
        whole = gui.Vert(0)
        whole.add_child(upper)
        whole.add_child(below)
        return whole, upper, below

    @property
    def _margins(self) -> gui.Margins:
        return gui.Margins(0.5 * self.em, 0.5 * self.em, 0.5 * self.em, 0.5 * self.em)

    def row(self, parent: gui.Widget, *children: gui.Widget) -> gui.Horiz:
        """Widgets side by side, added to a parent."""
        row = gui.Horiz(0.3 * self.em)
        for child in children:
            row.add_child(child)
        parent.add_child(row)
        return row

    def button(self, text: str, action: Callable[[], None], tip: str = "") -> gui.Button:
        """A button."""
        button = gui.Button(text)
        button.horizontal_padding_em, button.vertical_padding_em = 0.5, 0.1
        button.set_on_clicked(action)
        button.tooltip = tip
        return button

    def checkbox(self, text: str, checked: Callable[[bool], None]) -> gui.Checkbox:
        """A checkbox; `checked` is called with its state."""
        box = gui.Checkbox(text)
        box.set_on_checked(checked)
        return box

    def choice(
        self,
        parent: gui.Widget,
        text: str,
        names: Sequence[str],
        chosen: Callable[[int], None],
        *others: gui.Widget,
    ) -> gui.Combobox:
        """A labelled combo box, and other widgets next to it; `chosen` is called with the index."""
        box = gui.Combobox()
        for name in names:
            box.add_item(name)
        box.set_on_selection_changed(lambda _, index: chosen(int(index)))
        self.row(parent, self._lowered(text), box, *others)
        return box

    def _lowered(self, text: str) -> gui.Widget:
        """A label aligned with the text of a combo box next to it."""
        below = gui.Vert(0, gui.Margins(0, 0.2 * self.em, 0, 0))
        below.add_child(gui.Label(text))
        return below

    def slider(
        self,
        parent: gui.Widget,
        text: str,
        limits: tuple[int, int] | tuple[float, float],
        moved: Callable[[float], None],
        whole: bool = False,
    ) -> gui.Slider:
        """A labelled slider, added to a parent; `moved` is called with its value."""
        slider = gui.Slider(gui.Slider.INT if whole else gui.Slider.DOUBLE)
        slider.set_limits(*limits)
        slider.set_on_value_changed(lambda value: moved(float(value)))
        parent.add_child(gui.Label(text))
        parent.add_child(slider)
        return slider

    def number(self, changed: Callable[[float], None], whole: bool = False) -> gui.NumberEdit:
        """A field for a number; `changed` is called with its value."""
        field = gui.NumberEdit(gui.NumberEdit.INT if whole else gui.NumberEdit.DOUBLE)
        field.set_preferred_width((7 if whole else 5) * self.em)  # a whole number has - and +
        field.set_on_value_changed(lambda value: changed(float(value)))
        return field

    def grid(self, parent: gui.Widget) -> gui.VGrid:
        """A grid of two columns, such as labels and sliders, added to a parent."""
        grid = gui.VGrid(2, 0.3 * self.em)
        parent.add_child(grid)
        return grid


def choose(box: gui.Combobox, names: Sequence[str], index: int) -> None:
    """Set the names in a combo box, if they have changed, and its selection."""
    if [box.get_item(k) for k in range(box.number_of_items)] != list(names):
        box.clear_items()
        for name in names:
            box.add_item(name)
    box.selected_index = index


def monospace() -> int:
    """The font for numbers; call this before a window is created."""
    description = gui.FontDescription(gui.FontDescription.MONOSPACE)
    return gui.Application.instance.add_font(description)

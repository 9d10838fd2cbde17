"""A short text over the panes, beside a place in a picture."""

from __future__ import annotations

from numpy.typing import NDArray
from open3d.visualization import gui

#: Distance from the place, in font sizes.
_BESIDE = 0.5


class Tag:
    """A text that keeps inside a pane, created before it: clicks then reach the pane.

    Attributes
    ----------
    label : gui.Label
    """

    def __init__(self, window: gui.Window) -> None:
        self._em = window.theme.font_size
        self._shown: tuple[object, ...] = ()
        self._pane: gui.Widget | None = None
        self.label = gui.Label("")
        self.label.background_color = gui.Color(0.0, 0.0, 0.0, 0.75)
        self.label.visible = False
        window.add_child(self.label)

    def show(self, text: str, at: NDArray, pane: gui.Widget) -> bool:
        """Show a text beside a pixel of a pane; return whether to draw the window."""
        if pane is not self._pane:
            # Over another pane, Open3D shows it only if it was hidden in a frame.
            self._pane = pane
            self.hide()
            return True
        frame = pane.frame
        shown = text, *at.tolist(), frame.x, frame.y, frame.width, frame.height
        if shown == self._shown:
            return False
        self._shown = shown
        self.label.visible = True
        self.label.text = f" {text} "
        em, wide = self._em, int(len(self.label.text) * 0.55 * self._em)
        x, y = at + _BESIDE * em
        x, y = max(min(x, frame.width - wide), 0), max(min(y, frame.height - 1.5 * em), 0)
        wide = min(wide, frame.width)
        self.label.frame = gui.Rect(frame.x + int(x), frame.y + int(y), wide, int(1.5 * em))
        return True

    def hide(self) -> bool:
        """Hide the text; return whether to draw the window."""
        was, self.label.visible, self._shown = self.label.visible, False, ()
        return was

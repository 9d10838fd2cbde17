"""A line over the panes, on what the window waits for, or how to begin while it is empty."""

from __future__ import annotations

import time

from open3d.visualization import gui

from gs_codec.runtime import compiling
from viewer.window.shared import Host

#: Minimum compile time that is shown, seconds.
_SHORT = 0.5

#: Time that the line stays after compiling, seconds.
_STAYS = 1.0

#: Text of an empty window.
_EMPTY = "Press O to open a scene, H for a list of keys."


class Notice:
    """The line: in the middle while no scene is shown, otherwise in the lower left corner.

    Parameters
    ----------
    viewer : Host
    """

    def __init__(self, viewer: Host) -> None:
        self._viewer = viewer
        self.label = gui.Label("")
        self.label.visible = False
        viewer.window.add_child(self.label)
        self._seconds, self._seen, self._ticked = 0.0, -_STAYS, time.monotonic()

    def tick(self) -> bool:
        """Update the line; return whether it changed."""
        now = time.monotonic()
        seconds = compiling.elapsed()
        if seconds is not None:
            self._seconds, self._seen = seconds, now
        self._ticked = now
        text = self._text()
        if text == self.label.text:
            return False
        self.label.text, self.label.visible = text, bool(text)
        self._viewer.window.set_needs_layout()
        return True

    @property
    def compiles(self) -> bool:
        """Whether kernels are being compiled, or were until a moment ago."""
        return self._ticked - self._seen < _STAYS

    def _text(self) -> str:
        if self.compiles and self._seconds > _SHORT:
            return f"Compiling, once only: {self._seconds:.0f} s"
        panel, shows = self._viewer.panel, bool(self._viewer.stage.scenes)
        return "" if shows else panel.doing or _EMPTY

    def lay_out(self, space: gui.Rect, context: gui.LayoutContext) -> None:
        """Place the line in the space of the panes."""
        size = self.label.calc_preferred_size(context, gui.Widget.Constraints())
        wide, high = min(size.width, space.width), min(size.height, space.height)
        x, y = space.x, space.get_bottom() - high
        if not self._viewer.stage.scenes:
            x, y = x + (space.width - wide) // 2, space.y + (space.height - high) // 2
        self.label.frame = gui.Rect(x, y, wide, high)

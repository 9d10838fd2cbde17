"""The line between the two halves of a wipe, which the mouse drags."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from open3d.visualization import gui, rendering

from viewer.pane import picture_of
from viewer.picture import LINE_COLOUR

#: Dots that say that the line can be dragged: their number, size and distance, pixels; RGB.
_DOTS, _DOT, _STEP, _DOT_COLOUR = 5, 4, 9, 0.2


class Divider:
    """A line that stands in a gap between two panes.

    Parameters
    ----------
    window : gui.Window
    slide : callable
        Called with the column of the window that it was dragged to.
    """

    def __init__(self, window: gui.Window, slide: Callable[[int], None]) -> None:
        self._slide = slide
        # Of all widgets a scene alone tells of the mouse.
        self.widget = gui.SceneWidget()
        self.widget.scene = rendering.Open3DScene(window.renderer)
        self.widget.scene.show_skybox(False)
        self.widget.scene.view.set_post_processing(False)
        self.widget.set_on_mouse(self._mouse)
        self._size = (0, 0)
        window.add_child(self.widget)

    def place(self, rect: gui.Rect) -> None:
        """Put it into a part of the window; out of sight, it is `HIDDEN`."""
        # A scene of the same size elsewhere would be drawn where it was before.
        self.widget.frame = gui.Rect(rect.x, rect.y, rect.width, rect.height + 1)
        self.widget.frame = rect
        if self._size != (rect.width, rect.height):
            self._size = (rect.width, rect.height)
            image = picture_of(_dotted(rect.width, rect.height))
            self.widget.scene.set_background((*LINE_COLOUR, 1.0), image)
        self.widget.force_redraw()

    def _mouse(self, event: Any) -> Any:
        if event.type == gui.MouseEvent.Type.DRAG:
            self._slide(event.x)
        return gui.Widget.EventCallbackResult.CONSUMED


def _dotted(width: int, height: int) -> np.ndarray:
    """The line with dots in its middle, ``(height, width, 3)``."""
    image = np.empty((height, width, 3), np.float32)
    image[:] = LINE_COLOUR
    left = max((width - _DOT) // 2, 0)
    for dot in range(_DOTS):
        top = max((height - _DOT) // 2 + _STEP * (dot - _DOTS // 2), 0)
        image[top : top + _DOT, left : left + _DOT] = _DOT_COLOUR
    return image

"""The line between the two halves of a wipe, which the mouse drags."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from open3d.visualization import gui, rendering

from viewer.pictures.picture import LINE_COLOUR
from viewer.window.pane import picture_of

#: Dots that show that the line can be dragged: number, size and distance in pixels; grey level.
_DOTS, _DOT, _STEP, _DOT_COLOUR = 5, 4, 9, 0.2


class Divider:
    """A line in the gap between two panes.

    Parameters
    ----------
    window : gui.Window
    slide : callable
        Called with the column of the window to which the line was dragged.
    """

    def __init__(self, window: gui.Window, slide: Callable[[int], None]) -> None:
        self._slide = slide
        # Only scene widgets report mouse events.
        self.widget = gui.SceneWidget()
        self.widget.scene = rendering.Open3DScene(window.renderer)
        self.widget.scene.show_skybox(False)
        self.widget.scene.view.set_post_processing(False)
        self.widget.set_on_mouse(self._mouse)
        self._size = (0, 0)
        window.add_child(self.widget)

    def move_to(self, rect: gui.Rect) -> None:
        """Set its position in the window; to hide it, its size is `HIDDEN`."""
        # If only the position changed, Open3D would draw the scene at the old position.
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

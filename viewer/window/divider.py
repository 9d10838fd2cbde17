"""The line between the two halves of a wipe, which can be dragged."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from open3d.visualization import gui

from viewer.pictures.picture import LINE_COLOUR
from viewer.window.canvas import Canvas

#: Number of dots that mark the line as draggable.
_DOTS = 5

#: Size of a dot, pixels.
_DOT = 4

#: Distance between dots, pixels.
_STEP = 9

#: Grey level of a dot.
_DOT_COLOUR = 0.2


def make_divider(window: gui.Window, slide: Callable[[int], None]) -> Canvas:
    """A line in the gap between two panes.

    Parameters
    ----------
    window : gui.Window
    slide : callable
        Called with the column of the window to which the line was dragged.
    """

    def mouse(event: gui.MouseEvent) -> None:
        if event.type == gui.MouseEvent.Type.DRAG:
            slide(event.x)

    return Canvas(window, _dotted, mouse)


def _dotted(width: int, height: int) -> np.ndarray:
    """The line, if it is wide with dots in its middle, ``(height, width, 3)``."""
    image = np.empty((height, width, 3), np.float32)
    image[:] = LINE_COLOUR
    left = (width - _DOT) // 2
    for dot in range(_DOTS if left >= 0 else 0):
        top = max((height - _DOT) // 2 + _STEP * (dot - _DOTS // 2), 0)
        image[top : top + _DOT, left : left + _DOT] = _DOT_COLOUR
    return image

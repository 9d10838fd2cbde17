"""A picture in the window that reports mouse events."""

from __future__ import annotations

from collections.abc import Callable

from numpy.typing import NDArray
from open3d.visualization import gui, rendering

from viewer.window.backdrop import Backdrop


class Canvas:
    """A picture as large as its widget.

    Parameters
    ----------
    window : gui.Window
    draw : callable
        Called with width and height in pixels; returns a picture ``(H, W, 3)``, float32, 0-1.
    mouse : callable
        Called with a mouse event.

    Attributes
    ----------
    widget : gui.SceneWidget
        Only scene widgets report mouse events.
    """

    def __init__(
        self,
        window: gui.Window,
        draw: Callable[[int, int], NDArray],
        mouse: Callable[[gui.MouseEvent], None],
    ) -> None:
        self._draw, self._report = draw, mouse
        self.widget = gui.SceneWidget()
        self.widget.scene = rendering.Open3DScene(window.renderer)
        self.widget.scene.show_skybox(False)
        self.widget.scene.view.set_post_processing(False)
        self._backdrop = Backdrop(window, self.widget)
        self.widget.set_on_mouse(self._mouse)
        self._size = (0, 0)
        window.add_child(self.widget)

    def move_to(self, rect: gui.Rect) -> None:
        """Set its position in the window; a size of `HIDDEN` hides it."""
        before = self.widget.frame
        if (before.x, before.y) != (rect.x, rect.y):
            # Open3D would draw the scene at the old position if only the position changed.
            self.widget.frame = gui.Rect(rect.x, rect.y, rect.width, rect.height + 1)
        self.widget.frame = rect
        if self._size != (rect.width, rect.height):
            self._size = (rect.width, rect.height)
            self.redraw()

    def redraw(self) -> None:
        """Redraw the picture."""
        if min(self._size) > 0:
            self._backdrop.show(self._draw(*self._size))

    def _mouse(self, event: gui.MouseEvent) -> gui.Widget.EventCallbackResult:
        self._report(event)
        return gui.Widget.EventCallbackResult.CONSUMED

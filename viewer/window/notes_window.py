"""A small window with notes, next to a window of Open3D that has no room for them."""

from __future__ import annotations

import numpy as np
from open3d.visualization import gui
from PIL import Image

from viewer.window.backdrop import picture_of

#: Open3D's flag for windows that stay on top.
_TOPMOST = 2

#: Distance from the corner of the other window, pixels.
_AWAY = 12

#: Height of the menu, pixels.
_MENU = 32


class NotesWindow:
    """A window with a picture, at the lower left of another window."""

    def __init__(self) -> None:
        self._window: gui.Window | None = None

    @property
    def frame(self) -> gui.Rect | None:
        """Its frame on the screen; None if it is not open."""
        return None if self._window is None else self._window.os_frame

    def show(self, picture: Image.Image, neighbour: gui.Rect) -> None:
        """Show a picture; `neighbour` is the frame of the other window."""
        self.close()
        high = picture.height + _MENU
        top = max(neighbour.get_bottom() - high - _AWAY, 0)
        app = gui.Application.instance
        window = app.create_window(
            "gs_codec", picture.width, high, neighbour.x + _AWAY, top, _TOPMOST
        )
        image = gui.ImageWidget(picture_of(np.asarray(picture)))
        window.add_child(image)

        def lay_out(_: object) -> None:
            image.frame = window.content_rect

        def closed() -> bool:
            self._window = None
            return True

        window.set_on_layout(lay_out)
        window.set_on_close(closed)
        self._window = window

    def close(self) -> None:
        """Close the window, if it is open."""
        if self._window is not None:
            self._window.close()
            self._window = None

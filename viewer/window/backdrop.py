"""Pictures behind the contents of scene widgets."""

from __future__ import annotations

from itertools import count

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from open3d.visualization import gui, rendering

#: Numbers for the pictures that become textures.
_NUMBERS = count()

#: Bits of such a number stored in each channel of a colour.
_BITS = 8


class Backdrop:
    """The picture behind the contents of a scene widget.

    Works around two bugs of Open3D 0.20. It counts one use too many of each texture made from a
    picture, so it never frees the texture. It also reuses a texture for any picture with the
    content that the texture had at first, even if that has been updated since.

    Parameters
    ----------
    window : gui.Window
    widget : gui.SceneWidget
    """

    def __init__(self, window: gui.Window, widget: gui.SceneWidget) -> None:
        self._renderer, self._widget = window.renderer, widget
        self._size: tuple[int, ...] | None = None
        self._uses = _uses(self._renderer)

    def show(self, picture: NDArray[np.float32]) -> None:
        """Show a picture ``(H, W, 3)``, 0-1, as large as the widget."""
        image, size = picture_of(picture), picture.shape[:2]
        if size == self._size:  # Open3D updates the texture
            self._set(image)
            return
        self._size = size
        _make_distinct(image)
        texture = self._renderer.add_texture(image, True)
        self._set(image)  # the same texture, with one more use
        for _ in range(self._uses):
            self._renderer.remove_texture(texture)

    def _set(self, image: o3d.geometry.Image) -> None:
        self._widget.scene.set_background((0.0, 0.0, 0.0, 1.0), image)


def picture_of(image: NDArray) -> o3d.geometry.Image:
    """Open3D's image of an array ``(H, W, 3)``, float32 or uint8."""
    return o3d.geometry.Image(np.ascontiguousarray(image))  # type: ignore[call-overload]


def _make_distinct(image: o3d.geometry.Image) -> None:
    """Make a picture unique in the lowest bits of its first pixel, which is invisible."""
    first, number = np.asarray(image)[0, 0].view(np.uint32), next(_NUMBERS)
    for k in range(len(first)):
        first[k] = first[k] >> _BITS << _BITS | number >> _BITS * k & (1 << _BITS) - 1


def _uses(renderer: rendering.Renderer) -> int:
    """Number of uses that Open3D counts for one use of a texture."""
    image = picture_of(np.zeros((1, 1, 3), np.float32))
    _make_distinct(image)
    texture = renderer.add_texture(image, True)
    renderer.remove_texture(texture)
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        if not renderer.update_texture(texture, image, True):
            return 1
    renderer.remove_texture(texture)
    return 2

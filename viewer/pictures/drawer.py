"""Splats drawn by gs_codec's rasterisers: exactly for measurements, or as fast drafts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

import gs_codec
from gs_codec.cameras.inria import as_camera
from gs_codec.rendering.frame import make_frame
from gs_codec.rendering.renderer import Rendering, render
from gs_codec.scene import Scene
from viewer.scenes.appearance import Look, gaussians_drawn
from viewer.scenes.numbers import quality_text
from viewer.scenes.opened import Opened
from viewer.scenes.pose import Pose

#: The unmodified scene.
_PLAIN = Look()

#: Pictures kept per scene: a pane needs two while a wipe moves over it, the frame one more.
_KEPT = 4

#: Minimum side of pictures for SSIM, pixels.
_LEAST_SIDE = 11


class Drawer:
    """Draws one scene; caches intermediate results and the last pictures.

    Parameters
    ----------
    scene : Opened
    """

    def __init__(self, scene: Opened) -> None:
        self._scene = scene
        self._pictures: list[tuple[tuple, Look, NDArray[np.float32]]] = []
        self._all = _PLAIN, scene.gaussians
        self._some = _PLAIN, 1, scene.gaussians

    def exact(
        self, pose: Pose, width: int, height: int, look: Look = _PLAIN
    ) -> NDArray[np.float32]:
        """The picture ``(H, W, 3)`` by the renderer that `gs_codec.compare` uses."""

        def draw() -> NDArray[np.float32]:
            return self.render(pose.camera(width, height), look).colour

        return self._known((pose, width, height, 0), look, draw)

    def draft(
        self, pose: Pose, width: int, height: int, look: Look = _PLAIN, every: int = 1
    ) -> NDArray[np.float32]:
        """The picture ``(H, W, 3)``, float32, by the faster rasteriser that refinement uses.

        It draws one of `every` Gaussians, enlarged to compensate.
        """

        def draw() -> NDArray[np.float32]:
            camera = as_camera(pose.camera(width, height))
            frame = make_frame(self._drawn(look, every), camera)
            return frame.draw_float32(look.appearance.background)[0]

        return self._known((pose, width, height, every), look, draw)

    def render(self, camera: dict[str, object], look: Look = _PLAIN) -> Rendering:
        """Render exactly for an entry of ``cameras.json``, without caching the picture."""
        # Measured and shown looks may alternate.
        scene = self._scene.gaussians if look.is_same(_PLAIN) else self._drawn(look)
        return render(scene, as_camera(camera), look.appearance.background)

    def _drawn(self, look: Look, every: int = 1) -> Scene:
        """The Gaussians that a look draws, or one of `every`."""
        known, scene = self._all
        if not known.is_same(look):
            scene = gaussians_drawn(self._scene, look)
            self._all = look, scene
        if every == 1:
            return scene
        known, number, some = self._some
        if number != every or not known.is_same(look):
            some = scene.take(np.arange(0, scene.count, every))
            # Each covers the area of all those it replaces.
            larger = some.log_scale + np.float32(math.log(every) / 2)
            some = replace(some, log_scale=larger)
            self._some = look, every, some
        return some

    def _known(
        self, key: tuple, look: Look, draw: Callable[[], NDArray[np.float32]]
    ) -> NDArray[np.float32]:
        """A picture, from the cache if it is one of the last."""
        for known, of, picture in list(self._pictures):
            if known == key and of.drawn is look.drawn and of.appearance == look.appearance:
                return picture
        picture = draw()
        self._pictures = [*self._pictures[1 - _KEPT :], (key, look, picture)]
        return picture


def drawer_of(views: dict[Opened, Drawer], scene: Opened) -> Drawer:
    """The drawer of a scene, made once."""
    if scene not in views:
        views[scene] = Drawer(scene)
    return views[scene]


def splats(
    views: dict[Opened, Drawer], scene: Opened, pose: Pose, width: int, height: int
) -> NDArray[np.float32]:
    """The unmodified scene ``(H, W, 3)``, whatever the appearance: used for measurements."""
    return drawer_of(views, scene).exact(pose, width, height)


def depth_at(
    views: dict[Opened, Drawer],
    scene: Opened,
    pose: Pose,
    at: tuple[float, float],
    size: tuple[int, int],
    look: Look,
) -> float:
    """Depth at a pixel of a picture of this size; 0 where nothing is drawn."""
    _, _, cx, cy = pose.lens(*size)
    camera = pose.camera(*size) | {
        "width": 1,
        "height": 1,
        "cx": cx - at[0] + 0.5,
        "cy": cy - at[1] + 0.5,
    }
    seen = drawer_of(views, scene).render(camera, look)
    return float(seen.depth[0, 0])


def quality(
    views: dict[Opened, Drawer], scenes: Sequence[Opened], pose: Pose
) -> gs_codec.Quality | None:
    """`gs_codec.compare_images` of two scenes in the camera's frame; None if it is too small."""
    width, height = pose.measured
    if min(width, height) < _LEAST_SIDE:
        return None
    first, second = (splats(views, scene, pose, width, height) for scene in scenes)
    return gs_codec.compare_images(first, second)


def measure(views: dict[Opened, Drawer], scenes: Sequence[Opened], pose: Pose) -> str:
    """`quality` as text."""
    found = quality(views, scenes, pose)
    if found is None:
        width, height = pose.measured
        return f"frame of {width}x{height}: too small"
    return quality_text(found)

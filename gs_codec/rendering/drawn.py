"""Views of a scene, drawn on demand; what `render` returns."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from gs_codec.rendering.camera import Camera
from gs_codec.rendering.cameras import as_camera
from gs_codec.rendering.renderer import Rendering
from gs_codec.report import Progress, step_counter


class RenderedViews:
    """A scene's views, drawn on demand; what `render` returns.

    Iterates over ``(Camera, Rendering)``; a `Rendering` has ``colour (H, W, 3)``,
    ``alpha (H, W)`` and ``depth (H, W)``, float32. Its length is the number of cameras.

    Attributes
    ----------
    cameras : list of Camera
        In the order they are drawn.
    """

    def __init__(
        self,
        cameras: list[Camera],
        draw: Callable[[Camera], Rendering],
        progress: Progress | None = None,
    ) -> None:
        self.cameras = cameras
        self._draw, self._progress = draw, progress

    def __len__(self) -> int:
        return len(self.cameras)

    def __iter__(self) -> Iterator[tuple[Camera, Rendering]]:
        advance = step_counter(self._progress, "views", len(self))
        for camera in self.cameras:
            yield camera, self._draw(camera)
            if advance is not None:
                advance()

    def draw(self, camera: Camera | Mapping[str, Any]) -> Rendering:
        """Draw what any camera sees, including one that is not in `cameras`.

        Parameters
        ----------
        camera : Camera or mapping
            A mapping is an entry of the trainer's ``cameras.json``.

        Returns
        -------
        Rendering

        Raises
        ------
        InvalidInput
            If the mapping is not a camera.
        MissingTool
            If ``cuda`` was asked for but is not available.

        Examples
        --------
        >>> views = gs_codec.render("scene.ply", "cameras.json")
        >>> views.draw(views.cameras[0].resized(32, 24)).alpha.shape
        (24, 32)
        """
        return self._draw(as_camera(camera))

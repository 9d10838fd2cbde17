"""Reference views that guide preparation: cameras, and the images to match."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.cameras.image_files import seek_images
from gs_codec.errors import InvalidInput
from gs_codec.metrics.image_quality import Quality, compare_images, mean_quality
from gs_codec.plan import Device
from gs_codec.rendering import gsplat_backend
from gs_codec.rendering.frame import make_frame
from gs_codec.rendering.renderer import render
from gs_codec.report import NOMINAL_ERROR, Progress, step_counter
from gs_codec.runtime.mapped import other_files
from gs_codec.runtime.threads import run_all
from gs_codec.runtime.wording import counted
from gs_codec.scene import Scene
from gs_codec.views.photographs import read_photograph

Item = TypeVar("Item")
Result = TypeVar("Result")

#: Maximum number of pixels of a photograph, and of a view whose width is not set, about 2400 x
#: 1800: the images of all views are in memory, and 64 of a phone would take 9 GB. Trainers use
#: fewer.
MOST_PIXELS = 1 << 22

#: Origin of cameras: given, estimated from the scene, or, if that fails, spread anywhere around it.
Origin = Literal["given", "estimated", "anywhere"]


@dataclass(frozen=True)
class ReferenceViews:
    """Cameras and their images ``(H, W, 3)`` float32, 0-1 or brighter.

    Without images, those of `source` are rendered whenever they are needed.

    `photographs` states whether the images are photographs, or renders of the scene to be prepared.
    `source` is that scene, if known; `origin` is the origin of the cameras.
    """

    cameras: tuple[Camera, ...]
    images: tuple[NDArray[np.float32], ...]
    photographs: bool
    background: tuple[float, float, float]
    source: Scene | None = None
    origin: Origin = "given"

    def first(self, number: int) -> ReferenceViews:
        """The first views, at most `number`."""
        if number >= len(self.cameras):
            return self
        return replace(self, cameras=self.cameras[:number], images=self.images[:number])

    def evenly(self, number: int) -> ReferenceViews:
        """At most `number` of the views, evenly spaced."""
        cameras, images = evenly(self.cameras, number), evenly(self.images, number)
        return replace(self, cameras=tuple(cameras), images=tuple(images))

    def quality(
        self, scene: Scene, progress: Progress | None = None, lpips: str | None = None
    ) -> Quality:
        """Mean quality of a scene's images against these; `lpips` are weights."""
        return mean_quality(self._of_each(scene, partial(compare_images, lpips=lpips), progress))

    def error(self, scene: Scene, progress: Progress | None = None) -> float:
        """Mean squared error of a scene's images, averaged over the views."""
        return float(np.mean(self.errors(scene, progress)))

    def errors(self, scene: Scene, progress: Progress | None = None) -> NDArray[np.float64]:
        """Mean squared error of a scene's image in each view."""
        if scene is self.source:
            return np.zeros(len(self.cameras))

        def error(colour: NDArray[np.float32], image: NDArray[np.float32]) -> float:
            return float(np.mean(np.square(colour - image, dtype=np.float64)))

        return np.array(self._of_each(scene, error, progress))

    def _of_each(
        self,
        scene: Scene,
        measure: Callable[[NDArray, NDArray], Result],
        progress: Progress | None,
    ) -> list[Result]:
        """Compare each camera's render of a scene with its reference image."""

        def run(i: int) -> Result:
            drawn = render(scene, self.cameras[i], self.background, device="cpu")
            return measure(drawn.colour, self._image(i))

        number = len(self.cameras)
        return run_all(run, range(number), advance=step_counter(progress, "measure", number))

    def drawn(self, progress: Progress | None = None) -> ReferenceViews:
        """The same with images of `source`."""
        assert self.source is not None
        images = draw_reference_views(self.source, self.cameras, self.background, progress).images
        return replace(self, images=images)

    def _image(self, view: int) -> NDArray[np.float32]:
        if self.images:
            return self.images[view]
        assert self.source is not None
        return render(self.source, self.cameras[view], self.background, device="cpu").colour

    def drop(
        self, errors: float | NDArray[np.float64], before: float | NDArray[np.float64]
    ) -> float:
        """Mean PSNR loss of the views in dB, from mean squared errors `before` to `errors`.

        If the images are the scene's own renders, the scene is assumed to have 30 dB against
        photographs, and both errors are assumed to add up.
        """
        own = 0.0 if self.photographs else NOMINAL_ERROR
        return 10 * float(np.mean(np.log10((own + errors) / (own + before))))

    def error_for(self, drop: float, before: float) -> float:
        """The mean squared error that loses `drop` dB in each view; inverse of `drop`."""
        own = 0.0 if self.photographs else NOMINAL_ERROR
        return (own + before) * 10 ** (drop / 10) - own


class ViewSplit(NamedTuple):
    """Views that guide preparation, and views that measure quality.

    Attributes
    ----------
    renders : ReferenceViews
        Renders of the input from the cameras that guide the steps.
    photographs : ReferenceViews or None
        Photographs from guiding cameras, if there are any.
    held_out : ReferenceViews
        The views that measure quality.
    targets : ReferenceViews or None
        Images that refinement fits, if it runs: photographs, or renders from cameras without one.
    """

    renders: ReferenceViews
    photographs: ReferenceViews | None
    held_out: ReferenceViews
    targets: ReferenceViews | None = None

    @property
    def references(self) -> ReferenceViews:
        """The images to match: photographs if there are any, otherwise renders."""
        return self.photographs or self.renders


@other_files()
def photographed(cameras: Sequence[Camera], folder: str | Path) -> list[tuple[Camera, Path]]:
    """The cameras whose image is in a folder, and the images' paths.

    Raises InvalidInput if no camera has an image, or as in `seek_images`.
    """
    paths = seek_images(folder, cameras)
    found = [(camera, path) for camera, path in zip(cameras, paths, strict=True) if path]
    if not found:
        raise InvalidInput(f"{folder}: no image of {counted(len(cameras), 'camera')}")
    return found


def draw_reference_views(
    scene: Scene,
    cameras: Sequence[Camera],
    background: tuple[float, float, float],
    progress: Progress | None = None,
) -> ReferenceViews:
    """Render a scene's own views."""

    def draw(camera: Camera) -> NDArray[np.float32]:
        return render(scene, camera, background, device="cpu").colour

    images = run_all(draw, cameras, advance=step_counter(progress, "draw", len(cameras)))
    return ReferenceViews(tuple(cameras), tuple(images), False, background, scene)


def draw_targets(
    scene: Scene,
    cameras: Sequence[Camera],
    background: tuple[float, float, float],
    device: Device,
    progress: Progress | None = None,
) -> ReferenceViews:
    """Render a scene's own views as targets, in float32, on the device that fits them.

    Raises MissingTool if the device is requested but not available.
    """
    on_device = gsplat_backend.is_chosen(device)
    values = gsplat_backend.upload(scene) if on_device else None

    def draw(camera: Camera) -> NDArray[np.float32]:
        if values is not None:
            return gsplat_backend.draw(values, camera, background, scene.antialiased)[0]
        return make_frame(scene, camera).draw_float32(background)[0]

    advance, threads = step_counter(progress, "draw", len(cameras)), 1 if on_device else None
    images = run_all(draw, cameras, threads, advance)
    return ReferenceViews(tuple(cameras), tuple(images), False, background, scene)


@other_files()
def read_photographs(
    found: Sequence[tuple[Camera, Path]], background: tuple[float, float, float]
) -> ReferenceViews:
    """Read and undistort photographs, reduced to `MOST_PIXELS`, and resize the cameras to them.

    Raises InvalidInput if one is damaged, or its shape differs from its camera's. Raises
    MissingTool if one must be undistorted, and OpenCV is not installed.
    """
    read = run_all(lambda item: _reduced(*read_photograph(*item, background)), found)
    cameras, images = zip(*read, strict=True)
    return ReferenceViews(cameras, images, True, background)


def _reduced(camera: Camera, image: NDArray[np.float32]) -> tuple[Camera, NDArray[np.float32]]:
    """A photograph with at most `MOST_PIXELS`, each the mean of a square of its pixels."""
    by = math.ceil(math.sqrt(camera.width * camera.height / MOST_PIXELS))
    if by < 2:
        return camera, image
    width, height = camera.width // by, camera.height // by
    squares = image[: by * height, : by * width].reshape(height, by, width, by, 3)
    lens = {name: getattr(camera, name) / by for name in ("fx", "fy", "cx", "cy")}
    return replace(camera, width=width, height=height, **lens), squares.mean(axis=(1, 3))


def evenly(items: Sequence[Item], count: int) -> list[Item]:
    """Choose `count` of the items, evenly spaced in their order; all if there are fewer."""
    if len(items) <= count:
        return list(items)
    return [items[i] for i in np.linspace(0, len(items) - 1, count).round().astype(int)]

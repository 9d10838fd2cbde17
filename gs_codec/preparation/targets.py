"""The views a scene is prepared by, and what they should look like."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.metrics.images import Quality, compare_images, mean_quality
from gs_codec.metrics.views import fitted
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.images import find_image, read_image
from gs_codec.rendering.renderer import render
from gs_codec.scene import Scene
from gs_codec.workers import run_all

#: MSE that a scene without photographs is taken to have against them: 30 dB.
_NOMINAL_ERROR = 1e-3


@dataclass(frozen=True)
class Targets:
    """Cameras, and for each its image ``(H, W, 3)`` float32, 0-1 or brighter.

    `photographs` tells whether the images are such, or renders of the scene to be prepared.
    """

    cameras: tuple[Camera, ...]
    images: tuple[NDArray[np.float32], ...]
    photographs: bool
    background: tuple[float, float, float]

    def quality(self, scene: Scene) -> Quality:
        """Mean over the views of PSNR and SSIM of a scene's images against them."""

        def compare(i: int) -> Quality:
            drawn = render(scene, self.cameras[i], self.background, threads=1, device="cpu")
            return compare_images(drawn.colour, self.images[i])

        return mean_quality(run_all(compare, range(len(self.cameras))))

    def error(self, scene: Scene) -> float:
        """Mean squared error of a scene's images, mean over the views."""

        def measure(i: int) -> float:
            drawn = render(scene, self.cameras[i], self.background, threads=1, device="cpu")
            return float(np.mean((drawn.colour - self.images[i]) ** 2, dtype=np.float64))

        return float(np.mean(run_all(measure, range(len(self.cameras)))))

    def drop(self, error: float, before: float) -> float:
        """Loss of PSNR, dB, from a mean squared error `before` to `error`.

        Where targets are the scene's own renders, it is taken to have 30 dB against photographs,
        and errors of both kinds to add up.
        """
        own = 0.0 if self.photographs else _NOMINAL_ERROR
        return 10 * float(np.log10((own + error) / (own + before)))


def photographed(cameras: Sequence[Camera], folder: str | Path) -> tuple[list[Camera], list[Path]]:
    """The cameras whose image is in a folder, and the images' paths.

    Raises
    ------
    InvalidInput
        If none is.
    """
    found = []
    for camera in cameras:
        try:
            found.append((camera, find_image(folder, camera.name)))
        except InvalidInput:
            if not os.path.isdir(folder):
                raise
    if not found:
        raise InvalidInput(f"{folder}: no image of the {len(cameras)} cameras")
    return [camera for camera, _ in found], [path for _, path in found]


def make_targets(
    scene: Scene,
    cameras: Sequence[Camera],
    photographs: str | Path | None,
    background: tuple[float, float, float],
    advance: Callable[[], None] | None = None,
) -> Targets:
    """Targets of the photographs in a folder, of the cameras that have one, or of renders.

    Raises
    ------
    InvalidInput
        If no camera has a photograph, or one is broken or of another shape.
    """
    if photographs is None:
        images = run_all(
            lambda camera: render(scene, camera, background, threads=1, device="cpu").colour,
            cameras,
            advance=advance,
        )
        return Targets(tuple(cameras), tuple(images), False, background)
    cameras, paths = photographed(cameras, photographs)
    images = run_all(read_image, paths, advance=advance)
    sized = [fitted(c, image, p) for c, image, p in zip(cameras, images, paths, strict=True)]
    return Targets(tuple(sized), tuple(images), True, background)


def evenly(cameras: Sequence[Camera], count: int) -> list[Camera]:
    """`count` of the cameras, evenly spaced in their order; all if there are no more."""
    if len(cameras) <= count:
        return list(cameras)
    return [cameras[i] for i in np.linspace(0, len(cameras) - 1, count).round().astype(int)]

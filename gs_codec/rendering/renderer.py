"""Images of a scene, rendered on the CPU or with gsplat, in memory or to files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.cameras.image_files import output_names, write_png
from gs_codec.cameras.inria import as_camera
from gs_codec.rendering import gsplat_backend
from gs_codec.rendering.frame import make_frame
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.arrays import finite
from gs_codec.runtime.atomic import make_folder
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene


@dataclass(frozen=True)
class Accumulations:
    """Sums over the pixels of each Gaussian, each of shape (N,), in the scene's order.

    Attributes
    ----------
    weight : ndarray, float64
        Sum of alpha T, the Gaussian's weight in the pixel's colour.
    squared_weight : ndarray, float64
        Sum of (alpha T)^2.
    transmittance : ndarray, float64
        Sum of T, the transmittance in front of the Gaussian.
    pixels : ndarray, int64
        Number of pixels.

    Examples
    --------
    >>> views = gs_codec.render("scene.ply", "cameras.json", width=48, accumulate=True)
    >>> weight = sum(rendering.accumulations.weight for _, rendering in views)
    >>> weight.shape, bool((weight == 0).any())  # the second: whether some are never seen
    ((2000,), True)
    """

    weight: NDArray[np.float64]
    squared_weight: NDArray[np.float64]
    transmittance: NDArray[np.float64]
    pixels: NDArray[np.int64]


@dataclass(frozen=True)
class Rendering:
    """Colour, alpha and depth images of a camera.

    Attributes
    ----------
    colour : ndarray, shape (H, W, 3), float32
        RGB, from 0 up; 1 is white, brighter is possible.
    alpha : ndarray, shape (H, W), float32
        Total opacity, 0-1.
    depth : ndarray, shape (H, W), float32
        Mean distance along the optical axis, weighted by alpha T, scene units; 0 where
        nothing is drawn.
    accumulations : Accumulations or None
        Sums for each Gaussian, if `accumulate` was set.
    pairs : int
        Number of splat-tile pairs; rendering time grows with it.

    Examples
    --------
    >>> for camera, rendering in gs_codec.render("scene.ply", "cameras.json", width=48):
    ...     print(rendering.alpha.shape, rendering.depth.dtype, bool(rendering.alpha.max() < 1))
    (32, 48) float32 True
    (32, 48) float32 True
    """

    colour: NDArray[np.float32]
    alpha: NDArray[np.float32]
    depth: NDArray[np.float32]
    accumulations: Accumulations | None
    pairs: int


def render(
    scene: Scene,
    camera: Camera,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    antialiased: bool | None = None,
    accumulate: bool = False,
    device: Literal["auto", "cpu", "cuda"] = "auto",
) -> Rendering:
    """Render a scene like the 3DGS rasteriser (Kerbl et al. 2023, Section 6).

    Gaussians with an attribute or a projection that is not finite are not drawn. On the CPU the
    result does not depend on the number of threads. Raises InvalidInput if the background is not
    three finite numbers. Raises MissingTool if ``cuda`` is requested but not available.

    Parameters
    ----------
    scene : Scene
    camera : Camera
    background : sequence of three float
        RGB behind everything.
    antialiased : bool, optional
        Lower the opacity of splats that the low-pass widens (Yu et al. 2023, Mip-Splatting); by
        default as stated in the scene.
    accumulate : bool
        Keep sums for each Gaussian; always renders on the CPU.
    device : {"auto", "cpu", "cuda"}
        ``cuda`` renders with gsplat; its images agree with the CPU's to 40 dB or better. ``auto``
        uses it if it is installed and torch sees a device.
    """
    background = finite("background", background, 3).tolist()
    if antialiased is None:
        antialiased = scene.antialiased
    if gsplat_backend.is_chosen(device) and not accumulate:
        values = gsplat_backend.upload(scene)
        colour, alpha, depth, pairs = gsplat_backend.draw(values, camera, background, antialiased)
        return Rendering(colour, alpha, depth, None, pairs)
    frame = make_frame(scene, camera, antialiased)
    sums = np.zeros((frame.pairs if accumulate else 0, 4))
    images = frame.draw(background, np.float32, sums)
    accumulations = None
    if accumulate:
        totals = np.zeros((scene.count, sums.shape[1]))
        totals[frame.splats.gaussians] = frame.sum_pairs(sums)
        weight, squared, transmittance, pixels = totals.T
        accumulations = Accumulations(weight, squared, transmittance, pixels.astype(np.int64))
    return Rendering(*images, accumulations, frame.pairs)


class RenderedViews:
    """Views of a scene, rendered on demand; the result of `render`.

    Iterates over ``(Camera, Rendering)``; a `Rendering` has ``colour (H, W, 3)``,
    ``alpha (H, W)`` and ``depth (H, W)``, float32. Its length is the number of cameras.

    Attributes
    ----------
    cameras : list of Camera
        In rendering order.

    Examples
    --------
    >>> views = gs_codec.render("scene.ply", "cameras.json", width=48)
    >>> len(views), [camera.name for camera in views.cameras]
    (2, ['00000', '00001'])
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
            advance()

    def draw(self, camera: Camera | Mapping[str, Any]) -> Rendering:
        """Render the view of any camera, including one that is not in `cameras`.

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
            If ``cuda`` was requested but is not available.

        Examples
        --------
        >>> views = gs_codec.render("scene.ply", "cameras.json")
        >>> views.draw(views.cameras[0].resized(32, 24)).alpha.shape
        (24, 32)
        """
        return self._draw(as_camera(camera))


def write_views(
    scene: Scene,
    cameras: Sequence[Camera],
    folder: str | Path,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    antialiased: bool | None = None,
    device: Literal["auto", "cpu", "cuda"] = "auto",
    progress: Progress | None = None,
) -> list[Path]:
    """Render each camera's view to a file in `folder`, named by `output_names`; see `render`.

    Raises InvalidInput if an image cannot be written.
    """
    paths = [make_folder(folder) / f"{name}.png" for name in output_names(cameras)]
    advance = step_counter(progress, "views", len(cameras))

    def write(item: tuple[Camera, Path]) -> None:
        camera, path = item
        drawn = render(scene, camera, background, antialiased, device=device)
        write_png(path, drawn.colour)

    run_all(write, zip(cameras, paths, strict=True), advance=advance)
    return paths

"""Compare rendered views of two versions of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gs_codec.cameras.camera import Camera
from gs_codec.cameras.image_files import (
    find_images,
    output_names,
    read_image,
    warn_of_masks,
    write_png,
)
from gs_codec.metrics.comparison import Comparison
from gs_codec.metrics.image_quality import View, compare_images, load_lpips
from gs_codec.rendering.renderer import render
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.atomic import make_folder
from gs_codec.runtime.mapped import located
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene
from gs_codec.views.photographs import read_photograph

#: Factor by which difference images are amplified.
DIFFERENCE_GAIN = 10


def compare_views(
    first: Scene,
    second: Scene,
    cameras: Sequence[Camera],
    truth: str | Path | None = None,
    images: str | Path | None = None,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    device: Literal["auto", "cpu", "cuda"] = "auto",
    progress: Progress | None = None,
    lpips: str | Path | None = None,
    masks: str | Path | None = None,
) -> Comparison:
    """Render both scenes for every camera and compare the images.

    Raises InvalidInput if a ground-truth image is missing, is shared by two cameras or has another
    shape, or an image cannot be written. Raises InvalidInput or MissingTool, as in `compare_images`
    and `read_photograph`.

    Parameters
    ----------
    first, second : Scene
        Their numbers of Gaussians may differ.
    cameras : sequence of Camera
    truth : path, optional
        Folder of ground-truth images, found by the cameras' names; views have the size of the
        undistorted images.
    images : path, optional
        Folder for ``NAME_a.png``, ``NAME_b.png``, and ``NAME_difference.png``, the absolute
        difference amplified by `DIFFERENCE_GAIN`; names are those of `output_names`.
    background : sequence of three float
        RGB behind the scenes, and behind transparent parts of ground-truth images.
    device : {"auto", "cpu", "cuda"}
        As in `render`.
    progress : callable, optional
    lpips : path, optional
        As in `compare_images`.
    masks : path, optional
        Folder of images, found by the cameras' names, of the size of the views: only pixels that
        are brighter there than 50 % are compared.
    """
    backbone = None if lpips is None else load_lpips(lpips).backbone
    names = output_names(cameras) if images else []
    paths = find_images(truth, cameras) if truth else []
    if truth and not masks:
        warn_of_masks(truth)
    found = find_images(masks, cameras) if masks else []
    folder = make_folder(images) if images else None
    advance = step_counter(progress, "views", len(cameras))

    def compare_view(i: int) -> View:
        camera = cameras[i]
        target = None
        if truth:
            camera, target = read_photograph(camera, paths[i], background)
        a, b = (
            render(scene, camera, background, device=device).colour for scene in (first, second)
        )
        if folder is not None:
            _write_images(folder / names[i], a, b)
        mask = read_image(found[i]).mean(axis=2) > 0.5 if masks else None
        with located(found[i]) if masks else nullcontext():
            pairs = [(a, b), *((image, target) for image in (a, b) if target is not None)]
            return View(camera.name, *(compare_images(*pair, lpips, mask) for pair in pairs))

    views = run_all(compare_view, range(len(cameras)), advance=advance)
    return Comparison((first.count, second.count), views=tuple(views), backbone=backbone)


def _write_images(stem: Path, a: NDArray, b: NDArray) -> None:
    difference = DIFFERENCE_GAIN * np.abs(np.clip(a, 0, 1) - np.clip(b, 0, 1))
    for suffix, image in (("a", a), ("b", b), ("difference", difference)):
        write_png(stem.with_name(f"{stem.name}_{suffix}.png"), image)

"""Render views of a scene to image files, one per camera."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from gs_codec.cameras.camera import Camera
from gs_codec.cameras.image_files import output_names, write_png
from gs_codec.rendering.renderer import render
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.atomic import make_folder
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene


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

    Raises
    ------
    InvalidInput
        If an image cannot be written.
    """
    paths = [make_folder(folder) / f"{name}.png" for name in output_names(cameras)]
    advance = step_counter(progress, "views", len(cameras))

    def write(item: tuple[Camera, Path]) -> None:
        camera, path = item
        drawn = render(scene, camera, background, antialiased, device=device)
        write_png(path, drawn.colour)

    run_all(write, zip(cameras, paths, strict=True), advance=advance)
    return paths

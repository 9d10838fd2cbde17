"""Images of a scene, one file for each camera."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from gs_codec.io.atomic import make_folder
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.images import output_names, write_png
from gs_codec.rendering.renderer import render
from gs_codec.report import Progress, step_counter
from gs_codec.scene import Scene
from gs_codec.workers import run_all


def write_views(
    scene: Scene,
    cameras: Sequence[Camera],
    folder: str | Path,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    antialiased: bool | None = None,
    device: Literal["auto", "cpu", "cuda"] = "auto",
    progress: Progress | None = None,
) -> list[Path]:
    """Draw what each camera sees to ``NAME.png`` in `folder`; see `render`.

    Raises
    ------
    InvalidInput
        If two cameras' images would have one name, or an image cannot be written.
    """
    paths = [make_folder(folder) / f"{name}.png" for name in output_names(cameras)]
    advance = step_counter(progress, "views", len(cameras))

    def write(item: tuple[Camera, Path]) -> None:
        camera, path = item
        drawn = render(scene, camera, background, antialiased, device=device)
        write_png(path, drawn.colour)

    run_all(write, zip(cameras, paths, strict=True), advance=advance)
    return paths

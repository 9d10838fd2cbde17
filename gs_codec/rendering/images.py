"""Images from and to files; views of a scene, one file for each camera."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePath
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.formats.images import read_pixels, read_size
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.lens import MAX_SIDE
from gs_codec.rendering.renderer import render
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.atomic import atomic_writer, make_folder
from gs_codec.runtime.mapped import located
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene

_FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP")
_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")

#: Most pixels of a photograph.
_MOST = 1 << 27


def read_image(path: str | Path) -> NDArray[np.float32]:
    """Read an image as ``(H, W, 3)`` float32, 0-1; transparent parts are black.

    Raises
    ------
    InvalidInput
        If it is missing, broken, or larger than a camera can be.
    """
    with located(path):
        pixels = read_pixels(path, _FORMATS, _check_size)
    image = pixels[..., :3].astype(np.float32)
    image /= 255
    if (pixels[..., 3] < 255).any():
        image *= pixels[..., 3:].astype(np.float32) / np.float32(255)
    return image


def image_size(path: str | Path) -> tuple[int, int]:
    """Width and height of an image, pixels, from its header.

    Raises
    ------
    InvalidInput
        As for `read_image`, but what follows the header is not read.
    """
    with located(path):
        return read_size(path, _FORMATS, _check_size)


def _check_size(width: int, height: int) -> None:
    if max(width, height) > MAX_SIDE or width * height > _MOST:
        raise InvalidInput(
            f"{width}x{height} pixels, expected at most {MAX_SIDE} each way and {_MOST} in all"
        )


def write_png(path: str | Path, image: NDArray) -> None:
    """Write ``(H, W, 3)``, clipped to 0-1, at 8 bits; the file appears whole or not at all.

    Raises
    ------
    InvalidInput
        If it cannot be written.
    """
    from PIL import Image

    levels = np.round(255 * np.clip(image, 0, 1)).astype(np.uint8)
    with atomic_writer(path) as file:
        Image.fromarray(levels).save(file, "PNG")


def output_names(cameras: Sequence[Camera]) -> list[str]:
    """A file name, without suffix, for each camera's image.

    Path separators and characters that are not printable become underscores.

    Raises
    ------
    InvalidInput
        If two names would be the same.
    """
    names: dict[str, str] = {}
    for camera in cameras:
        letters = (c if c.isprintable() and c not in "/\\" else "_" for c in _stem(camera.name))
        stem = "".join(letters).lstrip(".") or "_"
        if stem in names:
            raise InvalidInput(
                f"images '{names[stem]}' and '{camera.name}' would both be written as '{stem}.png'"
            )
        names[stem] = camera.name
    return list(names)


def find_image(folder: str | Path, name: str) -> Path:
    """Find a camera's image in a folder: its name, with its own suffix or another.

    Raises
    ------
    InvalidInput
        If there is none, or the name leads out of the folder.
    """
    path = seek_image(folder, name)
    if path is None:
        raise InvalidInput(f"{folder}: no image '{_stem(name)}' ({', '.join(_SUFFIXES)})")
    return path


def seek_image(folder: str | Path, name: str) -> Path | None:
    """As `find_image`, but return None if the folder exists and has no such image."""
    if PurePath(name).anchor or ".." in re.split(r"[/\\]", name):
        raise InvalidInput(f"{folder}: image '{name}', expected a name that stays in the folder")
    for inside in _names_inside(folder, name):
        stem = _stem(inside)
        others = [f"{stem}{suffix}" for suffix in (*_SUFFIXES, *map(str.upper, _SUFFIXES))]
        for path in [Path(folder) / other for other in (inside, *others)]:
            if os.path.isfile(path):
                return path
    if not os.path.isdir(folder):
        raise InvalidInput(f"{folder}: no such folder, expected images")
    return None


def _names_inside(folder: str | Path, name: str) -> Iterator[str]:
    """A name, and what is left of it within `folder` if its first folder is that.

    Names in transforms.json begin with ``images``, where the photographs are, or may be smaller in
    ``images_2``.
    """
    yield name
    first, *others = PurePath(name).parts or ("",)
    rest, own = PurePath(*others), os.path.basename(os.path.abspath(folder))
    if others and not rest.anchor and re.fullmatch(rf"{re.escape(first)}(_\d+)?", own):
        yield str(rest)


def _stem(name: str) -> str:
    stem, suffix = os.path.splitext(name)
    return stem if suffix.lower() in _SUFFIXES else name


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

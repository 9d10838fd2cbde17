"""Images from and to files."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput, one_line
from gs_codec.io.atomic import atomic_writer
from gs_codec.rendering.camera import MAX_SIDE, Camera

_FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP")
_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")


def read_image(path: str | Path) -> NDArray[np.float32]:
    """Read an image as ``(H, W, 3)`` float32, 0-1; transparent parts are black.

    Raises
    ------
    InvalidInput
        If it is missing, broken, or larger than a camera can be.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            # What is odd in a file, but does not keep it from being read, is no matter of ours.
            warnings.simplefilter("ignore")
            with Image.open(path, formats=_FORMATS) as image:
                if max(image.size) > MAX_SIDE:
                    raise InvalidInput(f"{path}: {image.size} pixels, expected at most {MAX_SIDE}")
                pixels = np.asarray(image.convert("RGBA"), np.float32) / np.float32(255)
    except UnidentifiedImageError:
        raise InvalidInput(f"{path}: not an image") from None
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise InvalidInput(f"{path}: {one_line(error)}") from error
    return pixels[..., :3] * pixels[..., 3:]


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
    """A file name, without suffix, for each camera's image; folders become part of it.

    Raises
    ------
    InvalidInput
        If two would be the same.
    """
    names: dict[str, str] = {}
    for camera in cameras:
        stem = _stem(camera.name).replace("/", "_").replace("\\", "_").lstrip(".") or "_"
        if stem in names:
            raise InvalidInput(
                f"images '{names[stem]}' and '{camera.name}' would both be written as '{stem}.png'"
            )
        names[stem] = camera.name
    return list(names)


def find_image(folder: str | Path, name: str) -> Path:
    """The image a camera was made from: its name, with the suffix it has or another.

    Raises
    ------
    InvalidInput
        If there is none.
    """
    named = Path(folder) / name
    stem = _stem(name)
    others = [Path(folder) / f"{stem}{suffix}" for suffix in _SUFFIXES]
    others += [Path(folder) / f"{stem}{suffix.upper()}" for suffix in _SUFFIXES]
    for path in [named, *others]:
        if os.path.isfile(path):
            return path
    if not os.path.isdir(folder):
        raise InvalidInput(f"{folder}: no such folder, expected images")
    raise InvalidInput(f"{folder}: no image '{stem}' ({', '.join(_SUFFIXES)})")


def _stem(name: str) -> str:
    stem, suffix = os.path.splitext(name)
    return stem if suffix.lower() in _SUFFIXES else name

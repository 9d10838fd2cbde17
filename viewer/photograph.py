"""Photographs of the cameras, by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import gs_codec

_SUFFIXES = ("", ".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG")


def find_photograph(folder: Path, name: str) -> NDArray[np.uint8]:
    """The image ``(H, W, 3)`` of a camera.

    Raises
    ------
    gs_codec.GsCodecError
        If there is none, or it is broken.
    """
    stem = Path(name).name
    for candidate in (stem, Path(stem).stem):
        for suffix in _SUFFIXES:
            path = Path(folder) / (candidate + suffix)
            if path.is_file():
                try:
                    with Image.open(path) as image:
                        return np.asarray(image.convert("RGB"))
                except (OSError, Image.DecompressionBombError) as error:
                    raise gs_codec.GsCodecError(f"{path}: {error}") from error
    raise gs_codec.GsCodecError(f"{folder}: no image of camera '{name}'")

"""Photographs of the cameras, by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gs_codec.rendering.images import find_image, read_image


def find_photograph(folder: Path, name: str) -> NDArray[np.uint8]:
    """The image ``(H, W, 3)`` of a camera.

    Raises
    ------
    gs_codec.GsCodecError
        If there is none, or it is broken.
    """
    return np.round(255 * read_image(find_image(folder, name))).astype(np.uint8)

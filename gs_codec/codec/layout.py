"""Where an encoder's scene is, if it is larger than memory."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from gs_codec.scene import Scene
from gs_codec.storage import Disk, current

Index = TypeVar("Index", bound=np.integer)


def in_stream_order(scene: Scene, order: NDArray[Index]) -> tuple[Scene, NDArray[Index]]:
    """The scene, and the index in it of each Gaussian of the stream.

    A scene on disk is sorted first: otherwise each block would read all over the file.
    """
    storage = current()
    if not isinstance(storage, Disk):
        return scene, order
    return scene.take(order), storage.keep(np.arange(len(order), dtype=order.dtype))

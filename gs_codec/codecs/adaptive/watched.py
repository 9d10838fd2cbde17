"""Decoded values of some Gaussians, kept while a scene is encoded.

So what views of a scene lose is measured without decoding it, which would take a third of the time
of encoding. A decoder returns the same values.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.scene import GROUPS, Scene


class Watched:
    """Some Gaussians of a scene.

    Parameters
    ----------
    scene : Scene
    index : ndarray, shape (M,), int64
        Their indices in it.
    """

    def __init__(self, scene: Scene, index: NDArray[np.int64]) -> None:
        self._source, self.index = scene.take(index), index
        self._places, self._slots = np.empty((2, 0), np.int64)
        self._planes: dict[str, Any] = {g: np.empty_like(getattr(self._source, g)) for g in GROUPS}

    def settle(self, order: NDArray[np.integer]) -> None:
        """Find them in the stream, which has the Gaussians ``order (N,)`` of the scene."""
        rank = np.empty(len(order), np.int64)
        rank[order] = np.arange(len(order))
        places = rank[self.index]
        self._slots = np.argsort(places)
        self._places = places[self._slots]

    def within(self, start: int, stop: int) -> NDArray[np.int64]:
        """Those in a range of the stream, counted from its start."""
        first, end = np.searchsorted(self._places, [start, stop])
        return self._places[first:end] - start

    def keep(self, start: int, stop: int, **planes: NDArray[np.float32]) -> None:
        """Keep decoded attribute groups ``(C, m)`` of those `within` a range."""
        first, end = np.searchsorted(self._places, [start, stop])
        for group, values in planes.items():
            self._planes[group][:, self._slots[first:end]] = values

    def decoded(self) -> Scene:
        """Their decoded values, once all blocks are coded."""
        return replace(self._source, **self._planes)

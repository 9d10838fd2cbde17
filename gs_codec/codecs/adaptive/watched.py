"""Decoded values of some Gaussians, kept while a scene is encoded.

They allow measuring the loss in rendered views without decoding the scene, which would take a third
of the encoding time. They equal the values of a decoder.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs_codec.scene import GROUPS, Scene


class Watched:
    """Some Gaussians of a scene, and their decoded values.

    Parameters
    ----------
    scene : Scene
    index : ndarray, shape (M,), int64
        Their indices in the scene; in stream order after `settle`.
    """

    def __init__(self, scene: Scene, index: NDArray[np.int64]) -> None:
        self._head, self.index = replace(scene.between(0, 0), extra={}), index
        self._places = self._by_index = np.empty(0, np.int64)
        self._planes: dict[str, Any] = {
            group: np.empty((len(getattr(scene, group)), len(index)), np.float32)
            for group in GROUPS
        }

    @classmethod
    def shown(cls, scene: Scene, shown: Sequence[NDArray[np.int64]]) -> Watched:
        """Watch all Gaussians that appear in any crop, each crop given by indices in the scene."""
        wanted = np.zeros(scene.count, np.bool_)
        for own in shown:
            wanted[own] = True
        return cls(scene, np.flatnonzero(wanted))

    def settle(self, order: NDArray[np.integer]) -> None:
        """Locate them in the stream; ``order (N,)`` is the scene index of each of its Gaussians."""
        wanted = np.zeros(len(order), np.bool_)
        wanted[self.index] = True
        self._places = np.flatnonzero(wanted[order])
        self.index = order[self._places].astype(np.int64)
        self._by_index = np.argsort(self.index)

    def within(self, start: int, stop: int) -> NDArray[np.int64]:
        """Their positions within a range of the stream, counted from `start`."""
        first, end = np.searchsorted(self._places, [start, stop])
        return self._places[first:end] - start

    def keep(self, start: int, stop: int, **planes: NDArray[np.float32]) -> None:
        """Store decoded attribute groups ``(C, m)`` of the Gaussians `within` a range."""
        first, end = np.searchsorted(self._places, [start, stop])
        for group, values in planes.items():
            self._planes[group][:, first:end] = values

    def decoded(self) -> Scene:
        """Return their decoded values in stream order, once all blocks are coded."""
        return replace(self._head, **self._planes)

    def find(self, members: NDArray[np.int64]) -> NDArray[np.int64]:
        """Ascending positions in `decoded` of the Gaussians with these indices in the scene."""
        return np.sort(self._by_index[np.searchsorted(self.index, members, sorter=self._by_index)])

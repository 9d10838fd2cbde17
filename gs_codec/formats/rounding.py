"""Round PLY properties to float32, and measure by how much centres move."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from gs_codec.formats.coordinates import CONVENTION, turn_shift
from gs_codec.formats.extra_properties import listed
from gs_codec.runtime.wording import counted
from gs_codec.scene import Shift

log = logging.getLogger(__name__)

#: Errors of centres below this share of a Gaussian's longest axis need no shift.
_SEEN = 0.01


class Rounding:
    """Fills float32 planes tile by tile, from several threads; logs what was rounded.

    Parameters
    ----------
    names : sequence of str
        Names of the planes; centres come first.
    shift : tuple of three float, optional
        Added to float64 centres before rounding.
    system : str
        Coordinate system of the file.
    """

    def __init__(self, names: Sequence[str], shift: Shift | None, system: str = CONVENTION) -> None:
        self._system = system
        self._names, self._shift = names, shift or (0.0, 0.0, 0.0)
        self._scales = [k for k, name in enumerate(names) if name.startswith("scale_")]
        self._rounded: Counter[str] = Counter()
        self._low, self._high = np.full(3, np.inf), np.full(3, -np.inf)
        self._error = self._share = 0.0
        self._lock = Lock()

    def fill(self, planes: Sequence[NDArray[np.float32]], tile: NDArray) -> None:
        """Fill the part of the planes for a tile of rows."""
        for k, (plane, name) in enumerate(zip(planes, self._names, strict=True)):
            with np.errstate(over="ignore", invalid="ignore"):
                plane[:] = self._exact(k, tile)
                if np.can_cast(tile.dtype[name], np.float32):
                    continue
                differs = (plane != self._exact(k, tile)) & ~np.isnan(plane)
            with self._lock:
                self._rounded[name] += int(np.count_nonzero(differs))
        if any(self._rounded[name] for name in self._names[:3]):
            self._measure(planes, tile)

    def _exact(self, k: int, tile: NDArray) -> NDArray:
        column = tile[self._names[k]]
        if k < 3 and self._shift[k] and column.dtype.itemsize == 8:
            return column + self._shift[k]
        return column

    def _measure(self, planes: Sequence[NDArray[np.float32]], tile: NDArray) -> None:
        """Largest errors of centres, and the exact bounding box."""
        with np.errstate(all="ignore"):
            exact = np.stack([self._exact(k, tile) for k in range(3)]).astype(np.float64)
            error = np.abs(np.stack(planes[:3]) - exact).max(axis=0)
            longest = np.max([planes[k] for k in self._scales], axis=0).astype(np.float64)
            share = error / np.exp(longest)
        usable = np.isfinite(share)
        if usable.any():
            with self._lock:
                self._error = max(self._error, float(error[usable].max()))
                self._share = max(self._share, float(share[usable].max()))
                self._low = np.minimum(self._low, exact[:, usable].min(axis=1))
                self._high = np.maximum(self._high, exact[:, usable].max(axis=1))

    def tell(self, path: str | Path) -> None:
        """Log what was rounded: one line on centres, and one on everything else."""
        centres = [name for name in self._names[:3] if self._rounded[name]]
        others = [name for name in self._names[3:] if self._rounded[name]]
        if centres:
            log.warning("%s: %s%s", path, self._line(centres), self._how_far())
        if others:
            log.warning("%s: %s", path, self._line(others))

    def _line(self, names: Sequence[str]) -> str:
        most = max(self._rounded[name] for name in names)
        return f"{listed(names)} rounded to float32 in {counted(most, 'Gaussian')}"

    def _how_far(self) -> str:
        text = f", by up to {self._error:.2g} units, {self._share:.2g} times a Gaussian's size"
        if self._share < _SEEN:
            return text
        middle = np.rint((self._low + self._high) / 2)
        x, y, z = -middle
        shift = turn_shift((x, y, z), self._system, CONVENTION)
        by = ",".join(f"{each:.0f}" for each in shift)
        return f'{text}; shift them first: Action("translate", "{by}")'

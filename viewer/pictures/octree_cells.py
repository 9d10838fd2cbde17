"""The octree layer: occupied cells, coloured by number of Gaussians or by bits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.extent import Cube
from gs_codec.coding.far import find_far
from gs_codec.coding.morton import decode_morton
from viewer.pictures.cubes import Cubes
from viewer.pictures.layers import UNKNOWN, Legend, Points, heat, legend_of
from viewer.pictures.ticks import scale_marks
from viewer.scenes.choice import DEPTHS, OctreeChoice
from viewer.scenes.opened import Opened, thinned

#: Maximum number of cells drawn as cubes; if there are more, their centres are drawn as points.
MOST_CUBES = 100_000

#: Side of the cube of the emptiest cell, relative to the cell; small, so that floaters in front of
#: the scene hide little of it.
_LEAST = 0.3

#: Side of the cube of the fullest cell, relative to the cell.
_MOST = 0.94

#: Quantiles of the Gaussians' bits that map to about the first and last colour.
_BITS = (0.02, 0.98)

_DEEPEST = DEPTHS[-1]

#: Far centres are moved onto a box this many times as large as that of near centres.
_AROUND = 8.0


@dataclass(frozen=True)
class _Sorted:
    """Morton codes ``(N,)`` at the deepest level, ascending, and the Gaussians in this order."""

    codes: NDArray[np.int64]
    order: NDArray[np.int64]

    def at(self, depth: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Codes of the occupied cells at a depth, and the first Gaussian of each."""
        codes = self.codes >> 3 * (_DEEPEST - depth)
        first = np.flatnonzero(np.diff(codes, prepend=-1))
        return codes[first], first

    def counts(self, first: NDArray[np.int64]) -> NDArray[np.int64]:
        """Gaussians of each cell."""
        return np.diff(first, append=len(self.codes))


class Octree:
    """The cells of one or two scenes at any depth, in one cube around both.

    The cells of a single scene are those of `gs_codec.to_octree`. Non-finite centres are skipped.

    Parameters
    ----------
    scenes : sequence of Opened
    """

    def __init__(self, scenes: Sequence[Opened]) -> None:
        kept = {scene: np.isfinite(scene.positions).all(axis=1) for scene in scenes}
        places = {scene: scene.positions[mask].T for scene, mask in kept.items()}
        both = np.concatenate(list(places.values()), axis=1)
        # Very far centres go to the outermost cells; a cube around them would put all others in one
        # cell.
        lengths = np.concatenate([scene.lengths[mask] for scene, mask in kept.items()])
        with np.errstate(divide="ignore"):
            sizes = np.log(lengths)
        if found := find_far(both, sizes[None]):
            box = found.box(_AROUND)
            both = np.clip(both, box.low[:, None], box.high[:, None])
        self._cube = Cube.around(both) if both.size else Cube((0.0, 0.0, 0.0), 1.0)
        self._sorted: dict[Opened, _Sorted] = {}
        for scene, mask in kept.items():
            codes = self._cube.divide(places[scene], _DEEPEST)[0]
            order = np.argsort(codes)
            self._sorted[scene] = _Sorted(codes[order], np.flatnonzero(mask)[order])

    def cells(
        self,
        scene: Opened,
        choice: OctreeChoice,
        cubes: int = MOST_CUBES,
        points: int | None = None,
    ) -> Cubes | Points:
        """The occupied cells of a scene: cubes, or points if any scene has more than `cubes` cells.

        Returns at most `points` of them. All scenes share the scales of sizes and colours.
        """
        cells, depth = self._sorted[scene], choice.depth
        codes, first = cells.at(depth)
        by = self._by_occupancy if choice.colouring == "occupancy" else self._by_bits
        colours, legend = by(scene, first, depth)
        share = np.log(cells.counts(first)) / max(np.log(self._fullest(depth)), 1e-9)
        side = self._side(depth)
        places = decode_morton(codes, (depth,) * 3).astype(np.int64)
        middles = (np.array(self._cube.low) + side * (places.T + 0.5)).astype(np.float32)
        if max(len(each.at(depth)[1]) for each in self._sorted.values()) > cubes:
            some = thinned(len(codes), points or len(codes))
            return Points(middles[some], colours[some], legend)
        sides = side * (_LEAST + (_MOST - _LEAST) * share)
        return Cubes(middles, sides.astype(np.float32), colours, legend, choice.filled)

    def _side(self, depth: int) -> float:
        return self._cube.side / 2**depth

    def _fullest(self, depth: int) -> int:
        """Maximum number of Gaussians per cell, over all scenes."""
        every = [each.counts(each.at(depth)[1]) for each in self._sorted.values()]
        return max((int(each.max(initial=1)) for each in every), default=1)

    def _by_occupancy(
        self, scene: Opened, first: NDArray[np.int64], depth: int
    ) -> tuple[NDArray[np.float32], Legend | None]:
        """Colours ``(cells, 3)`` and their legend."""
        most = self._fullest(depth)
        title = f"Gaussians in a cell {self._side(depth):.2g} wide"
        counts = self._sorted[scene].counts(first)
        marks = scale_marks(1, max(most, 4), "log")
        return heat(np.log(counts), 0, np.log(marks[-1])), legend_of(title, marks)

    def _by_bits(
        self, scene: Opened, first: NDArray[np.int64], depth: int
    ) -> tuple[NDArray[np.float32], Legend | None]:
        """Like `_by_occupancy`; grey where bits are unknown."""
        if scene.bits is None:
            return np.full((len(first), 3), UNKNOWN, np.float32), None
        marks = scale_marks(*self._bits, "linear")
        cells = self._sorted[scene]
        sums = np.add.reduceat(scene.bits[cells.order], first)
        title = f"bits / Gaussian, cells {self._side(depth):.2g} wide"
        means = sums / cells.counts(first)
        return heat(means, marks[0], marks[-1]), legend_of(title, marks)

    @cached_property
    def _bits(self) -> tuple[float, float]:
        """Bits that map to about the first and last colour, at all depths."""
        known = [scene.bits for scene in self._sorted if scene.bits is not None]
        low, high = np.quantile(np.concatenate(known), _BITS).tolist()
        return low, high

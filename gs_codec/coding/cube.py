"""The bounding cube of a scene and its cells at each depth, divided like Open3D's `Octree`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.morton import encode_morton

#: Margin of the cube, relative to the extent of the centres, so that the highest are inside; also
#: the side of the cube around a single position.
EXPANSION = 0.01

#: Depths of cells; in deeper trees most cells would have one Gaussian.
DEPTHS = range(1, 17)


@dataclass(frozen=True)
class Cube:
    """A cube; its cells at depth d are its 8**d equal parts.

    Attributes
    ----------
    low : tuple of float
        The corner with the lowest x, y, z.
    side : float
    """

    low: tuple[float, float, float]
    side: float

    @classmethod
    def around(cls, positions: NDArray) -> Cube:
        """The cube that `Octree.convert_from_point_cloud` puts around finite ``(3, N)``, N > 0."""
        lowest, highest = np.stack([positions.min(axis=1), positions.max(axis=1)]).astype(float)
        centre = (lowest + highest) / 2
        half = float((centre - lowest).max())
        x, y, z = np.minimum(lowest, centre - half).tolist()
        return cls((x, y, z), 2 * half * (1 + EXPANSION) if half else EXPANSION)

    def is_divisible(self, depth: int) -> bool:
        """Whether float64 resolves cells of this depth at the cube's coordinates."""
        farthest = np.abs(self.low).max() + self.side
        return self.side / 2**depth > 4 * np.spacing(farthest)

    def divide(
        self, positions: NDArray, depth: int
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Assign ``positions (3, N)`` to cells at a depth, with Open3D's arithmetic.

        Returns
        -------
        codes : ndarray, shape (N,), int64
            Morton codes. Shifting them right by 3 bits gives those of the next lower depth.
        inside : ndarray, shape (3, N), float64
            The positions. Rounding puts some in no cell, and Open3D would lose them; these are
            moved into their cell by one unit in the last place.
        """
        inside = positions.astype(np.float64)
        cells = np.zeros(inside.shape, np.uint32)
        borders = np.repeat(np.array(self.low)[:, None], inside.shape[1], axis=1)
        half = self.side
        for _ in range(depth):
            half /= 2
            above = inside >= borders + half
            borders += np.where(above, half, 0.0)
            np.minimum(inside, np.nextafter(borders + half, -np.inf), out=inside)
            cells = 2 * cells + above
        return encode_morton(cells, (depth, depth, depth)), inside

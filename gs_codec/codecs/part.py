"""A part of a scene: the Gaussians in a box, with SH up to a degree."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.errors import InvalidInput
from gs_codec.scene import SH_COEFFICIENTS


@dataclass(frozen=True)
class Part:
    """The part of a scene to decode; by default all of it.

    Parameters
    ----------
    box : tuple of six float, optional
        Lowest x, y, z and highest x, y, z: Gaussians whose centre is within, borders included.
    sh_degree : int, optional
        Highest SH degree to decode, 0-3.

    Raises
    ------
    InvalidInput
        If a corner is not finite, the lowest is above the highest, or the degree is not 0-3.

    Examples
    --------
    >>> gs_codec.Part((-1, -1, -1, 1, 1, 1), sh_degree=0).sh_degree
    0
    """

    box: tuple[float, ...] | None = None
    sh_degree: int | None = None

    def __post_init__(self) -> None:
        if self.box is not None:
            finite = len(self.box) == 6 and all(map(math.isfinite, self.box))
            if not finite or any(a > b for a, b in zip(self.box[:3], self.box[3:], strict=True)):
                listed = ", ".join(f"{value:g}" for value in self.box)
                raise InvalidInput(f"box {listed}: expected lowest x, y, z, then highest x, y, z")
        if self.sh_degree is not None and not 0 <= self.sh_degree < len(SH_COEFFICIENTS):
            raise InvalidInput(f"SH degree {self.sh_degree}: expected 0-3")

    def degree_of(self, degree: int) -> int:
        """The degree to decode, of a scene of this degree."""
        return degree if self.sh_degree is None else min(degree, self.sh_degree)

    def contains(self, positions: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Which of ``positions (3, N)`` are in the box."""
        assert self.box is not None
        low, high = np.array(self.box[:3])[:, None], np.array(self.box[3:])[:, None]
        return np.all((low <= positions) & (positions <= high), axis=0)

    def meets(self, lowest: NDArray[np.float32], highest: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Which boxes from ``lowest (B, 3)`` to ``highest (B, 3)`` overlap this one."""
        if self.box is None:
            return np.ones(len(lowest), np.bool_)
        low, high = np.array(self.box[:3]), np.array(self.box[3:])
        return np.all((lowest <= high) & (low <= highest), axis=1)

"""A part of a scene: the Gaussians in a box, of a level, or needed for a view."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.blocks_for_view import View
from gs_codec.errors import InvalidInput
from gs_codec.runtime.arguments import check_fields
from gs_codec.scene import SH_COEFFICIENTS


@dataclass(frozen=True)
class Part:
    """The part of a scene to decode; by default all of it.

    Parameters
    ----------
    box : tuple of six float, optional
        Lowest x, y, z and highest x, y, z. Selects Gaussians with their centre inside or on the
        border.
    sh_degree : int, optional
        Highest SH degree to decode, 0-3. Higher degrees are not read, except where SH-AC is in a
        local basis and the degree is above 0.
    level : int
        Level of detail: 0 is the scene, 1 has a quarter of its Gaussians, 2 a sixteenth ..., if the
        file has levels (`Config.lod`). Default 0.
    view : Camera, optional
        Selects the blocks in this camera's view, each at the coarsest level with an error of at
        most `tolerance`; without levels, all blocks in view. The camera is in the file's coordinate
        system.
    budget : int, optional
        With `view`, the maximum number of Gaussians: blocks with the largest error are refined
        until it is reached. If not even the coarsest level fits, its nearest blocks are used.
    tolerance : float, optional
        With `view`, maximum error in pixels, 0 or more; None means 1, and 0 selects level 0 only.
        Refused for files without levels.

    Raises
    ------
    InvalidInput
        If a corner is not finite, the lowest is above the highest, the degree is not 0-3, another
        number is out of range, or options exclude each other.

    Examples
    --------
    >>> gs_codec.Part((-1, -1, -1, 1, 1, 1), sh_degree=0).sh_degree
    0
    """

    box: tuple[float, ...] | None = None
    sh_degree: int | None = None
    level: int = 0
    view: View | None = None
    budget: int | None = None
    tolerance: float | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        self._check_view()
        if self.box is not None:
            finite = len(self.box) == 6 and all(map(math.isfinite, self.box))
            if not finite or any(a > b for a, b in zip(self.box[:3], self.box[3:], strict=True)):
                listed = ", ".join(f"{value:g}" for value in self.box)
                raise InvalidInput(f"box {listed}: expected lowest x, y, z, then highest x, y, z")
        if self.sh_degree is not None and not 0 <= self.sh_degree < len(SH_COEFFICIENTS):
            raise InvalidInput(f"SH degree {self.sh_degree}: expected 0-3")

    def _check_view(self) -> None:
        if self.level < 0:
            raise InvalidInput(f"level {self.level}: expected 0 or more")
        if self.view is None:
            for name in ("budget", "tolerance"):
                if (value := getattr(self, name)) is not None:
                    raise InvalidInput(f"{name} {value}: has no effect without a view")
            return
        if self.level or self.box is not None:
            name = "level" if self.level else "box"
            raise InvalidInput(
                f"{name}: cannot be combined with a view, which selects blocks of all levels"
            )
        if self.budget is not None and self.budget < 1:
            raise InvalidInput(f"budget {self.budget}: expected at least 1 Gaussian")
        if self.tolerance is not None and not 0 <= self.tolerance < math.inf:
            raise InvalidInput(f"tolerance {self.tolerance}: expected 0 or more pixels")

    @property
    def chosen_tolerance(self) -> float:
        """The tolerance in pixels, with its default applied."""
        return 1.0 if self.tolerance is None else self.tolerance

    @property
    def whole(self) -> bool:
        """Whether this selects all Gaussians of the scene."""
        return self.box is None and self.view is None and not self.level

    def degree_of(self, degree: int) -> int:
        """The degree to decode, for a scene of this degree."""
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

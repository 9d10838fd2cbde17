"""Opacity, scale and rotation on their lattices; earlier attributes give the step sizes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.lattice import (
    LARGEST,
    TOO_LARGE,
    Lattice,
    from_lattice,
    to_fixed,
    to_float,
    to_lattice,
)

#: ``code(name, shifts) -> levels``: a decoder reads them, an encoder rounds to them.
Coder = Callable[[str, NDArray[np.int64]], NDArray[np.int64]]


@dataclass(frozen=True)
class Shape:
    """Fixed-point logits ``(n,)``; log-scales, descending, and quaternion vectors ``(3, n)``."""

    opacity: NDArray[np.int64]
    scales: NDArray[np.int64]
    vectors: NDArray[np.int64]


def walk_shape(lattice: Lattice, classes: NDArray[np.int64], code: Coder) -> Shape:
    """Go through the attributes in stream order; `code` gives the levels of each.

    It is called with the attribute's name and its shifts ``(n,)``; an encoder passes a
    `ShapeQuantiser`.
    """
    count = len(classes)
    scales = np.zeros((3, count), np.int64)
    none = np.zeros(count, np.int64)
    shifts = lattice.rules["opacity"].shifts(classes, 1, none, scales)
    unit = lattice.units["opacity"]
    opacity = from_lattice(code("opacity", shifts), lattice.centres[0], unit, shifts)
    unit = lattice.units["scaling"]
    for k in range(3):
        shifts = lattice.rules[f"scale_{k}"].shifts(classes, 1, opacity, scales)
        levels = code(f"scale_{k}", shifts)
        if k == 0:
            scales[k] = from_lattice(levels, lattice.centres[1], unit, shifts)
        else:
            scales[k] = scales[k - 1] - from_lattice(levels, 0, unit, shifts)
    unit = lattice.units["rotation"]
    shifts = lattice.rules["rotation"].shifts(classes, 1, opacity, scales)
    vectors = [from_lattice(code(f"rot_{k}", shifts), 0, unit, shifts) for k in (1, 2, 3)]
    return Shape(opacity, scales, np.array(vectors).reshape(3, count))


class ShapeQuantiser:
    """The `Coder` of an encoder: rounds the attributes, and keeps levels and shifts.

    Gaussians whose axes differ by at most half a step are rounded to no rotation.
    """

    def __init__(
        self,
        lattice: Lattice,
        opacity: NDArray,
        scales: NDArray[np.float64],
        vectors: NDArray[np.float64],
    ) -> None:
        self.lattice = lattice
        self.opacity = opacity
        self.scales = scales
        self.vectors = vectors
        self.levels: dict[str, NDArray[np.int64]] = {}
        self.shifts: dict[str, NDArray[np.int64]] = {}
        self.clamped = 0
        self._last = np.zeros(0)

    def __call__(self, name: str, shifts: NDArray[np.int64]) -> NDArray[np.int64]:
        """Levels of an attribute."""
        group = {"o": "opacity", "s": "scaling", "r": "rotation"}[name[0]]
        unit, centre, limit = self.lattice.units[group], 0, LARGEST
        if group == "opacity":
            values, centre = self.opacity, self.lattice.centres[0]
        elif group == "rotation":
            step = to_float(self.lattice.units["scaling"] << self.shifts["scale_0"])
            is_round = self.scales[0] - self.scales[2] <= 0.5 * step
            values = np.where(is_round, 0.0, self.vectors[int(name[-1]) - 1])
        elif name == "scale_0":
            values, centre = self.scales[0], self.lattice.centres[1]
        else:
            # Each scale is clamped to the largest, but their difference can be larger.
            scales = self.scales[int(name[-1])]
            self.clamped += int(np.count_nonzero(np.abs(scales) > LARGEST))
            values, limit = self._last - np.clip(scales, -LARGEST, LARGEST), TOO_LARGE
        fixed, clamped = to_fixed(values, limit)
        self.clamped += clamped
        levels = to_lattice(fixed, centre, unit, shifts)
        self.levels[name] = levels
        self.shifts[name] = shifts
        if group == "scaling":
            coded = to_float(from_lattice(levels, centre, unit, shifts))
            self._last = coded if name == "scale_0" else self._last - coded
        return levels

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
from gs_codec.codecs.adaptive.rotation import (
    LARGEST_STEP,
    TURNS,
    split_roll,
    tilts_of,
    turn_shifts,
)

#: ``code(name, shifts, unit, poles) -> levels``: a decoder reads them, an encoder rounds to them.
#: Poles are those of `turn_shifts`, None before rotation.
Coder = Callable[[str, NDArray[np.int64], int, NDArray[np.int8] | None], NDArray[np.int64]]


@dataclass(frozen=True)
class Shape:
    """Fixed-point logits ``(n,)``; log-scales, descending, and turns ``(3, n)``; poles ``(n,)``."""

    opacity: NDArray[np.int64]
    scales: NDArray[np.int64]
    turns: NDArray[np.int64]
    poles: NDArray[np.int8]


def walk_shape(lattice: Lattice, classes: NDArray[np.int64], code: Coder) -> Shape:
    """Go through the attributes in stream order; `code` gives the levels of each.

    It is called with the attribute's name, its shifts ``(n,)`` and its unit; an encoder passes a
    `ShapeQuantiser`.
    """
    count = len(classes)
    scales = np.zeros((3, count), np.int64)
    none = np.zeros(count, np.int64)
    shifts = lattice.rules["opacity"].shifts(classes, 1, none, scales)
    unit = lattice.units["opacity"]
    levels = code("opacity", shifts, unit, None)
    opacity = from_lattice(levels, lattice.centres[0], unit, shifts)
    unit = lattice.units["scaling"]
    for k in range(3):
        shifts = lattice.rules[f"scale_{k}"].shifts(classes, 1, opacity, scales)
        levels = code(f"scale_{k}", shifts, unit, None)
        if k == 0:
            scales[k] = from_lattice(levels, lattice.centres[1], unit, shifts)
        else:
            scales[k] = scales[k - 1] - from_lattice(levels, 0, unit, shifts)
    unit = lattice.units["rotation"]
    by_turn, poles = turn_shifts(lattice.rules, classes, opacity, scales)
    turns = np.empty((3, count), np.int64)
    for turn, name, shifts in zip(turns, TURNS, by_turn, strict=True):
        turn[:] = from_lattice(code(name, shifts, unit, poles), 0, unit, shifts)
    return Shape(opacity, scales, turns, poles)


class ShapeQuantiser:
    """The `Coder` of an encoder: rounds the attributes, and keeps levels, shifts and units.

    Gaussians whose axes differ by at most half a step are rounded to no rotation. `targets` has
    the turns of the others before rounding, each after the decoded ones before it.
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
        self.targets: dict[str, NDArray[np.float64]] = {}
        self.units: dict[str, int] = {}
        self.clamped = 0
        self._last = np.zeros(0)
        self._swings = np.zeros((2, 0))
        self._round = np.zeros(0, bool)

    def __call__(
        self, name: str, shifts: NDArray[np.int64], unit: int, poles: NDArray[np.int8] | None
    ) -> NDArray[np.int64]:
        """Levels of an attribute."""
        group = "rotation" if name in TURNS else "opacity" if name == "opacity" else "scaling"
        centre, limit = 0, LARGEST
        if group == "opacity":
            values, centre = self.opacity, self.lattice.centres[0]
        elif poles is not None:
            self._aim(name, poles)
            uncoded = self._round | (to_float(unit << shifts) > LARGEST_STEP)
            values = np.where(uncoded, 0.0, self.targets[name])
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
        self.units[name] = unit
        if group == "scaling":
            coded = to_float(from_lattice(levels, centre, unit, shifts))
            self._last = coded if name == "scale_0" else self._last - coded
        return levels

    def _aim(self, name: str, poles: NDArray[np.int8]) -> None:
        """Set the turn that is to be rounded; the roll is followed by two tilts."""
        if name == "roll":
            step = to_float(self.lattice.units["scaling"] << self.shifts["scale_0"])
            self._round = self.scales[0] - self.scales[2] <= 0.5 * step
            self.targets[name], self._swings = split_roll(self.vectors, poles)
        elif name == "tilt_0":
            steps = to_float(self.lattice.units["rotation"] << self.shifts["roll"])
            tilts = tilts_of(self._swings, self.levels["roll"] * steps, poles)
            self.targets["tilt_0"], self.targets["tilt_1"] = tilts

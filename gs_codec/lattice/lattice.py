"""What the lattices of a scene are made from."""

from __future__ import annotations

from dataclasses import dataclass

from gs_codec.lattice.rules import StepRule


@dataclass(frozen=True)
class PositionGrid:
    """Cells of positions: ``origin + (cell + 0.5) * step``.

    Attributes
    ----------
    origin : tuple of three float
        Lowest corner, scene units.
    step : float
        Side of a cell, scene units.
    bits : tuple of three int
        Bits of the cell's number on each axis.
    """

    origin: tuple[float, float, float]
    step: float
    bits: tuple[int, int, int]

    @property
    def total_bits(self) -> int:
        """Bits of a Morton code."""
        return sum(self.bits)


@dataclass(frozen=True)
class Lattice:
    """Everything that the blocks of a scene are decoded with, except the tables.

    ``centres`` (of opacity and the longest axis) and ``units`` are fixed-point values; units are
    of opacity, scales, rotation, SH-DC and the SH bands.
    """

    grid: PositionGrid
    classes: tuple[int, int]
    centres: tuple[int, int]
    units: dict[str, int]
    rules: dict[str, StepRule]

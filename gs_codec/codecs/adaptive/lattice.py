"""Fixed-point values (multiples of 2**-20), lattice parameters, and rules for step sizes.

A decoder bases every decision on these integers, because rounding of floats could differ between
machines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs_codec.coding.morton import axis_tables, bit_layout, cells_of, encode_morton
from gs_codec.runtime.kernels import inlined, kernel

#: Fraction bits of a fixed-point value.
FRACTION_BITS = 20

#: Values beyond this are clamped to it.
LARGEST = 400.0

#: Values written by any encoder are below this magnitude.
TOO_LARGE = 4 * LARGEST

#: `TOO_LARGE` as a fixed-point value.
FIXED_LIMIT = int(TOO_LARGE) << FRACTION_BITS

#: Fraction bits of a rule's coefficients.
RULE_FRACTION_BITS = 16

#: Maximum shift: a step size is at most its unit times 2**31.
MAX_SHIFT = 31

#: Maximum bits of a cell index on an axis.
MOST_AXIS_BITS = 21

#: Maximum bits of a Morton code if there are far Gaussians; their sort keys have one more bit.
MOST_FAR_BITS = 62


def to_fixed(values: NDArray[np.floating], limit: float) -> tuple[NDArray[np.int64], int]:
    """Convert to fixed-point values; count how many were clamped to `limit`."""
    fixed = np.empty(values.shape, np.int64)
    return fixed, _to_fixed(np.ravel(values).astype(np.float64, copy=False), limit, fixed.ravel())


@kernel
def _to_fixed(values, limit, fixed):
    clamped = 0
    for i in range(len(values)):
        value = min(max(values[i], -limit), limit)
        fixed[i] = np.int64(np.floor(value * (1 << FRACTION_BITS) + 0.5))
        clamped += np.int64(abs(values[i]) > limit)
    return clamped


def to_lattice(
    fixed: NDArray[np.int64], centre: int, unit: int, shifts: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Nearest levels ``(n,)`` of fixed-point values ``(n,)``; inverse of `from_lattice`."""
    levels = np.empty(len(fixed), np.int64)
    _to_lattice(fixed, centre, unit, shifts, levels)
    return levels


@kernel
def _to_lattice(fixed, centre, unit, shifts, levels):
    for i in range(len(levels)):
        step = unit << shifts[i]
        levels[i] = (2 * (fixed[i] - centre) + step) // (2 * step)


def from_lattice(
    levels: NDArray[np.int64], centre: int, unit: int, shifts: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Fixed-point values ``(n,)`` of levels: ``centre + level * (unit << shift)``."""
    return centre + levels * (unit << shifts)


def to_float(fixed: NDArray[np.int64]) -> NDArray[np.float64]:
    """Convert fixed-point values to float64, exactly."""
    return fixed / float(1 << FRACTION_BITS)


@dataclass(frozen=True)
class StepRule:
    """``shift = class + intercept + opacity * min(logit, 0) + sum of scale_k * log_scale_k``.

    The result is rounded down and clamped to the range from 0 to `limit`. `intercept`, `opacity`
    and `scales` are in units of 1 / 2**16; the intercept includes 0.5 if shifts should be rounded
    to nearest.
    """

    intercept: int
    opacity: int = 0
    scales: tuple[int, int, int] = (0, 0, 0)
    limit: int = MAX_SHIFT

    @property
    def numbers(self) -> tuple[int, ...]:
        """Intercept, and coefficients of opacity and of the three log-scales."""
        return (self.intercept, self.opacity, *self.scales)

    def shifts(
        self,
        classes: NDArray[np.integer],
        weight: int,
        opacity: NDArray[np.int64],
        scales: NDArray[np.int64],
    ) -> NDArray[np.int64]:
        """Shifts ``(n,)``.

        Parameters
        ----------
        classes : ndarray, shape (n,)
            Octaves by which a Gaussian's step sizes exceed the finest.
        weight : int
            Shift that one class adds, 1 or 3.
        opacity, scales : ndarray, shape (n,) and (3, n), int64
            Fixed-point values; coefficients of values not decoded yet are 0.
        """
        out = np.empty(len(classes), np.int64)
        _shifts(*packed_rules([self]), weight, classes, opacity, scales, out)
        return out


def packed_rules(rules: Sequence[StepRule]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Coefficients ``(R, 5)`` and limits ``(R,)`` of rules, for kernels."""
    numbers = np.array([rule.numbers for rule in rules], np.int64)
    return numbers, np.array([rule.limit for rule in rules], np.int64)


@inlined
def rule_shift(numbers, limits, rule, classes, opacity, first, second, third, more):
    """Shift of a Gaussian by rule number `rule` of several packed rules, plus `more` octaves.

    ``classes`` is the contribution of its class; opacity and scales are fixed-point values.
    """
    total = numbers[rule, 0] + (classes << RULE_FRACTION_BITS)
    total += (numbers[rule, 1] * min(opacity, 0)) >> FRACTION_BITS
    total += (numbers[rule, 2] * first) >> FRACTION_BITS
    total += (numbers[rule, 3] * second) >> FRACTION_BITS
    total += (numbers[rule, 4] * third) >> FRACTION_BITS
    return min(max((total >> RULE_FRACTION_BITS) + more, 0), limits[rule])


@kernel
def _shifts(numbers, limits, weight, classes, opacity, scales, out):
    for i in range(len(out)):
        octaves = weight * np.int64(classes[i])
        out[i] = rule_shift(
            numbers, limits, 0, octaves, opacity[i], scales[0, i], scales[1, i], scales[2, i], 0
        )


@dataclass(frozen=True)
class PositionGrid:
    """A grid of cells for positions; the centre of a cell is ``origin + (cell + 0.5) * step``.

    Attributes
    ----------
    origin : tuple of three float
        Lowest corner, scene units.
    step : float
        Side of a cell, scene units.
    bits : tuple of three int
        Bits of a cell index on each axis.
    has_far : bool
        Whether Gaussians outside the grid are stored exactly, as *far* Gaussians.

    Examples
    --------
    >>> grid = gs_codec.inspect("scene.egs").grid
    >>> grid.bits, grid.has_far
    ((17, 17, 17), False)
    """

    origin: tuple[float, float, float]
    step: float
    bits: tuple[int, int, int]
    has_far: bool = False

    @property
    def total_bits(self) -> int:
        """Bits of a Morton code."""
        return sum(self.bits)

    @property
    def key_bits(self) -> int:
        """Bits of a sort key; see `grid_codes`."""
        return self.total_bits + self.has_far


def _levels(row: NDArray[np.float32], axis: int, grid: PositionGrid) -> NDArray[np.float64]:
    """Cell indices of coordinates on an axis, as floats that may lie outside the grid."""
    return np.floor((row.astype(np.float64) - grid.origin[axis]) / grid.step)


def outside(positions: NDArray[np.float32], grid: PositionGrid) -> NDArray[np.bool_]:
    """Which of ``positions (3, N)`` are outside a grid."""
    found = np.zeros(positions.shape[1], np.bool_)
    for axis, row in enumerate(positions):
        levels = _levels(row, axis, grid)
        found |= (levels < 0) | (levels >= 1 << grid.bits[axis])
    return found


def grid_codes(positions: NDArray[np.float32], grid: PositionGrid) -> NDArray[np.int64]:
    """Sort keys ``(N,)``: Morton codes of the cells of ``positions (3, N)``.

    Positions outside get the codes of the nearest cells. If the grid has far Gaussians, theirs have
    one more bit, so that they come last.
    """
    cells = np.empty(positions.shape, np.uint32)
    for axis, row in enumerate(positions):
        cells[axis] = np.clip(_levels(row, axis, grid), 0, (1 << grid.bits[axis]) - 1)
    codes = encode_morton(cells, grid.bits)
    if grid.has_far:
        codes[outside(positions, grid)] |= 1 << grid.total_bits
    return codes


def far_among(codes: NDArray[np.int64], grid: PositionGrid) -> int:
    """Number of far Gaussians, the last ones, among Gaussians sorted by `grid_codes`."""
    return int(np.count_nonzero(codes >> grid.total_bits)) if grid.has_far else 0


def far_codes(number: int, grid: PositionGrid) -> NDArray[np.int64]:
    """Morton codes ``(number,)`` given to far Gaussians: the last cell on each axis."""
    return np.full(number, (1 << grid.total_bits) - 1, np.int64)


def cell_widths(grid: PositionGrid) -> NDArray[np.int64]:
    """Number of cell-index bits on each axis ``(3, bits + 1)`` among 0, 1, ... low Morton bits."""
    widths = np.zeros((3, grid.total_bits + 1), np.int64)
    for bit, axis in enumerate(bit_layout(grid.bits)[::-1]):
        widths[:, bit + 1] = widths[:, bit]
        widths[axis, bit + 1] += 1
    return widths


def cell_sides(dropped: NDArray[np.int64], grid: PositionGrid) -> NDArray[np.float64]:
    """Sides ``(3, n)``, in scene units, of the cells of codes without ``dropped (n,)`` low bits."""
    return np.ldexp(grid.step, cell_widths(grid)[:, dropped])


@kernel
def _centres(codes, dropped, size, tables, widths, found):
    for i in range(codes.size):
        x, y, z = cells_of(codes[i], size, tables)
        found[0, i] = 2 * np.int64(x) + (1 << widths[0, dropped[i]])
        found[1, i] = 2 * np.int64(y) + (1 << widths[1, dropped[i]])
        found[2, i] = 2 * np.int64(z) + (1 << widths[2, dropped[i]])


def centres(
    codes: NDArray[np.int64], dropped: NDArray[np.int64], grid: PositionGrid
) -> NDArray[np.int64]:
    """Centres ``(3, n)``, in half steps, of the cells of codes without low bits.

    The ``dropped (n,)`` low bits of ``codes (n,)`` are 0.
    """
    found = np.empty((3, codes.size), np.int64)
    _centres(
        codes, dropped, -(-grid.total_bits // 8), axis_tables(grid.bits), cell_widths(grid), found
    )
    return found


def from_grid(
    half_steps: NDArray[np.int64], grid: PositionGrid, far: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """Convert positions in half steps of the grid to floats ``(3, N)``, clamped to float32.

    The last ones are replaced by ``far (3, f)``, if given.
    """
    positions = np.array(grid.origin)[:, None] + half_steps * (0.5 * grid.step)
    largest = float(np.finfo(np.float32).max)
    found = np.clip(positions, -largest, largest, out=positions).astype(np.float32)
    if far is not None and far.size:
        found[:, -far.shape[1] :] = far
    return found


@dataclass(frozen=True)
class Lattice:
    """All parameters for decoding the blocks of a scene, except the tables.

    ``centres`` (of opacity and the longest axis) and ``units`` are fixed-point values; there are
    units for opacity, scales, rotation, SH-DC and each SH band.
    """

    grid: PositionGrid
    classes: tuple[int, int]
    centres: tuple[int, int]
    units: dict[str, int]
    rules: dict[str, StepRule]

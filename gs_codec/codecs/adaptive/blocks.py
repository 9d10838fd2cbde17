"""Blocks of an encoder: the levels of every attribute, and the passes they are coded in."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.arrange import Arranged
from gs_codec.codecs.adaptive.colour import code_colours, round_diffusing
from gs_codec.codecs.adaptive.contexts import (
    COLOUR_SHIFTS,
    FOLLOWING,
    shift_context,
    sum_context,
)
from gs_codec.codecs.adaptive.following import following_contexts
from gs_codec.codecs.adaptive.lattice import (
    LARGEST,
    PositionGrid,
    centres,
    from_grid,
    to_fixed,
    to_float,
)
from gs_codec.codecs.adaptive.rotation import turned_quaternions
from gs_codec.codecs.adaptive.sh_ac import BandSums, code_coefficient, two_nearest
from gs_codec.codecs.adaptive.shape import Shape, ShapeQuantiser, walk_shape
from gs_codec.codecs.adaptive.tokens import tokenise
from gs_codec.coding.axes import sort_axes
from gs_codec.coding.count_tree import encode_tree
from gs_codec.coding.extent import block_extent
from gs_codec.coding.fields import BitWriter
from gs_codec.coding.nearest import find_all_nearest
from gs_codec.coding.ycocg import take_colours, to_ycocg
from gs_codec.config import SH_STREAMS
from gs_codec.runtime.arrays import current
from gs_codec.runtime.kernels import kernel
from gs_codec.scene import sh_bands


@dataclass(frozen=True)
class PassData:
    """A pass: the token of each symbol ``(n,)``, its context, and the raw bits of some.

    ``raw_levels`` and ``raw_widths`` belong to the symbols with raw bits, in symbol order.
    """

    tokens: NDArray[np.uint8]
    contexts: NDArray[np.uint16]
    raw_levels: NDArray[np.int64]
    raw_widths: NDArray[np.uint8]

    @classmethod
    def of(cls, levels: NDArray[np.integer], contexts: NDArray[np.integer]) -> PassData:
        """Tokenise levels."""
        tokens, raw_levels, raw_widths = tokenise(levels)
        return cls(tokens, contexts.astype(np.uint16), raw_levels, raw_widths)

    @classmethod
    def following(
        cls, name: str, levels: NDArray[np.int64], bases: NDArray, steps: NDArray[np.int64] | int
    ) -> PassData:
        """Tokenise levels whose contexts depend on those of the Gaussians before."""
        return cls.of(levels, following_contexts(levels * steps, bases, FOLLOWING[name]))

    def count(self, counts: NDArray[np.int64]) -> None:
        """Add the number of times that each token occurs to ``counts (contexts, ALPHABET)``."""
        _count(self.tokens, self.contexts, counts)


@kernel
def _count(tokens, contexts, counts):
    for i in range(len(tokens)):
        counts[contexts[i], tokens[i]] += 1


@dataclass(frozen=True)
class ShapedBlock:
    """A block without its colours: a range of the stream, and what is coded and decoded so far.

    ``grid_positions (3, n)`` are decoded, in half steps of the grid; ``shifts (n,)`` are those of
    the step sizes of its colours; ``clamped`` is the number of values clamped to the largest.
    """

    start: int
    stop: int
    tree: bytes
    low_bits: bytes
    grid_positions: NDArray[np.int64]
    shape: Shape
    shifts: NDArray[np.int64]
    passes: list[PassData]
    clamped: int

    def decoded(self, grid: PositionGrid) -> tuple[NDArray[np.float32], ...]:
        """Decoded positions ``(3, n)``, log-scales ``(3, n)`` and rotations ``(4, n)``."""
        return (
            from_grid(self.grid_positions, grid),
            to_float(self.shape.scales).astype(np.float32),
            turned_quaternions(to_float(self.shape.turns), self.shape.poles),
        )


@dataclass(frozen=True)
class Block:
    """Everything of a block to be coded, and where its Gaussians are, as by `block_extent`."""

    tree: bytes
    low_bits: bytes
    extent: NDArray[np.float32]
    passes: list[PassData]
    clamped: int

    def kept(self) -> Block:
        """The block with its arrays in the storage in use, memory or disk."""
        keep = current().keep
        kept = [PassData(*map(keep, vars(data).values())) for data in self.passes]
        return replace(self, passes=kept)


def shape_block(arranged: Arranged, start: int, stop: int) -> ShapedBlock:
    """Round positions, opacity, scales and rotation of a block."""
    source, lattice = arranged.source, arranged.lattice
    members, classes = arranged.order[start:stop], arranged.classes[:, start:stop]
    _, scales, vectors = sort_axes(source.log_scale[:, members], source.rot[:, members])
    quantiser = ShapeQuantiser(lattice, source.opacity[0, members], scales, vectors)
    shape = walk_shape(lattice, classes[0], quantiser)
    first = classes[0].astype(np.int64)
    listed = [
        PassData.following("shape class", first, np.zeros_like(first), 1),
        PassData.of(classes[1], first),
    ]
    listed += [
        _shape_pass(name, quantiser.levels[name], quantiser.shifts[name], quantiser.units[name])
        for name in quantiser.levels
    ]
    known = (shape.opacity, shape.scales)
    codes = arranged.codes[start:stop]
    tree, lefts = encode_tree(codes, lattice.grid.total_bits)
    dropped = np.minimum(lattice.rules["position"].shifts(classes[0], 3, *known), lefts)
    kept = codes >> dropped
    bits = BitWriter()
    bits.add(kept, (lefts - dropped).astype(np.uint8))
    grid_positions = centres(kept << dropped, dropped, lattice.grid)
    shifts = lattice.rules["colour"].shifts(classes[1], 1, *known)
    return ShapedBlock(
        start, stop, tree, bits.finish(), grid_positions, shape, shifts, listed, quantiser.clamped
    )


def _shape_pass(
    name: str, levels: NDArray[np.int64], shifts: NDArray[np.int64], unit: int
) -> PassData:
    """The pass of opacity, a scale or a component of rotation."""
    if name not in FOLLOWING:
        return PassData.of(levels, shift_context(shifts))
    return PassData.following(name, levels, shift_context(shifts), unit << shifts)


def colour_block(arranged: Arranged, shaped: ShapedBlock, diffusing: bool) -> Block:
    """Round the colours of a block; `diffusing` spreads the errors of SH-AC to neighbours."""
    source, units = arranged.source, arranged.lattice.units
    members = arranged.order[shaped.start : shaped.stop]
    nearest = find_all_nearest(shaped.grid_positions)
    colours, clamped = to_fixed(to_ycocg(source.f_dc[:, members]), LARGEST)
    clamped += shaped.clamped
    levels, contexts, _ = code_colours(nearest, colours, units["sh-dc"], shaped.shifts)
    listed = [*shaped.passes, PassData.of(levels.ravel(), contexts.ravel())]
    coefficients = len(source.f_rest) // 3
    if coefficients:
        bands = zip(SH_STREAMS, sh_bands(coefficients), strict=False)
        finest = [units[stream] for stream, band in bands for _ in band]
        planes = source.f_rest.reshape(3, coefficients, -1)
        ac, beyond = take_colours(planes, members, np.array(finest), shaped.shifts, LARGEST)
        clamped += beyond
        levels = round_diffusing(nearest, ac) if diffusing else np.floor(ac + 0.5).astype(np.int32)
        by_colour = levels.reshape(3, coefficients, -1)
        listed += _ac_passes(by_colour, shaped.shifts, two_nearest(nearest))
    extent = block_extent(*shaped.decoded(arranged.lattice.grid))
    return Block(shaped.tree, shaped.low_bits, extent, listed, clamped)


def _ac_passes(
    levels: NDArray[np.int32], shifts: NDArray[np.int64], near: NDArray[np.uint32]
) -> list[PassData]:
    """Passes of SH-AC ``levels (3, K, n)``: sums, then coefficients as far as something is left."""
    bands = [levels[:, band.start : band.stop] for band in sh_bands(levels.shape[1])]
    sums = [np.abs(band).sum(axis=(0, 1), dtype=np.int64) for band in bands]
    left = np.sum(sums, axis=0)
    base = shift_context(shifts, COLOUR_SHIFTS)
    listed = [PassData.following("SH sum", left, base, 1)]
    for number, (band, own) in enumerate(zip(bands, sums, strict=True), 1):
        if number < len(bands):
            some = np.flatnonzero(left)
            listed.append(PassData.of(own[some], sum_context(left[some])))
            left = left - own
        counted = BandSums.of(own, near)
        planes = [plane for colour in band for plane in colour]
        for k, plane in enumerate(planes, 1):
            coded = code_coefficient(plane, counted, k == len(planes))
            listed.append(PassData.of(*coded))
    return listed

"""Encoding of blocks: the levels of every attribute, and the passes that code them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.arrange import Arranged
from gs_codec.codecs.adaptive.basis import Bases, bounds, choose_bases, write_bases
from gs_codec.codecs.adaptive.colour import code_colours, round_diffusing
from gs_codec.codecs.adaptive.lattice import (
    LARGEST,
    TOO_LARGE,
    PositionGrid,
    centres,
    far_among,
    far_codes,
    from_grid,
    to_fixed,
    to_float,
)
from gs_codec.codecs.adaptive.rotation import turned_quaternions
from gs_codec.codecs.adaptive.section import write_far
from gs_codec.codecs.adaptive.sh_ac import code_bands, two_nearest
from gs_codec.codecs.adaptive.shape import Shape, ShapeQuantiser, shape_pass, walk_shape
from gs_codec.codecs.adaptive.tokens import tokenise
from gs_codec.coding.axes import sort_axes
from gs_codec.coding.count_tree import encode_tree
from gs_codec.coding.extent import block_extent
from gs_codec.coding.fields import BitWriter
from gs_codec.coding.nearest import Nearest, find_all_nearest
from gs_codec.coding.ycocg import fill_colours, from_ycocg, take_colours, to_ycocg
from gs_codec.config import SH_STREAMS
from gs_codec.runtime.arrays import current
from gs_codec.runtime.kernels import kernel
from gs_codec.scene import sh_bands, take_columns


@dataclass(frozen=True)
class PassData:
    """A pass: the token of each symbol ``(n,)``, its context, and the raw bits of some.

    ``raw_symbols`` are the indices of the symbols with raw bits; ``raw_levels`` are their integers,
    ``raw_widths`` their numbers of raw bits.
    """

    tokens: NDArray[np.uint8]
    contexts: NDArray[np.uint16]
    raw_symbols: NDArray[np.int64]
    raw_levels: NDArray[np.int64]
    raw_widths: NDArray[np.uint8]

    @classmethod
    def of(cls, levels: NDArray[np.integer], contexts: NDArray[np.uint16]) -> PassData:
        """Tokenise levels."""
        tokens, raw_symbols, raw_levels, raw_widths = tokenise(levels.ravel())
        return cls(tokens, contexts.ravel(), raw_symbols, raw_levels, raw_widths)

    def count(self, counts: NDArray[np.int64]) -> None:
        """Add the occurrences of each token to ``counts (contexts, ALPHABET)``."""
        _count(self.tokens, self.contexts, counts)


@kernel
def _count(tokens, contexts, counts):
    for i in range(len(tokens)):
        counts[contexts[i], tokens[i]] += 1


@dataclass(frozen=True)
class ShapedBlock:
    """A block before its colours are coded: a range of the stream, coded and decoded.

    ``grid_positions (3, n)`` are decoded positions in half steps of the grid; ``far (3, f)`` are
    the centres of its far Gaussians; ``shifts (n,)`` are the shifts of the colours' step sizes;
    ``coded`` is the shape pass; ``clamped`` counts values clamped to the largest level.
    """

    start: int
    stop: int
    tree: bytes
    low_bits: bytes
    far: NDArray[np.float32]
    grid_positions: NDArray[np.int64]
    shape: Shape
    shifts: NDArray[np.int64]
    coded: PassData
    clamped: int

    def decoded(self, grid: PositionGrid) -> tuple[NDArray[np.float32], ...]:
        """Decoded positions ``(3, n)``, log-scales ``(3, n)`` and rotations ``(4, n)``."""
        return (
            from_grid(self.grid_positions, grid, self.far),
            to_float(self.shape.scales).astype(np.float32),
            turned_quaternions(to_float(self.shape.turns), self.shape.poles),
        )

    def coded_places(self) -> tuple[bytes, bytes, bytes]:
        """Coded positions: the tree, low bits, and centres of far Gaussians."""
        return self.tree, self.low_bits, write_far(self.far)


@dataclass(frozen=True)
class Block:
    """A block ready for entropy coding, with its `block_extent`."""

    tree: bytes
    low_bits: bytes
    far: bytes
    extent: NDArray[np.float32]
    passes: list[PassData]
    clamped: int
    basis: bytes = b""

    def kept(self) -> Block:
        """The block with its arrays moved to the storage in use (memory or disk)."""
        keep = current().keep
        kept = [PassData(*map(keep, vars(data).values())) for data in self.passes]
        return replace(self, passes=kept)


def shape_block(arranged: Arranged, start: int, stop: int) -> ShapedBlock:
    """Quantise positions, opacity, scales and rotation of a block."""
    source, lattice = arranged.source, arranged.lattice
    members, classes = arranged.order[start:stop], arranged.classes[:, start:stop]
    log_scale, rot = (take_columns(planes, members) for planes in (source.log_scale, source.rot))
    _, scales, vectors = sort_axes(log_scale, rot)
    quantiser = ShapeQuantiser(lattice, take_columns(source.opacity, members)[0], scales, vectors)
    shape = walk_shape(lattice, classes[0], quantiser)
    levels, contexts = shape_pass(classes, quantiser.levels, quantiser.shifts, lattice.units)
    known = (shape.opacity, shape.scales)
    codes = arranged.codes[start:stop]
    number = far_among(codes, lattice.grid)
    near, far = codes[: len(codes) - number], source.positions[:, members[len(codes) - number :]]
    tree, lefts = encode_tree(near, lattice.grid.total_bits)
    if number:
        codes, lefts = np.append(near, far_codes(number, lattice.grid)), np.pad(lefts, (0, number))
    dropped = np.minimum(lattice.rules["position"].shifts(classes[0], 3, *known), lefts)
    kept = codes >> dropped
    bits = BitWriter()
    bits.add(kept, (lefts - dropped).astype(np.uint8))
    grid_positions = centres(kept << dropped, dropped, lattice.grid)
    shifts = lattice.rules["colour"].shifts(classes[1], 1, *known)
    return ShapedBlock(
        start,
        stop,
        tree,
        bits.finish(),
        far,
        grid_positions,
        shape,
        shifts,
        PassData.of(levels, contexts),
        quantiser.clamped,
    )


class CodedDc(NamedTuple):
    """SH-DC of a block: results of `code_colours`, its neighbours, and the number clamped."""

    levels: NDArray[np.int32]
    contexts: NDArray[np.uint16]
    values: NDArray[np.int64]
    nearest: Nearest
    clamped: int


def code_dc(arranged: Arranged, shaped: ShapedBlock) -> CodedDc:
    """Quantise SH-DC of a block."""
    members = arranged.order[shaped.start : shaped.stop]
    nearest = find_all_nearest(shaped.grid_positions)
    colours, clamped = to_fixed(to_ycocg(take_columns(arranged.source.f_dc, members)), LARGEST)
    unit = arranged.lattice.units["sh-dc"]
    return CodedDc(*code_colours(nearest, colours, unit, shaped.shifts), nearest, clamped)


def colour_block(arranged: Arranged, shaped: ShapedBlock, diffusing: bool) -> Block:
    """Quantise the colours of a block; `diffusing` spreads the errors of SH-AC to neighbours."""
    source, members = arranged.source, arranged.order[shaped.start : shaped.stop]
    dc = code_dc(arranged, shaped)
    clamped = dc.clamped + shaped.clamped
    listed = [shaped.coded, PassData.of(dc.levels, dc.contexts)]
    coefficients = len(source.f_rest) // 3
    bases = None
    by_colour: NDArray[np.int32] = np.empty((3, coefficients, len(members)), np.int32)
    if coefficients:
        planes = source.f_rest.reshape(3, coefficients, -1)
        finest = _ac_units(arranged)
        ac, beyond = take_colours(planes, members, finest, shaped.shifts, LARGEST)
        clamped += beyond
        if diffusing and arranged.may_have_basis and np.ptp(finest) == 0:
            by_channel = ac.reshape(3, coefficients, -1)
            bases = choose_bases(by_channel)
            if bases is not None:
                ac = bases.components(by_channel).reshape(ac.shape)
        rounded = (
            round_diffusing(dc.nearest, ac) if diffusing else np.floor(ac + 0.5).astype(np.int32)
        )
        by_colour = rounded.reshape(3, coefficients, -1)
        coded = code_bands(by_colour, two_nearest(dc.nearest), shaped.shifts)
        listed += [PassData.of(values, contexts) for values, contexts, _ in coded]
    decoded = shaped.decoded(arranged.lattice.grid)
    if arranged.watched is not None:
        _keep_decoded(arranged, shaped, decoded, dc.values, by_colour, bases)
    basis = b"" if bases is None else write_bases(bases)
    return Block(*shaped.coded_places(), block_extent(*decoded), listed, clamped, basis)


def _ac_units(arranged: Arranged) -> NDArray[np.int64]:
    """Unit of each SH-AC ``(K,)``."""
    bands = zip(SH_STREAMS, sh_bands(len(arranged.source.f_rest) // 3), strict=False)
    return np.array([arranged.lattice.units[stream] for stream, band in bands for _ in band])


def _keep_decoded(
    arranged: Arranged,
    shaped: ShapedBlock,
    decoded: tuple[NDArray[np.float32], ...],
    colours: NDArray[np.int64],
    levels: NDArray[np.int32],
    bases: Bases | None,
) -> None:
    """Store the decoded values of the watched Gaussians of a block."""
    watched, (start, stop) = arranged.watched, (shaped.start, shaped.stop)
    assert watched is not None
    at = watched.within(start, stop)
    positions, log_scale, rot = (values[:, at] for values in decoded)
    f_rest = np.empty((3, levels.shape[1], len(at)), np.float32)
    if f_rest.size:
        some = np.ascontiguousarray(levels[:, :, at])
        units, shifts = _ac_units(arranged), shaped.shifts[at]
        if bases is None:
            fill_colours(some, units, shifts, TOO_LARGE, f_rest)
        else:
            ends = np.searchsorted(at, bounds(len(bases.entries), stop - start))
            bases.fill(some, ends, units[0], shifts, TOO_LARGE, f_rest)
    watched.keep(
        start,
        stop,
        positions=positions,
        log_scale=log_scale,
        rot=rot,
        opacity=to_float(shaped.shape.opacity[at])[None].astype(np.float32),
        f_dc=from_ycocg(to_float(colours[:, at])),
        f_rest=f_rest.reshape(3 * levels.shape[1], len(at)),
    )

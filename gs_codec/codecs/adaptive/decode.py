"""Decoder of profiles ``l``, ``m`` and ``s``: stream to scene."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.basis import Bases, bounds, read_bases
from gs_codec.codecs.adaptive.colour import read_colours
from gs_codec.codecs.adaptive.contexts import passes
from gs_codec.codecs.adaptive.lattice import TOO_LARGE, centres, far_codes, from_grid, to_float
from gs_codec.codecs.adaptive.rotation import turned_quaternions
from gs_codec.codecs.adaptive.section import lattice_of, read_far
from gs_codec.codecs.adaptive.sh_ac import read_bands, two_nearest
from gs_codec.codecs.adaptive.shape import Shape, read_shapes
from gs_codec.coding.context_rans import PassReader, PassTables
from gs_codec.coding.count_tree import decode_tree
from gs_codec.coding.fields import BitReader
from gs_codec.coding.nearest import Nearest, find_all_nearest
from gs_codec.coding.ycocg import fill_colours, from_ycocg
from gs_codec.egs.egs_file import EgsFile, SectionId
from gs_codec.egs.header import Feature
from gs_codec.egs.index import check_centres
from gs_codec.errors import CorruptStream
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.threads import run_all
from gs_codec.scene import SH_COEFFICIENTS, group_rows, sh_bands


def adaptive_sections(sh_degree: int) -> set[SectionId]:
    """Per-block sections needed to decode SH up to a degree."""
    listed = passes(SH_COEFFICIENTS[sh_degree])
    coded = {SectionId.of_stream(stream) for item in listed for stream in item.streams}
    return {*coded, SectionId.GEOMETRY, SectionId.STATES, SectionId.LOW_BITS}


def empty_groups(degree: int, count: int) -> dict[str, NDArray[np.float32]]:
    """Zeros for the attribute groups of a number of Gaussians."""
    rows = group_rows(SH_COEFFICIENTS[degree])
    return {group: np.zeros((number, count), np.float32) for group, number in rows.items()}


def decode_adaptive(
    file: EgsFile,
    spans: dict[int, slice],
    degree: int,
    progress: Progress | None = None,
) -> dict[str, NDArray[np.float32]]:
    """Decode blocks to attribute groups, in stream order.

    `spans` gives each block's range in the result; SH is decoded up to `degree`.
    """
    groups = empty_groups(degree, max((span.stop for span in spans.values()), default=0))
    blocks = Blocks(file, degree)
    advance = step_counter(progress, "decode", len(spans))

    def fill(item: tuple[int, slice]) -> None:
        blocks.fill(item[0], groups, item[1])

    run_all(fill, spans.items(), advance=advance)
    return groups


@dataclass(frozen=True)
class DecodedBlock:
    """A decoded block, before conversion to floats.

    ``classes (2, n)`` are shape and colour classes; ``grid_positions (3, n)`` are in half steps of
    the grid; ``dropped (n,)`` is the number of low Morton bits that are not coded, ``low_bits
    (n,)`` the number coded outside the tree; ``far (3, f)`` are the centres of the last Gaussians,
    which are outside the grid; ``shifts (n,)`` are the shifts of the colours' step sizes; ``colours
    (3, n)`` is SH-DC as fixed-point Y, Co, Cg; ``levels (3, K, n)`` are the levels of SH-AC, or of
    its components in `bases`.
    """

    classes: NDArray[np.int64]
    shape: Shape
    grid_positions: NDArray[np.int64]
    dropped: NDArray[np.int64]
    low_bits: NDArray[np.int64]
    far: NDArray[np.float32]
    nearest: Nearest
    shifts: NDArray[np.int64]
    colours: NDArray[np.int64]
    levels: NDArray[np.int32]
    bases: Bases | None


class Blocks:
    """Decodes individual blocks of a file, with SH up to a degree."""

    def __init__(self, file: EgsFile, degree: int) -> None:
        self.file = file
        self.lattice, self.models = lattice_of(file)
        self.tables = PassTables.pack(self.models.tables())
        self.passes = passes(SH_COEFFICIENTS[file.header.sh_degree])
        self.rows = [self.models.rows(item) for item in self.passes]
        self.has_bases = degree > 0 and Feature.LOCAL_BASIS in file.header.features
        self.bands = sh_bands(SH_COEFFICIENTS[file.header.sh_degree if self.has_bases else degree])

    def read(self, block: int) -> DecodedBlock:
        """Decode a block. Raises TruncatedStream or CorruptStream."""
        where = f"block {block}"
        lattice, section = self.lattice, partial(self.file.section, block=block)
        start, stop = self.file.header.block_range(block)
        codes, lefts, far = self._read_tree(block)
        reader = PassReader(section(SectionId.STATES), self.tables, where)
        streams = [
            [section(SectionId.of_stream(stream)) for stream in item.streams]
            for item in self.passes[: 2 + len(self.bands)]
        ]
        classes, shape = read_shapes(reader, streams[0], self.rows[0], lattice, stop - start)
        known = (shape.opacity, shape.scales)
        dropped = np.minimum(lattice.rules["position"].shifts(classes[0], 3, *known), lefts)
        low_bits = lefts - dropped
        bit_reader = BitReader(section(SectionId.LOW_BITS), f"low bits of {where}")
        codes |= bit_reader.fields(low_bits) << dropped
        bit_reader.close()
        grid_positions = centres(codes, dropped, lattice.grid)
        nearest = find_all_nearest(grid_positions)
        shifts = lattice.rules["colour"].shifts(classes[1], 1, *known)
        unit = lattice.units["sh-dc"]
        colours = read_colours(reader, streams[1], self.rows[1], nearest, unit, shifts)
        kept = self.bands[-1].stop if self.bands else 0
        levels = np.zeros((3, kept, stop - start), np.int32)
        ac = [of_band for [of_band] in streams[2:]]
        read_bands(reader, ac, self.rows[2:], levels, two_nearest(nearest), shifts)
        if len(streams) == len(self.passes):
            reader.finish()
        of_places = grid_positions, dropped, low_bits, far
        bases = read_bases(self.file, block) if self.has_bases else None
        return DecodedBlock(classes, shape, *of_places, nearest, shifts, colours, levels, bases)

    def _read_tree(self, block: int) -> tuple[NDArray, NDArray, NDArray[np.float32]]:
        """Morton codes ``(n,)`` without low bits; number of low bits; far centres ``(3, f)``."""
        (start, stop), grid = self.file.header.block_range(block), self.lattice.grid
        far = read_far(self.file, block)
        number = far.shape[1]
        tree, where = self.file.section(SectionId.GEOMETRY, block), f"geometry of block {block}"
        codes, lefts = decode_tree(tree, stop - start - number, grid.total_bits, where)
        if number:
            codes, lefts = np.append(codes, far_codes(number, grid)), np.pad(lefts, (0, number))
        return codes, lefts, far

    def fill(self, block: int, groups: dict[str, NDArray[np.float32]], span: slice) -> DecodedBlock:
        """Decode a block into the range `span` of `groups`, and return it."""
        found = self.read(block)
        shape = found.shape
        positions = from_grid(found.grid_positions, self.lattice.grid, found.far)
        check_centres(self.file, block, positions)
        groups["positions"][:, span] = positions
        groups["opacity"][0, span] = to_float(shape.opacity)
        groups["log_scale"][:, span] = to_float(shape.scales)
        groups["rot"][:, span] = turned_quaternions(to_float(shape.turns), shape.poles)
        groups["f_dc"][:, span] = from_ycocg(to_float(found.colours))
        kept = found.levels.shape[1]
        if kept:
            units = [self.lattice.units[f"sh{n}"] for n, b in enumerate(self.bands, 1) for _ in b]
            rows = groups["f_rest"].reshape(3, len(groups["f_rest"]) // 3, -1)
            if not self._fill_colours(found, np.array(units), rows, span.start):
                raise CorruptStream(f"block {block}: a value out of range")
        return found

    def _fill_colours(
        self, found: DecodedBlock, units: NDArray[np.int64], rows: NDArray[np.float32], first: int
    ) -> bool:
        """Fill SH-AC of a block; returns whether all values are in range."""
        lattice = found.shifts, TOO_LARGE, rows, first
        if found.bases is None:
            kept = rows.shape[1]
            return fill_colours(found.levels[:, :kept], units[:kept], *lattice)
        ends = bounds(len(found.bases.entries), len(found.shifts))
        return found.bases.fill(found.levels, ends, units[0], *lattice)

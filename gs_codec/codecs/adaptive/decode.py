"""Decoder of profiles ``l``, ``m`` and ``s``: stream to scene."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.colour import decode_colours
from gs_codec.codecs.adaptive.contexts import (
    COLOUR_SHIFTS,
    FOLLOWING,
    passes,
    shift_context,
    sum_context,
)
from gs_codec.codecs.adaptive.following import read_following
from gs_codec.codecs.adaptive.lattice import (
    FRACTION_BITS,
    TOO_LARGE,
    centres,
    from_grid,
    to_float,
)
from gs_codec.codecs.adaptive.rotation import turned_quaternions
from gs_codec.codecs.adaptive.section import lattice_of
from gs_codec.codecs.adaptive.sh_ac import BandSums, read_coefficient, two_nearest
from gs_codec.codecs.adaptive.shape import Shape, walk_shape
from gs_codec.codecs.adaptive.tokens import MAX_BITS, read_pass
from gs_codec.coding.context_rans import PassReader, PassTables
from gs_codec.coding.count_tree import decode_tree
from gs_codec.coding.fields import BitReader, ByteReader
from gs_codec.coding.nearest import Nearest, find_all_nearest
from gs_codec.coding.ycocg import fill_colours, from_ycocg
from gs_codec.egs.file import EgsFile, SectionId
from gs_codec.egs.index import check_centres
from gs_codec.errors import CorruptStream
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.threads import run_all
from gs_codec.scene import SH_COEFFICIENTS, group_rows, sh_bands


def adaptive_sections(sh_degree: int) -> set[SectionId]:
    """Sections that each block has for SH up to a degree."""
    streams = {item.stream for item in passes(SH_COEFFICIENTS[sh_degree])}
    listed = {SectionId.of_stream(stream) for stream in streams}
    return {*listed, SectionId.GEOMETRY, SectionId.STATES, SectionId.LOW_BITS}


def decode_adaptive(
    file: EgsFile,
    spans: dict[int, slice],
    degree: int,
    progress: Progress | None = None,
) -> dict[str, NDArray[np.float32]]:
    """Decode blocks to attribute groups, in stream order.

    `spans` gives each block's range in the result; SH is decoded up to `degree`.
    """
    count = max((span.stop for span in spans.values()), default=0)
    decoder = Blocks(file, degree, count)
    jobs = [partial(decoder.decode, block, span) for block, span in spans.items()]
    run_all(lambda job: job(), jobs, advance=step_counter(progress, "decode", len(jobs)))
    return decoder.groups


class Blocks:
    """Decodes single blocks into `groups`, the planes of `count` Gaussians of an SH degree."""

    def __init__(self, file: EgsFile, degree: int, count: int) -> None:
        self.file = file
        self.lattice, self.models = lattice_of(file)
        self.tables = PassTables.pack(self.models.tables())
        self.coded = SH_COEFFICIENTS[file.header.sh_degree]
        self.kept = SH_COEFFICIENTS[degree]
        rows = group_rows(self.kept)
        self.groups = {group: np.zeros((n, count), np.float32) for group, n in rows.items()}

    def streams(self, block: int, span: slice) -> Streams:
        """What a block is read from, whose Gaussians are in `span`."""
        return Streams(self, block)

    def decode(self, block: int, span: slice) -> None:
        """Fill the groups of a block."""
        where = f"block {block}"
        grid = self.lattice.grid
        tree = self.file.section(SectionId.GEOMETRY, block)
        count = span.stop - span.start
        codes, lefts = decode_tree(tree, count, grid.total_bits, f"geometry of {where}")
        streams = self.streams(block, span)
        most_shapes, most_colours = self.lattice.classes
        shape_class = streams.read_following(
            "shape class", np.zeros_like(codes), np.ones_like(codes)
        )
        _check_range([shape_class], 0, most_shapes, f"{where}: a class")
        colour_class = streams.read(shape_class)
        _check_range([colour_class], 0, most_colours, f"{where}: a class")
        shape = walk_shape(self.lattice, shape_class, streams.read_shape)
        _check_values([shape.opacity, *shape.scales, *shape.turns], where)
        grid_positions = self._grid_positions(block, codes, lefts, shape_class, shape)
        rule = self.lattice.rules["colour"]
        shifts = rule.shifts(colour_class, 1, shape.opacity, shape.scales)
        near = self._decode_dc(streams, grid_positions, shifts, span)
        positions = from_grid(grid_positions, grid)
        check_centres(self.file, block, positions)
        self.groups["positions"][:, span] = positions
        self.groups["opacity"][0, span] = to_float(shape.opacity)
        self.groups["log_scale"][:, span] = to_float(shape.scales)
        self.groups["rot"][:, span] = turned_quaternions(to_float(shape.turns), shape.poles)
        if self.kept:
            self._decode_ac(streams, near, shifts, span)
        streams.finish(whole=self.kept == self.coded)

    def _grid_positions(
        self,
        block: int,
        codes: NDArray[np.int64],
        lefts: NDArray[np.int64],
        classes: NDArray[np.int64],
        shape: Shape,
    ) -> NDArray[np.int64]:
        """Positions in half steps, from the tree's codes and the low bits that are kept."""
        rule = self.lattice.rules["position"]
        dropped = np.minimum(rule.shifts(classes, 3, shape.opacity, shape.scales), lefts)
        where = f"low bits of block {block}"
        bits = BitReader(self.file.section(SectionId.LOW_BITS, block), where)
        codes |= bits.fields(lefts - dropped) << dropped
        bits.close()
        return centres(codes, dropped, self.lattice.grid)

    def _decode_dc(
        self,
        streams: Streams,
        grid_positions: NDArray[np.int64],
        shifts: NDArray[np.int64],
        span: slice,
    ) -> NDArray[np.uint32]:
        """Fill SH-DC; returns the neighbours that SH-AC goes by, and lets go of the others.

        If they were kept, memory that a block has freed would go back to the system each time.
        """
        nearest = find_all_nearest(grid_positions)
        colours = streams.read_colours(nearest, self.lattice.units["sh-dc"], shifts)
        _check_values(colours, f"block {streams.block}")
        self.groups["f_dc"][:, span] = from_ycocg(to_float(colours))
        return two_nearest(nearest)

    def _decode_ac(
        self, streams: Streams, near: NDArray[np.uint32], shifts: NDArray[np.int64], span: slice
    ) -> None:
        where = f"block {streams.block}"
        base = shift_context(shifts, COLOUR_SHIFTS)
        left = streams.read_following("SH sum", base, np.ones_like(base))
        _check_range([left], 0, 1 << MAX_BITS, f"{where}: a sum of SH levels")
        levels = np.zeros((3, self.kept, len(left)), np.int32)
        units = np.empty(self.kept, np.int64)
        bands = sh_bands(self.coded)
        for number, band in enumerate(sh_bands(self.kept), 1):
            sums = left if number == len(bands) else streams.read_share(left, where)
            left = left - sums
            units[list(band)] = self.lattice.units[f"sh{number}"]
            streams.read_band(BandSums.of(sums, near), levels[:, band.start : band.stop])
        rows = self.groups["f_rest"].reshape(3, self.kept, -1)[:, :, span]
        if not fill_colours(levels, units, shifts, TOO_LARGE, rows):
            raise CorruptStream(f"{where}: a value out of range")


class Streams:
    """Reads the passes of a block one after another, and opens the streams that they are in."""

    def __init__(self, blocks: Blocks, block: int) -> None:
        self.file = blocks.file
        self.block = block
        self.models = blocks.models
        self.passes = iter(passes(blocks.coded))
        self.stream = ""
        where = f"block {block}"
        self.reader = PassReader(self.file.section(SectionId.STATES, block), blocks.tables, where)
        self.bits = BitReader(memoryview(b""), where)

    def next_tables(self) -> NDArray[np.int64]:
        """Number of the table of each context of the next pass."""
        item = next(self.passes)
        if item.stream != self.stream:
            self._close()
            self._open(item.stream)
        return self.models.rows(item)

    def read(self, contexts: NDArray[np.int64]) -> NDArray[np.int64]:
        """Levels ``(n,)`` of the next pass, under contexts ``(n,)``."""
        values = np.empty(len(contexts), np.int64)
        self.read_into(contexts, np.arange(len(contexts)), values)
        return values

    def read_into(
        self,
        contexts: NDArray[np.integer],
        indices: NDArray[np.int64],
        values: NDArray[np.integer],
    ) -> None:
        """Read the levels of the next pass into ``values[indices]``."""
        tables = self.next_tables()
        read_pass(self.reader, self.bits, tables, contexts, indices, values)

    def read_following(
        self, name: str, bases: NDArray[np.int64], steps: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Levels ``(n,)`` of the next pass, by the rule of this name; see `read_following`."""
        tables = self.next_tables()
        return read_following(self.reader, self.bits, tables, bases, steps, FOLLOWING[name])

    def read_shape(
        self, name: str, shifts: NDArray[np.int64], unit: int, _poles: NDArray[np.int8] | None
    ) -> NDArray[np.int64]:
        """Levels ``(n,)`` of opacity, a scale or a turn: a `Coder`."""
        if name not in FOLLOWING:
            return self.read(shift_context(shifts))
        return self.read_following(name, shift_context(shifts), unit << shifts)

    def read_colours(
        self, nearest: Nearest, unit: int, shifts: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """SH-DC ``(3, n)`` of the next pass, fixed-point Y, Co, Cg."""
        tables = self.next_tables()
        return decode_colours(nearest, unit, shifts, tables, self.reader, self.bits)

    def read_share(self, left: NDArray[np.int64], where: str) -> NDArray[np.int64]:
        """Sums ``(n,)`` of the next band, of what is left ``(n,)`` for this and the others."""
        sums = np.zeros_like(left)
        some = np.flatnonzero(left > 0)
        self.read_into(sum_context(left[some]), some, sums)
        if np.any((sums < 0) | (sums > left)):
            raise CorruptStream(f"{where}: a band's sum of SH levels out of range")
        return sums

    def read_band(self, sums: BandSums, levels: NDArray[np.int32]) -> None:
        """Fill ``levels (3, k, n)``, 0 before, of a band."""
        planes = [plane for colour in levels for plane in colour]
        for number, plane in enumerate(planes, 1):
            self.read_coefficient(sums, number == len(planes), plane)

    def read_coefficient(self, sums: BandSums, last: bool, levels: NDArray[np.int32]) -> None:
        """Read the levels ``(n,)`` of a coefficient, those that are not 0."""
        tables = self.next_tables()
        read_coefficient(self.reader, self.bits, tables, sums, last, levels)

    def finish(self, whole: bool) -> None:
        """Check that the stream was read to its end; if `whole`, check the final states too."""
        self._close()
        if whole:
            self.reader.finish()

    def _open(self, stream: str) -> None:
        data = self.file.section(SectionId.of_stream(stream), self.block)
        where = f"section '{stream}' of block {self.block}"
        section = ByteReader(data, where)
        self.reader.open(section.take(section.unpack("I")[0]))
        self.bits = BitReader(section.rest(), where)
        self.stream = stream

    def _close(self) -> None:
        """Check that the stream was read to its end."""
        self.reader.close()
        self.bits.close()


def _check_values(fixed: Iterable[NDArray[np.int64]], where: str) -> None:
    limit = int(TOO_LARGE) << FRACTION_BITS
    _check_range(fixed, 1 - limit, limit, f"{where}: a value")


def _check_range(rows: Iterable[NDArray[np.int64]], low: int, end: int, what: str) -> None:
    """Refuse integers below `low`, or not below `end`."""
    for row in rows:
        if row.size and not low <= row.min() <= row.max() < end:
            raise CorruptStream(f"{what} out of range")

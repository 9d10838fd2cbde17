"""Decoder of profiles ``l``, ``m`` and ``s``: stream to scene."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.colour import decode_colours
from gs_codec.codecs.adaptive.contexts import ENERGIES, Pass, passes, sh_channels, shift_context
from gs_codec.codecs.adaptive.lattice import FRACTION_BITS, TOO_LARGE, Lattice, to_float
from gs_codec.codecs.adaptive.positions import centres, from_grid
from gs_codec.codecs.adaptive.section import PassModels, bounds_of, lattice_of
from gs_codec.codecs.adaptive.shape import Shape, walk_shape
from gs_codec.codecs.adaptive.tokens import read_pass
from gs_codec.coding.axes import quaternions
from gs_codec.coding.context_rans import PassReader, PassTables
from gs_codec.coding.count_tree import decode_tree
from gs_codec.coding.fields import BitReader, ByteReader
from gs_codec.coding.ycocg import fill_colours, from_ycocg
from gs_codec.egs.file import EgsFile, SectionId
from gs_codec.errors import CorruptStream
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.threads import run_all
from gs_codec.scene import SH_COEFFICIENTS, group_rows


def lattice_sections(sh_degree: int) -> set[SectionId]:
    """Sections that each block has for SH up to a degree."""
    streams = {item.stream for item in passes(SH_COEFFICIENTS[sh_degree])}
    listed = {SectionId.of_stream(stream) for stream in streams}
    return {*listed, SectionId.GEOMETRY, SectionId.STATES, SectionId.LOW_BITS}


def decode_lattice(
    file: EgsFile,
    spans: dict[int, slice],
    degree: int,
    progress: Progress | None = None,
) -> dict[str, NDArray[np.float32]]:
    """Decode blocks to attribute groups, in stream order.

    `spans` gives each block's range in the result; SH is decoded up to `degree`.
    """
    count = max((span.stop for span in spans.values()), default=0)
    decoder = LatticeDecoder.of(file, degree, count)
    jobs = [partial(decoder.decode, block, span.start, span.stop) for block, span in spans.items()]
    run_all(lambda job: job(), jobs, advance=step_counter(progress, "decode", len(jobs)))
    return decoder.groups


def block_boxes(file: EgsFile) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lowest and highest x, y, z of the centres of each block, each ``(blocks, 3)``."""
    lattice, _ = lattice_of(file)
    boxes = bounds_of(file)
    # Rounded to float32, as decoded positions are.
    corners = [
        from_grid(part.T, np.array(lattice.grid.origin), lattice.grid.step).T.astype(np.float64)
        for part in (boxes[:, :3], boxes[:, 3:])
    ]
    return corners[0], corners[1]


@dataclass(frozen=True)
class LatticeDecoder:
    """Decodes single blocks into the attribute groups of a scene.

    ``coefficients`` is the number of coded SH-AC coefficients of a colour, of which ``kept`` are
    decoded; ``boxes`` are the blocks' bounds, in half steps of the grid.
    """

    file: EgsFile
    lattice: Lattice
    models: PassModels
    tables: PassTables
    coefficients: int
    kept: int
    boxes: NDArray[np.int64]
    groups: dict[str, NDArray[np.float32]]

    @classmethod
    def of(cls, file: EgsFile, sh_degree: int, count: int) -> LatticeDecoder:
        """Read lattices and tables, and allocate `count` Gaussians of an SH degree."""
        coefficients = SH_COEFFICIENTS[file.header.sh_degree]
        lattice, models = lattice_of(file)
        kept = SH_COEFFICIENTS[sh_degree]
        groups = {g: np.zeros((n, count), np.float32) for g, n in group_rows(kept).items()}
        tables = PassTables.pack(models.tables())
        return cls(file, lattice, models, tables, coefficients, kept, bounds_of(file), groups)

    def decode(self, block: int, start: int, stop: int) -> None:
        """Fill the groups of a block."""
        where = f"block {block}"
        grid = self.lattice.grid
        tree = self.file.section(SectionId.GEOMETRY, block)
        codes, lefts = decode_tree(tree, stop - start, grid.total_bits, f"geometry of {where}")
        streams = _Streams(self, block)
        streams.open("classes")
        shape_class = self._classes(streams.read(np.zeros_like(codes)), 0, where)
        colour_class = self._classes(streams.read(shape_class), 1, where)
        shape = walk_shape(self.lattice, shape_class, streams.read_attribute)
        _check_range([shape.opacity, *shape.scales, *shape.vectors], where)
        grid_positions = self._grid_positions(block, codes, lefts, shape_class, shape)
        rule = self.lattice.rules["colour"]
        shifts = rule.shifts(colour_class, 1, shape.opacity, shape.scales)
        streams.open("sh-dc")
        colours = streams.read_colours(grid_positions, shifts)
        _check_range(colours, where)
        span = slice(start, stop)
        origin = np.array(grid.origin)
        self.groups["positions"][:, span] = from_grid(grid_positions, origin, grid.step)
        self.groups["f_dc"][:, span] = from_ycocg(to_float(colours))
        self.groups["opacity"][0, span] = to_float(shape.opacity)
        self.groups["log_scale"][:, span] = to_float(shape.scales)
        self.groups["rot"][:, span] = quaternions(to_float(shape.vectors))
        if self.kept:
            self._decode_ac(streams, shifts, span, where)
        streams.finish(whole=self.kept == self.coefficients)

    def _classes(self, levels: NDArray[np.int64], kind: int, where: str) -> NDArray[np.int64]:
        if levels.size and not 0 <= levels.min() <= levels.max() < self.lattice.classes[kind]:
            raise CorruptStream(f"{where}: a class out of range")
        return levels

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
        grid_positions = centres(codes, dropped, self.lattice.grid.bits)
        if np.any(self.boxes[block] != [*grid_positions.min(axis=1), *grid_positions.max(axis=1)]):
            raise CorruptStream(f"section 'bounds': does not match block {block}")
        return grid_positions

    def _decode_ac(
        self, streams: _Streams, shifts: NDArray[np.int64], span: slice, where: str
    ) -> None:
        streams.open("sh1")
        energy = streams.read(shift_context(shifts))
        if energy.size and not 0 <= energy.min() <= energy.max() < len(ENERGIES):
            raise CorruptStream(f"{where}: an SH energy out of range")
        some = np.flatnonzero(energy)
        context = energy[some].astype(np.uint8)
        levels = np.zeros((3, self.kept, len(energy)), np.int32)
        units = np.empty(self.kept, np.int64)
        for band, colour, k in sh_channels(self.kept):
            streams.open(f"sh{band}")
            units[k] = self.lattice.units[f"sh{band}"]
            streams.read_into(context, some, levels[colour, k])
        rows = self.groups["f_rest"].reshape(3, self.kept, -1)[:, :, span]
        if not fill_colours(levels, units, shifts, TOO_LARGE, rows):
            raise CorruptStream(f"{where}: a value out of range")


class _Streams:
    """Reads the streams of a block, pass after pass."""

    def __init__(self, decoder: LatticeDecoder, block: int) -> None:
        self.decoder = decoder
        self.block = block
        self.where = f"block {block}"
        states = decoder.file.section(SectionId.STATES, block)
        self.reader = PassReader(states, decoder.tables, self.where)
        self.bits = BitReader(memoryview(b""), self.where)
        self.stream = ""
        self.passes: list[Pass] = passes(decoder.coefficients)
        self.next = 0

    def open(self, stream: str) -> None:
        """Open a stream, after a check that the one before was read to its end."""
        if stream == self.stream:
            return
        self._close()
        where = f"section '{stream}' of {self.where}"
        data = self.decoder.file.section(SectionId.of_stream(stream), self.block)
        section = ByteReader(data, where)
        self.reader.open(section.take(section.unpack("I")[0]))
        self.bits = BitReader(section.rest(), where)
        self.stream = stream

    def _close(self) -> None:
        if self.stream:
            self.reader.close()
            self.bits.close()

    def _rows(self) -> NDArray[np.int64]:
        """Number of the table of each context of the next pass."""
        self.open(self.passes[self.next].stream)
        self.next += 1
        return self.decoder.models.rows[self.next - 1]

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
        rows = self._rows()
        read_pass(self.reader, self.bits, rows, contexts, indices, values)

    def read_attribute(self, name: str, shifts: NDArray[np.int64]) -> NDArray[np.int64]:
        """Levels of an attribute of the shape."""
        return self.read(shift_context(shifts))

    def read_colours(
        self, grid_positions: NDArray[np.int64], shifts: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Fixed-point SH-DC ``(3, n)``."""
        rows = self._rows()
        unit = self.decoder.lattice.units["sh-dc"]
        return decode_colours(grid_positions, unit, shifts, rows, self.reader, self.bits)

    def finish(self, whole: bool) -> None:
        """Check that the stream was read to its end; if `whole`, check the final states too."""
        self._close()
        if whole:
            self.reader.finish()


def _check_range(values, where: str) -> None:
    limit = int(TOO_LARGE) << FRACTION_BITS
    for row in values:
        if row.size and not -limit < row.min() <= row.max() < limit:
            raise CorruptStream(f"{where}: a value out of range")

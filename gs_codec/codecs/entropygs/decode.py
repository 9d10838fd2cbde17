"""Decoder of profiles ``paper-*``, which code channel by channel."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.entropygs.gpcc import Tmc3, decode_gpcc, is_gpcc
from gs_codec.codecs.entropygs.section import RANS_STREAMS, Channel, channels_of
from gs_codec.codecs.entropygs.symbols import triple_depths
from gs_codec.codecs.entropygs.torchac_coder import decode_stream, is_torchac
from gs_codec.coding.count_tree import decode_geometry
from gs_codec.coding.frequency_table import FrequencyTable
from gs_codec.coding.morton import decode_morton
from gs_codec.coding.predicted_colour import decode_colour
from gs_codec.coding.quantise import dequantise
from gs_codec.coding.rans import TableSet, decode_symbols
from gs_codec.egs.egs_file import EgsFile, SectionId
from gs_codec.egs.index import check_centres
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.threads import run_all
from gs_codec.scene import SH_COEFFICIENTS, group_rows

_POINTS = {SectionId.GEOMETRY, SectionId.SH_DC}


def channel_sections(file: EgsFile) -> set[SectionId]:
    """Sections of each block: those of streams with at least one varying channel."""
    streams = {channel.stream for channel in channels_of(file) if channel.quantiser.depth}
    expected = {SectionId.of_stream(stream) for stream in streams}
    if streams & set(RANS_STREAMS) and not is_torchac(file):
        expected.add(SectionId.STATES)
    if is_gpcc(file) and expected & _POINTS:
        expected = expected - _POINTS | {SectionId.GPCC}
    return expected


def scene_sections(file: EgsFile, expected: set[SectionId]) -> set[SectionId]:
    """Sections of the whole scene that accompany the block sections `expected`."""
    sections = {SectionId.CHANNELS}
    if SectionId.GPCC in expected:
        sections.add(SectionId.TOOL)
    if is_torchac(file) and expected & {SectionId.of_stream(stream) for stream in RANS_STREAMS}:
        sections.add(SectionId.CODER)
    return sections


def _decode_cells(file: EgsFile, axes: list[Channel], block: int) -> NDArray[np.uint32]:
    """Symbols of positions ``(3, n)``."""
    depths = triple_depths([axis.quantiser for axis in axes])
    start, stop = file.header.block_range(block)
    codes = np.zeros(stop - start, np.int64)
    if sum(depths):
        data = file.section(SectionId.GEOMETRY, block)
        codes = decode_geometry(data, codes.size, sum(depths), f"geometry of block {block}")
    return decode_morton(codes, depths)


def decode_channels(
    file: EgsFile,
    spans: dict[int, slice],
    degree: int,
    progress: Progress | None = None,
    tool: Tmc3 | None = None,
) -> dict[str, NDArray[np.float32]]:
    """Decode blocks to attribute groups, in stream order.

    `spans` gives each block's range in the result; SH is decoded up to `degree`. `tool` decodes
    points coded by G-PCC.
    """
    count = max((span.stop for span in spans.values()), default=0)
    decoder = _Blocks(file, degree, count, tool)
    stages = decoder.stages()
    jobs = [
        partial(stage, block, span.start, span.stop)
        for block, span in spans.items()
        for stage in stages
    ]
    run_all(lambda job: job(), jobs, advance=step_counter(progress, "decode", len(jobs)))
    return decoder.groups


class _Blocks:
    """Decodes single blocks into `groups`, the planes of `count` Gaussians of an SH degree.

    For each varying attribute channel, ``varying`` has the stream, the plane ``(N,)`` and the
    values of its symbols, and ``tables`` the frequency table.
    """

    def __init__(self, file: EgsFile, degree: int, count: int, tool: Tmc3 | None) -> None:
        kept, coded = SH_COEFFICIENTS[degree], SH_COEFFICIENTS[file.header.sh_degree]
        self.file = file
        self.tool = tool
        self.whole = kept == coded
        self.groups = {g: np.empty((n, count), np.float32) for g, n in group_rows(kept).items()}
        channels = channels_of(file)
        self.points = channels[:6]
        self.varying: list[tuple[str, NDArray[np.float32], NDArray[np.float32]]] = []
        self.tables: list[FrequencyTable] = []
        for channel in channels:
            row = channel.index
            if channel.group == "f_rest":
                colour, coefficient = divmod(row, coded)
                if coefficient >= kept:
                    continue
                row = colour * kept + coefficient
            plane = self.groups[channel.group][row]
            if not channel.quantiser.depth:
                plane[:] = channel.quantiser.origin
            elif channel.model is not None:
                levels = dequantise(np.arange(channel.alphabet), channel.quantiser)
                self.varying.append((channel.stream, plane, levels))
                self.tables.append(channel.model.frequencies(channel.alphabet))
        self.packed = TableSet.pack(self.tables)

    def stages(self) -> list[Callable[[int, int, int], None]]:
        """The functions that decode a block."""
        return (
            [self.decode_points, self.decode_attributes] if self.varying else [self.decode_points]
        )

    def decode_points(self, block: int, start: int, stop: int) -> None:
        """Fill positions and f_dc of a block."""
        planes = (*self.groups["positions"], *self.groups["f_dc"])
        symbols = self._symbols_of_points(block)
        for channel, plane, row in zip(self.points, planes, symbols, strict=False):
            if channel.quantiser.depth:
                plane[start:stop] = dequantise(row, channel.quantiser)
        check_centres(self.file, block, self.groups["positions"][:, start:stop])

    def _symbols_of_points(self, block: int) -> list[NDArray]:
        """Symbols of x, y, z and, unless all are constant, of f_dc of a block."""
        if self.tool is not None:
            cells, colours = decode_gpcc(self.file, self.tool, self.points, block)
            return [*cells, *colours]
        cells = _decode_cells(self.file, self.points[:3], block)
        depths = triple_depths([channel.quantiser for channel in self.points[3:]])
        if not sum(depths):
            return [*cells]
        data = self.file.section(SectionId.SH_DC, block)
        return [*cells, *decode_colour(data, cells, depths, f"sh-dc of block {block}")]

    def decode_attributes(self, block: int, start: int, stop: int) -> None:
        """Fill the modelled channels of a block."""
        by_coder = self._by_torchac if is_torchac(self.file) else self._by_rans
        symbols = by_coder(block, stop - start)
        for row, (_, plane, levels) in zip(symbols, self.varying, strict=True):
            np.take(levels, row, out=plane[start:stop], mode="clip")

    def _streams(self, block: int) -> list[tuple[int, memoryview]]:
        """Number of channels and section of each varying stream."""
        streams = [stream for stream, *_ in self.varying]
        return [
            (streams.count(stream), self.file.section(SectionId.of_stream(stream), block))
            for stream in RANS_STREAMS
            if stream in streams
        ]

    def _by_rans(self, block: int, count: int) -> NDArray[np.uint16]:
        states = self.file.section(SectionId.STATES, block)
        where, streams = f"block {block}", self._streams(block)
        return decode_symbols(states, streams, count, self.packed, where, self.whole)

    def _by_torchac(self, block: int, count: int) -> list[NDArray[np.uint16]]:
        rows: list[NDArray[np.uint16]] = []
        for number, data in self._streams(block):
            tables = self.tables[len(rows) : len(rows) + number]
            rows += decode_stream(data, count, tables, f"block {block}")
        return rows

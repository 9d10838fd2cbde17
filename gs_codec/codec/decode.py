"""Stream to scene."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gs_codec.codec.lossless import decode_lossless
from gs_codec.codec.order import triple_depths
from gs_codec.config import LOSSLESS
from gs_codec.container.carried import read_comments, read_extra
from gs_codec.container.channels import RANS_STREAMS, Channel, read_channels
from gs_codec.container.file import SCENE_SECTIONS, EgsFile, Header, SectionId, read_file
from gs_codec.entropy.rans import TableSet, decode_symbols
from gs_codec.errors import CorruptStream
from gs_codec.geometry.colour import decode_colour
from gs_codec.geometry.count_tree import decode_geometry
from gs_codec.quantise import dequantise
from gs_codec.report import Progress, step_counter
from gs_codec.scene import GROUPS, SH_COEFFICIENTS, Scene
from gs_codec.transform.morton import decode_morton
from gs_codec.workers import run_all

#: A stream may decode to this many bytes, or to `EXPANSION` times its size if that is more.
DECODED_BYTES = 1 << 30
EXPANSION = 1000


def decode_scene(
    data: bytes | memoryview,
    threads: int | None = None,
    max_bytes: int | None = None,
    progress: Progress | None = None,
) -> Scene:
    """Decode an `.egs` stream.

    Parameters
    ----------
    data : bytes
    threads : int, optional
    max_bytes : int, optional
        Refuse a stream whose floats would be larger; by default `DECODED_BYTES` or
        `EXPANSION` times the stream's size, whichever is more.
    progress : callable, optional
        Called as ``progress(stage, done, total)`` from the calling thread.

    Returns
    -------
    Scene
        In the order of the stream.

    Raises
    ------
    CorruptStream, TruncatedStream, UnsupportedVersion
    """
    file = read_file(data)
    header = file.header
    limit = max(DECODED_BYTES, EXPANSION * len(data)) if max_bytes is None else max_bytes
    _check_size(header, limit)
    if header.profile == LOSSLESS:
        return _assemble(file, decode_lossless(file, threads, progress))
    channels = read_channels(file.section(SectionId.CHANNELS), SH_COEFFICIENTS[header.sh_degree])
    _check_expected(file, channels)
    blocks = _Blocks.of(file, channels)
    jobs = [
        partial(stage, block, *header.block_range(block))
        for block in range(header.block_count)
        for stage in (blocks.decode_points, blocks.decode_attributes)
    ]
    run_all(lambda job: job(), jobs, threads, step_counter(progress, "decode", len(jobs)))
    return _assemble(file, blocks.groups)


def _check_size(header: Header, limit: int) -> None:
    if header.float_bytes > limit:
        raise CorruptStream(
            f"header: {header.count} Gaussians are {header.float_bytes} bytes, the limit is {limit}"
        )


def _check_expected(file: EgsFile, channels: list[Channel]) -> None:
    """Refuse a file whose block sections are not exactly those its channels need."""
    streams = {channel.stream for channel in channels if channel.quantiser.depth}
    expected = {SectionId.of_stream(stream) for stream in streams}
    if streams & set(RANS_STREAMS):
        expected.add(SectionId.STATES)
    found = [place for place in file.sections if place[0] not in SCENE_SECTIONS - {SectionId.BOX}]
    for section_id, block in found:
        if section_id not in expected:
            label = SectionId(section_id).label
            raise CorruptStream(f"section '{label}' of block {block}: nothing is coded there")
    if len(found) != len(expected) * file.header.block_count:
        needed = len(expected) * file.header.block_count
        raise CorruptStream(f"header: {len(found)} sections of blocks, expected {needed}")


def _assemble(file: EgsFile, groups: dict[str, NDArray[np.float32]]) -> Scene:
    """The scene of the decoded groups, and what the file carries beside them."""
    comments = file.sections.get((SectionId.COMMENTS, 0))
    extra = file.sections.get((SectionId.EXTRA, 0))
    return Scene(
        **groups,
        has_normals=file.header.has_normals,
        comments=() if comments is None else read_comments(comments),
        extra={} if extra is None else read_extra(extra, file.header.count),
    )


@dataclass(frozen=True)
class _Blocks:
    """Decoder of single blocks into the planes of a scene.

    ``planes`` holds the plane ``(N,)`` of each channel, a row of the arrays in ``groups``;
    ``varying``, ``tables`` and ``levels`` are of the channels that rANS codes.
    """

    file: EgsFile
    channels: list[Channel]
    groups: dict[str, NDArray[np.float32]]
    planes: list[NDArray[np.float32]]
    varying: list[int]
    tables: TableSet
    levels: list[NDArray[np.float32]]

    @classmethod
    def of(cls, file: EgsFile, channels: list[Channel]) -> _Blocks:
        """Set up tables and constant planes."""
        members = Counter(channel.group for channel in channels)
        groups = {g: np.empty((members[g], file.header.count), np.float32) for g in GROUPS}
        planes = [groups[channel.group][channel.index] for channel in channels]
        varying, tables, levels = [], [], []
        for row, channel in enumerate(channels):
            if not channel.quantiser.depth:
                planes[row][:] = channel.quantiser.origin
            elif channel.model is not None:
                varying.append(row)
                tables.append(channel.model.frequencies(channel.alphabet))
                levels.append(dequantise(np.arange(channel.alphabet), channel.quantiser))
        return cls(file, channels, groups, planes, varying, TableSet.pack(tables), levels)

    def decode_points(self, block: int, start: int, stop: int) -> None:
        """Fill positions and f_dc of a block."""
        quantisers = [channel.quantiser for channel in self.channels]
        depths = triple_depths(quantisers[:3])
        codes = np.zeros(stop - start, np.int64)
        if sum(depths):
            data = self.file.section(SectionId.GEOMETRY, block)
            codes = decode_geometry(data, codes.size, sum(depths), f"geometry of block {block}")
        cells = decode_morton(codes, depths)
        colour_depths = triple_depths(quantisers[3:6])
        symbols = [*cells]
        if sum(colour_depths):
            data = self.file.section(SectionId.SH_DC, block)
            symbols += [*decode_colour(data, cells, colour_depths, f"sh-dc of block {block}")]
        for row, plane in enumerate(symbols):
            if quantisers[row].depth:
                self.planes[row][start:stop] = dequantise(plane, quantisers[row])

    def decode_attributes(self, block: int, start: int, stop: int) -> None:
        """Fill everything else of a block."""
        if not self.varying:
            return
        streams = [self.channels[row].stream for row in self.varying]
        groups = [
            (streams.count(stream), self.file.section(SectionId.of_stream(stream), block))
            for stream in RANS_STREAMS
            if stream in streams
        ]
        states = self.file.section(SectionId.STATES, block)
        symbols = decode_symbols(states, groups, stop - start, self.tables, f"block {block}")
        for plane, levels, row in zip(symbols, self.levels, self.varying, strict=True):
            np.take(levels, plane, out=self.planes[row][start:stop], mode="clip")

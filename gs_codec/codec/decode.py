"""Stream to scene."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gs_codec.codec.lattice_decode import block_boxes, decode_lattice, lattice_sections
from gs_codec.codec.lossless import block_sections, decode_lossless
from gs_codec.codec.order import triple_depths
from gs_codec.codec.part import Part
from gs_codec.config import LATTICE_PROFILES, LOSSLESS
from gs_codec.container.carried import read_comments, read_extra
from gs_codec.container.channels import RANS_STREAMS, Channel, read_channels
from gs_codec.container.file import (
    DESCRIPTIONS,
    SCENE_SECTIONS,
    EgsFile,
    Header,
    SectionId,
    read_file,
)
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
    """Decode an `.egs` stream; see `decode_part`."""
    return decode_part(data, Part(), threads, max_bytes, progress)[0]


def decode_part(
    data: bytes | memoryview,
    part: Part,
    threads: int | None = None,
    max_bytes: int | None = None,
    progress: Progress | None = None,
) -> tuple[Scene, int]:
    """Decode a part of an `.egs` stream.

    SH above the part's degree is not read and, in profiles `l`, `m` and `s`, neither are blocks
    that have nothing in its box.

    Parameters
    ----------
    data : bytes
    part : Part
    threads : int, optional
    max_bytes : int, optional
        Refuse a stream whose floats would be larger; by default `DECODED_BYTES` or
        `EXPANSION` times the stream's size, whichever is more.
    progress : callable, optional
        Called as ``progress(stage, done, total)`` from the calling thread.

    Returns
    -------
    scene : Scene
        In the order of the stream.
    bytes_read : int

    Raises
    ------
    CorruptStream, TruncatedStream, UnsupportedVersion
    """
    described = read_file(data, lambda section, _: section in DESCRIPTIONS)
    header = described.header
    limit = max(DECODED_BYTES, EXPANSION * len(data)) if max_bytes is None else max_bytes
    _check_size(header, limit)
    degree = part.degree_of(header.sh_degree)
    blocks = _chosen_blocks(described, part)
    chosen = blocks if isinstance(blocks, range) else frozenset(blocks)
    unread = {SectionId.of_stream(f"sh{band}") for band in range(degree + 1, 4)}
    file = read_file(
        data,
        lambda section, block: (
            section not in unread and (section in SCENE_SECTIONS or int(block) in chosen)
        ),
    )
    if header.profile == LOSSLESS:
        _check_sections(file, {SectionId.BOX}, set(block_sections(header.sh_degree)))
        groups = decode_lossless(file, _spans(header, blocks), degree, threads, progress)
    elif header.profile in LATTICE_PROFILES:
        own = {SectionId.LATTICE, SectionId.BOUNDS} if header.count else {SectionId.LATTICE}
        _check_sections(file, own, lattice_sections(header.sh_degree))
        groups = decode_lattice(file, _spans(header, blocks), degree, threads, progress)
    else:
        groups = _decode_channels(file, blocks, degree, threads, progress)
    scene = _assemble(file, groups, blocks)
    if part.box is not None:
        scene = scene.take(part.contains(scene.positions))
    return scene, file.bytes_read


def _chosen_blocks(file: EgsFile, part: Part) -> Sequence[int]:
    """Blocks that may have something in the part's box."""
    every = range(file.header.block_count)
    if part.box is None or file.header.profile not in LATTICE_PROFILES or not every:
        return every
    return np.flatnonzero(part.meets(*block_boxes(file))).tolist()


def _spans(header: Header, blocks: Sequence[int]) -> dict[int, slice]:
    """Where the Gaussians of chosen blocks go."""
    spans, end = {}, 0
    for block in blocks:
        start, stop = header.block_range(block)
        spans[block] = slice(end, end + stop - start)
        end += stop - start
    return spans


def _decode_channels(
    file: EgsFile,
    blocks: Sequence[int],
    degree: int,
    threads: int | None,
    progress: Progress | None,
) -> dict[str, NDArray[np.float32]]:
    channels = read_channels(
        file.section(SectionId.CHANNELS), SH_COEFFICIENTS[file.header.sh_degree]
    )
    _check_expected(file, channels)
    decoder = _Blocks.of(file, channels, degree)
    jobs = [
        partial(stage, block, span.start, span.stop)
        for block, span in _spans(file.header, blocks).items()
        for stage in (decoder.decode_points, decoder.decode_attributes)
    ]
    run_all(lambda job: job(), jobs, threads, step_counter(progress, "decode", len(jobs)))
    return decoder.groups


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
    _check_sections(file, {SectionId.CHANNELS}, expected)


def _check_sections(file: EgsFile, own: set[SectionId], expected: set[SectionId]) -> None:
    """Refuse a file that has not exactly a profile's `own` sections, and those of blocks."""
    for section_id, block in file.sizes:
        if section_id not in set(SectionId) - own - {SectionId.COMMENTS, SectionId.EXTRA}:
            continue
        if section_id not in expected:
            label = SectionId(section_id).label
            raise CorruptStream(f"section '{label}' of block {block}: nothing is coded there")
    found = sum(section_id in expected for section_id, _ in file.sizes)
    if found != len(expected) * file.header.block_count:
        needed = len(expected) * file.header.block_count
        raise CorruptStream(f"header: {found} sections of blocks, expected {needed}")


def _assemble(
    file: EgsFile, groups: dict[str, NDArray[np.float32]], blocks: Sequence[int]
) -> Scene:
    """The scene of the decoded groups, and what the file carries beside them."""
    comments = file.sections.get((SectionId.COMMENTS, 0))
    extra = file.sections.get((SectionId.EXTRA, 0))
    return Scene(
        **groups,
        has_normals=file.header.has_normals,
        comments=() if comments is None else read_comments(comments),
        extra={} if extra is None else _of_blocks(extra, file.header, blocks),
    )


def _of_blocks(extra: memoryview, header: Header, blocks: Sequence[int]) -> dict[str, NDArray]:
    """Extra properties of the Gaussians of chosen blocks."""
    columns = read_extra(extra, header.count)
    if len(blocks) == header.block_count:
        return columns
    ranges = [np.arange(*header.block_range(block)) for block in blocks]
    index = np.concatenate([np.zeros(0, np.int64), *ranges])
    return {name: column[index] for name, column in columns.items()}


@dataclass(frozen=True)
class _Blocks:
    """Decoder of single blocks into the planes of a scene.

    ``planes`` holds the plane ``(N,)`` of each channel, a row of the arrays in ``groups``;
    ``varying``, ``tables`` and ``levels`` are of the channels that rANS codes, `whole` tells
    whether those are all that were coded.
    """

    file: EgsFile
    channels: list[Channel]
    groups: dict[str, NDArray[np.float32]]
    planes: list[NDArray[np.float32]]
    varying: list[int]
    tables: TableSet
    levels: list[NDArray[np.float32]]
    whole: bool

    @classmethod
    def of(cls, file: EgsFile, channels: list[Channel], degree: int) -> _Blocks:
        """Set up tables and constant planes for SH up to a degree."""
        kept, coded = SH_COEFFICIENTS[degree], SH_COEFFICIENTS[file.header.sh_degree]
        channels = [
            replace(c, index=c.index // coded * kept + c.index % coded)
            if c.group == "f_rest"
            else c
            for c in channels
            if c.group != "f_rest" or c.index % coded < kept
        ]
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
        packed = TableSet.pack(tables)
        return cls(file, channels, groups, planes, varying, packed, levels, kept == coded)

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
        where = f"block {block}"
        symbols = decode_symbols(states, groups, stop - start, self.tables, where, self.whole)
        for plane, levels, row in zip(symbols, self.levels, self.varying, strict=True):
            np.take(levels, plane, out=self.planes[row][start:stop], mode="clip")

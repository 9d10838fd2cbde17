"""Profile ``lossless``: scene to sections and back, bit-exactly. FORMAT.md, "Lossless"."""

from __future__ import annotations

import sys
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.lossless.columns import (
    TRIED,
    Bits,
    read_guided,
    read_mask,
    read_quaternions,
    read_stack,
    to_ordered,
    write_guided,
    write_mask,
    write_quaternions,
    write_stack,
)
from gs_codec.coding.extent import block_extent
from gs_codec.coding.fields import ByteReader
from gs_codec.coding.morton import encode_morton, find_ties, in_stream_order
from gs_codec.config import SH_STREAMS, Config
from gs_codec.egs.egs_file import EgsFile, Section, SectionId
from gs_codec.egs.header import Header
from gs_codec.egs.index import check_centres, index_section
from gs_codec.egs.sections import pack_scene
from gs_codec.errors import CorruptStream
from gs_codec.report import EncodeReport, Progress, StageTimes, step_counter
from gs_codec.runtime.threads import run_all
from gs_codec.scene import (
    GROUPS,
    SH_COEFFICIENTS,
    Scene,
    group_rows,
    sh_bands,
    take_columns,
)

#: Attribute group of each section, except those of SH-AC.
_GROUP_OF = {
    SectionId.GEOMETRY: "positions",
    SectionId.SH_DC: "f_dc",
    SectionId.OPACITY: "opacity",
    SectionId.SCALING: "log_scale",
    SectionId.ROTATION: "rot",
}

#: SH-AC coefficients of each band.
_BANDS = {
    SectionId.of_stream(stream): slice(band.start, band.stop)
    for stream, band in zip(SH_STREAMS, sh_bands(), strict=True)
}

#: Exceptions to `TRIED` in larger blocks: none where differences of consecutive Gaussians do not
#: pay, all where a few values often mislead.
_TRIED = {SectionId.OPACITY: 0, SectionId.SH2: 0, SectionId.SH3: 0, SectionId.SH_DC: sys.maxsize}

#: Green is coded first, because it predicts red and blue best.
_RED, _GREEN, _BLUE = range(3)


def lossless_sections(sh_degree: int) -> list[SectionId]:
    """Sections of each block."""
    return [*_GROUP_OF, *list(_BANDS)[:sh_degree]]


def encode_lossless(
    scene: Scene, config: Config, times: StageTimes, progress: Progress | None = None
) -> tuple[list[bytes | memoryview], EncodeReport]:
    """Encode a scene cleaned by `clean_scene`, bit-exactly."""
    with times.stage("order"):
        if config.keep_order:
            order = np.arange(scene.count)
        else:
            scene, order = in_stream_order(scene, lossless_order(scene))
    header = Header.of(scene, config)
    with times.stage("code"):
        extents = run_all(
            lambda block: _extent(scene, order[slice(*header.block_range(block))]),
            range(header.block_count),
        )
        sections = [*index_section(extents), *_encode_blocks(scene, header, order, progress)]
    return pack_scene(scene, header, sections, order, times)


def decode_lossless(
    file: EgsFile,
    spans: dict[int, slice],
    degree: int,
    progress: Progress | None = None,
) -> dict[str, NDArray[np.float32]]:
    """Decode blocks to attribute groups, in stream order.

    `spans` gives each block's range in the result; SH is decoded up to `degree`. Raises
    CorruptStream or TruncatedStream.
    """
    rows = group_rows(SH_COEFFICIENTS[degree])
    count = max((span.stop for span in spans.values()), default=0)
    planes = {group: np.empty((number, count), np.uint32) for group, number in rows.items()}
    jobs = [
        partial(_decode_section, file, planes, section_id, block, span)
        for block, span in spans.items()
        for section_id in lossless_sections(degree)
    ]
    run_all(lambda job: job(), jobs, advance=step_counter(progress, "decode", len(jobs)))
    return {group: plane.view(np.float32) for group, plane in planes.items()}


def lossless_order(scene: Scene) -> NDArray[np.int64]:
    """Stream order of a scene: the order of Morton codes of all 32 bits of each coordinate.

    Any float can be sorted, including NaN. Gaussians at the same position are sorted by their other
    attributes; only Gaussians that are identical in every bit keep the order of the input.
    """
    ordered = to_ordered(scene.positions.view(np.uint32))
    high = encode_morton(ordered >> np.uint32(11), (21, 21, 21))
    low = encode_morton(ordered & np.uint32(0x7FF), (11, 11, 11))
    order = np.lexsort((low, high))
    tied = find_ties(high[order], low[order])
    ties = np.sort(order[tied])
    others = [getattr(scene, group) for group in GROUPS if group != "positions"]
    rows = [row for plane in others for row in plane[:, ties].view(np.uint32)]
    order[tied] = ties[np.lexsort((*rows, low[ties], high[ties]))]
    return order


def _extent(scene: Scene, members: NDArray[np.int64]) -> NDArray[np.float32]:
    """Bounding boxes of the Gaussians of a block."""
    planes = scene.positions, scene.log_scale, scene.rot
    return block_extent(*(take_columns(plane, members) for plane in planes))


def _encode_blocks(
    scene: Scene,
    header: Header,
    order: NDArray[np.int64],
    progress: Progress | None,
) -> list[Section]:
    """Sections of all blocks, block by block."""
    colours = scene.f_rest.view(np.uint32).reshape(3, len(scene.f_rest) // 3, scene.count)
    there = np.stack(run_all(partial(np.any, axis=0), colours))

    def encode(section_id: SectionId, block: int) -> Section:
        members = order[slice(*header.block_range(block))]
        if section_id in _BANDS:
            columns = colours[:, _BANDS[section_id]]
            data = _encode_band(
                section_id, take_columns(columns, members), take_columns(there, members)
            )
        else:
            columns = getattr(scene, _GROUP_OF[section_id]).view(np.uint32)
            data = _encode_section(section_id, take_columns(columns, members))
        return Section.kept(section_id, block, data)

    jobs = [
        partial(encode, section_id, block)
        for block in range(header.block_count)
        for section_id in lossless_sections(header.sh_degree)
    ]
    return run_all(lambda job: job(), jobs, advance=step_counter(progress, "code", len(jobs)))


def _tried(section_id: SectionId, count: int) -> int:
    """Number of values to code both ways in a block of `count` Gaussians."""
    return TRIED if count <= TRIED else _TRIED.get(section_id, TRIED)


def _encode_section(section_id: SectionId, columns: Bits) -> bytes:
    """The section of a block, except SH-AC, given the columns ``(C, n)`` of its attribute."""
    tried = _tried(section_id, columns.shape[1])
    if section_id == SectionId.SH_DC:
        return _encode_colours(columns[:, None], np.ones(columns.shape, bool), tried)
    write = write_quaternions if section_id == SectionId.ROTATION else write_stack
    return write(columns, tried)


def _encode_band(section_id: SectionId, band: Bits, there: NDArray[np.bool_]) -> bytes:
    """Code a band of SH-AC ``(3, C, n)``; band 1 includes the mask of present colours.

    ``there (3, n)`` marks the colours whose SH-AC, of all bands, are not all zero.
    """
    mask = b""
    if section_id == SectionId.SH1:
        mask = write_mask(np.packbits(there, axis=0, bitorder="little")[0].astype(np.uint32))
    return mask + _encode_colours(band, there, _tried(section_id, band.shape[2]))


def _encode_colours(colours: Bits, there: NDArray[np.bool_], tried: int) -> bytes:
    """Code coefficients ``(3, C, n)``; ``there (3, n)`` marks the colours that are not all zero."""
    green = colours[_GREEN]
    parts = [write_stack(green[:, there[_GREEN]], tried)]
    for c in (_RED, _BLUE):
        parts.append(write_guided(colours[c][:, there[c]], green[:, there[c]], tried))
    return b"".join(parts)


def _decode_section(
    file: EgsFile, planes: dict[str, Bits], section_id: SectionId, block: int, span: slice
) -> None:
    """Decode a section into its planes."""
    reader = _reader(file, section_id, block)
    target = planes[_GROUP_OF.get(section_id, "f_rest")][:, span]
    count = target.shape[1]
    if section_id in _BANDS:
        first = section_id == SectionId.SH1
        mask = read_mask(reader if first else _reader(file, SectionId.SH1, block), count, 7)
        there = (mask >> np.arange(3, dtype=np.uint32)[:, None] & 1).astype(bool)
        _decode_colours(reader, there, target.reshape(3, -1, count)[:, _BANDS[section_id]])
    elif section_id == SectionId.SH_DC:
        _decode_colours(reader, np.ones(target.shape, bool), target[:, None])
    elif section_id == SectionId.ROTATION:
        target[:] = read_quaternions(reader, count)
    else:
        target[:] = read_stack(reader, target.shape)
    if section_id == SectionId.GEOMETRY:
        check_centres(file, block, target.view(np.float32))
    if len(reader.rest()):
        raise CorruptStream(f"{reader.where}: bytes after the last value")


def _reader(file: EgsFile, section_id: SectionId, block: int) -> ByteReader:
    where = f"section '{section_id.label}' of block {block}"
    return ByteReader(file.section(section_id, block), where)


def _decode_colours(reader: ByteReader, there: NDArray[np.bool_], colours: Bits) -> None:
    """Decode coefficients ``(3, C, n)``; those of absent colours are 0."""
    colours[:] = 0
    green = colours[_GREEN]
    shape = green.shape[0], int(np.count_nonzero(there[_GREEN]))
    green[:, there[_GREEN]] = read_stack(reader, shape)
    for c in (_RED, _BLUE):
        colours[c][:, there[c]] = read_guided(reader, green[:, there[c]])

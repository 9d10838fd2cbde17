"""Positions and SH-DC of a block by `tmc3`; which and whether. FORMAT.md, section "G-PCC"."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import numpy as np
from crc32c import crc32c
from numpy.typing import NDArray

from gs_codec.codec.order import Ordered, triple_depths
from gs_codec.config import GPCC_DEPTHS, Config
from gs_codec.container.channels import Channel
from gs_codec.container.file import EgsFile, Section, SectionId
from gs_codec.container.tool import read_tool, write_tool
from gs_codec.errors import CorruptStream, MissingTool, ToolFailed, TruncatedStream
from gs_codec.geometry.gpcc import Depths, decode_points, encode_points
from gs_codec.geometry.tmc3 import VARIABLE, Tmc3
from gs_codec.transform.morton import canonical_order, encode_morton

_CHECKSUM = "<I"

#: Fewest Gaussians in a block if there are several: the program runs once for each.
_LEAST_BLOCK = 512


def tool_of(config: Config) -> Tmc3 | None:
    """Find the program that a configuration asks for; None if our octree codes the points.

    Raises
    ------
    MissingTool
    """
    if not config.may_use_gpcc:
        return None
    try:
        return Tmc3.find(config.tmc3)
    except MissingTool:
        if config.geometry == "auto" and config.tmc3 is None and VARIABLE not in os.environ:
            return None
        raise


def tool_section(tool: Tmc3 | None, ordered: Ordered) -> list[Section]:
    """The section `tool`, if points are coded by a program."""
    if tool is None or not any(map(sum, ordered.depths)):
        return []
    return [Section(SectionId.TOOL, 0, write_tool(tool.version))]


def encode_gpcc(
    tool: Tmc3, verify: bool, ordered: Ordered, block: int, start: int, stop: int
) -> list[Section]:
    """The section of a block's points, if any of their channels varies.

    Raises
    ------
    ToolFailed
        Also if, with `verify`, decoding does not give the points back.
    """
    if not any(map(sum, ordered.depths)):
        return []
    cells, colours = ordered.cells[:, start:stop], ordered.colours[:, start:stop]
    where = f"gpcc of block {block}: tmc3 ({tool.version})"
    try:
        coded = encode_points(tool, cells, colours)
        data = struct.pack(_CHECKSUM, _checksum(cells, colours)) + coded
        if verify:
            _decode(tool, memoryview(data), stop - start, *ordered.depths)
    except ToolFailed as error:
        raise ToolFailed(f"{where} {error}") from error
    return [Section.kept(SectionId.GPCC, block, data)]


def is_gpcc(file: EgsFile) -> bool:
    """Whether a file's points are coded by a program."""
    return (SectionId.TOOL, 0) in file.table


def tool_for(file: EgsFile, path: str | Path | None) -> Tmc3 | None:
    """Find the program that decodes a file's points; None if the file needs none.

    Raises
    ------
    CorruptStream, MissingTool
    """
    if not is_gpcc(file):
        return None
    read_tool(file.section(SectionId.TOOL))
    header = file.header
    if header.block_count > 1 and header.block_size < _LEAST_BLOCK:
        raise CorruptStream(
            f"gpcc: blocks of {header.block_size} Gaussians, expected at least {_LEAST_BLOCK}"
        )
    return Tmc3.find(path)


def decode_gpcc(
    file: EgsFile, tool: Tmc3, channels: list[Channel], block: int
) -> tuple[NDArray[np.uint32], NDArray[np.uint16]]:
    """Symbols of positions and of SH-DC ``(3, n)`` of a block, in canonical order.

    Raises
    ------
    TruncatedStream, CorruptStream
    ToolFailed
        If decoding fails; the cause may be the stream or the program.
    """
    quantisers = [channel.quantiser for channel in channels[:6]]
    axes, colours = triple_depths(quantisers[:3]), triple_depths(quantisers[3:])
    for name, depths in (("geometry", axes), ("sh-dc", colours)):
        if max(depths) > GPCC_DEPTHS[name]:
            most = GPCC_DEPTHS[name]
            raise CorruptStream(f"gpcc: {name} of {max(depths)} bits, expected at most {most}")
    start, stop = file.header.block_range(block)
    data = file.section(SectionId.GPCC, block)
    where = f"gpcc of block {block}"
    if len(data) < struct.calcsize(_CHECKSUM):
        raise TruncatedStream(f"{where}: {len(data)} bytes, expected at least 4")
    try:
        return _decode(tool, data, stop - start, axes, colours)
    except ToolFailed as error:
        written = read_tool(file.section(SectionId.TOOL))
        by = "" if written == tool.version else f"; written by {written}"
        raise ToolFailed(f"{where}: tmc3 ({tool.version}{by}) {error}") from error


def _decode(
    tool: Tmc3, data: memoryview, count: int, axes: Depths, colours: Depths
) -> tuple[NDArray[np.uint32], NDArray[np.uint16]]:
    size = struct.calcsize(_CHECKSUM)
    cells, symbols = decode_points(tool, data[size:], count, axes, colours)
    order = canonical_order(encode_morton(cells, axes), *symbols)
    cells, symbols = cells[:, order], symbols[:, order]
    if _checksum(cells, symbols) != struct.unpack(_CHECKSUM, data[:size])[0]:
        raise ToolFailed("gave other points than were coded: their checksum does not match")
    return cells, symbols


def _checksum(cells: NDArray[np.uint32], colours: NDArray[np.uint16]) -> int:
    """CRC-32C of points in canonical order."""
    rows = np.empty(cells.shape[1], [("cell", "<u4", 3), ("colour", "u1", 3)])
    rows["cell"], rows["colour"] = cells.T, colours.T
    return crc32c(rows.tobytes())

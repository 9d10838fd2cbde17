"""Geometry and SH-DC coded by G-PCC (`tmc3`). FORMAT.md, section "G-PCC".

`tmc3` reads and writes PLY files; the files it writes are validated.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from crc32c import crc32c
from numpy.typing import NDArray

from gs_codec.codecs.entropygs.section import Channel
from gs_codec.codecs.entropygs.symbols import Ordered, triple_depths
from gs_codec.coding.fields import ByteReader
from gs_codec.coding.morton import canonical_order, encode_morton
from gs_codec.config import GPCC_DEPTHS, Config
from gs_codec.egs.egs_file import EgsFile, Section, SectionId
from gs_codec.egs.header import Feature
from gs_codec.egs.sections import read_line, write_line
from gs_codec.errors import CorruptStream, InvalidInput, MissingTool, ToolFailed
from gs_codec.formats.ply.ply_header import read_header
from gs_codec.runtime.programs import Limits, find_program, run_on_files
from gs_codec.runtime.wording import counted

#: Environment variable with the path of the program.
VARIABLE = "GS_CODEC_TMC3"

_HOW = (
    "tmc3 is MPEG's reference software for G-PCC, https://github.com/MPEGGroup/mpeg-pcc-tmc13, "
    f"found by tmc3, {VARIABLE} or PATH; geometry 'octree' needs no program"
)


@dataclass(frozen=True)
class Tmc3:
    """A program that was found; ``version`` is 1-200 printable ASCII characters from its help."""

    path: str
    version: str
    limits: Limits = field(default_factory=Limits)

    @classmethod
    def find(cls, path: str | Path | None = None) -> Tmc3:
        """Find the program at `path`, or through the environment variable or PATH.

        Raises MissingTool if there is none, or it is a different program.
        """
        given = str(path) if path is not None else os.environ.get(VARIABLE)
        found, line = find_program("tmc3", given, "--help", _HOW, Limits())
        return cls(found, line[:200])

    def run(
        self,
        arguments: Sequence[str],
        inputs: Mapping[str, bytes | memoryview],
        output: str,
        most: int,
    ) -> bytes:
        """Run the program in a folder with the files `inputs`; return the bytes of file `output`.

        Raises ToolFailed if it fails, exceeds its limits, or writes more than `most` bytes.
        """
        return run_on_files([self.path, *arguments], inputs, output, self.limits, most)


Depths = tuple[int, int, int]

_AXES = ("x", "y", "z")
_COLOURS = ("red", "green", "blue")
_ROW = np.dtype([(name, "<f4") for name in _AXES] + [(name, "u1") for name in _COLOURS])

#: Lossless geometry, keeping duplicates; lossless 8-bit colour, whose options must precede its
#: name.
_ENCODE = (
    "--mode=0", "--uncompressedDataPath=in.ply", "--compressedStreamPath=out.bin",
    "--trisoupNodeSizeLog2=0", "--mergeDuplicatedPoints=0", "--positionQuantizationScale=1",
    "--neighbourAvailBoundaryLog2=8", "--intra_pred_max_node_size_log2=6",
    "--maxNumQtBtBeforeOt=4", "--minQtbtSizeLog2=0", "--planarEnabled=1", "--planarModeIdcmUse=0",
    "--inferredDirectCodingMode=3", "--convertPlyColourspace=1", "--transformType=1",
    "--numberOfNearestNeighborsInPrediction=3", "--levelOfDetailCount=0",
    "--intraLodPredictionSkipLayers=0", "--adaptivePredictionThreshold=64", "--colourMatrix=0",
    "--interComponentPredictionEnabled=1", "--qp=4", "--qpChromaOffset=0", "--bitdepth=8",
    "--attrOffset=0", "--attrScale=1", "--attribute=color",
)  # fmt: skip
_DECODE = (
    "--mode=1", "--compressedStreamPath=in.bin", "--reconstructedDataPath=out.ply",
    "--outputBinaryPly=1", "--convertPlyColourspace=1",
)  # fmt: skip

_HEADER_BYTES = 1 << 13
#: Minimum Gaussians per block if there are several, because the program runs once per block.
_LEAST_BLOCK = 512


def encode_points(tool: Tmc3, cells: NDArray[np.uint32], colours: NDArray[np.uint16]) -> bytes:
    """Code ``cells (3, N)`` of at most 18 bits per axis, and ``colours (3, N)`` of at most 8 bits.

    Raises ToolFailed.
    """
    rows = np.empty(cells.shape[1], _ROW)
    for name, plane in zip((*_AXES, *_COLOURS), (*cells, *colours), strict=True):
        rows[name] = plane
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    lines += [f"property float {name}" for name in _AXES]
    lines += [f"property uchar {name}" for name in _COLOURS]
    header = "\n".join([*lines, "end_header", ""]).encode()
    most = 64 * len(rows) + (1 << 16)
    return tool.run(_ENCODE, {"in.ply": header + rows.tobytes()}, "out.bin", most)


def decode_points(
    tool: Tmc3, data: bytes | memoryview, count: int, axes: Depths, colours: Depths
) -> tuple[NDArray[np.uint32], NDArray[np.uint16]]:
    """Invert `encode_points` for `count` points of these depths; points come in any order.

    Raises ToolFailed if the program fails, or does not return exactly `count` points.
    """
    most = _HEADER_BYTES + 64 * count
    ply = tool.run(_DECODE, {"in.bin": data}, "out.ply", most)
    rows = _read_rows(ply, count)
    cells = np.stack([_symbols(rows, *pair) for pair in zip(_AXES, axes, strict=True)])
    found = np.stack([_symbols(rows, *pair) for pair in zip(_COLOURS, colours, strict=True)])
    return cells, found.astype(np.uint16)


def _read_rows(ply: bytes, count: int) -> NDArray:
    """The rows of a binary PLY with `count` vertices and nothing else."""
    try:
        header = read_header(memoryview(ply))
    except InvalidInput as error:
        raise ToolFailed(f"wrote a file that is {error}") from None
    others = any(element.count for name, element in header.elements.items() if name != "vertex")
    if header.byte_order != "<" or [*header.elements][:1] != ["vertex"] or others:
        raise ToolFailed("wrote a PLY that is not binary, or of other elements than 'vertex'")
    vertex = header.elements["vertex"]
    if missing := [name for name in (*_AXES, *_COLOURS) if name not in vertex.types]:
        raise ToolFailed(f"wrote a PLY without property '{missing[0]}'")
    if vertex.count != count or vertex.lists:
        raise ToolFailed(
            f"wrote {counted(vertex.count, 'point')}, expected {count:,} without lists"
        )
    dtype = vertex.dtype("<")
    expected = count * dtype.itemsize
    if len(ply) - header.size != expected:
        found = len(ply) - header.size
        raise ToolFailed(
            f"wrote a PLY with {counted(found, 'byte')} of data, expected {expected:,}"
        )
    return np.frombuffer(ply, dtype, count, header.size)


def _symbols(rows: NDArray, name: str, depth: int) -> NDArray[np.uint32]:
    """A column as symbols of `depth` bits."""
    column = rows[name]
    # NaN fails both comparisons.
    if not np.all((column >= 0) & (column < 1 << depth)) or np.any(column % 1):
        raise ToolFailed(
            f"wrote a value of {name} that is not an integer of {counted(depth, 'bit')}"
        )
    return column.astype(np.uint32)


def tool_of(config: Config) -> Tmc3 | None:
    """Find the program that a configuration selects; None if our octree codes the points.

    Raises MissingTool.
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
    return [Section(SectionId.TOOL, 0, write_line(tool.version))]


def encode_gpcc(
    tool: Tmc3, verify: bool, ordered: Ordered, block: int, start: int, stop: int
) -> list[Section]:
    """The section of a block's points, if any of their channels varies.

    Raises ToolFailed if the program fails; with `verify`, also if decoding does not return the
    points.
    """
    if not any(map(sum, ordered.depths)):
        return []
    cells, colours = ordered.cells[:, start:stop], ordered.colours[:, start:stop]
    where = f"gpcc of block {block}: tmc3 ({tool.version})"
    try:
        coded = encode_points(tool, cells, colours)
        checksum = _checksum(cells, colours)
        if verify:
            _decode(tool, coded, checksum, stop - start, *ordered.depths)
    except ToolFailed as error:
        raise ToolFailed(f"{where} {error}") from error
    return [Section.kept(SectionId.GPCC, block, struct.pack("<I", checksum) + coded)]


def is_gpcc(file: EgsFile) -> bool:
    """Whether a file's points are coded by a program."""
    return Feature.GPCC in file.header.features


def tool_for(file: EgsFile, path: str | Path | None) -> Tmc3 | None:
    """Find the program that decodes a file's points; None if the file needs none.

    Raises CorruptStream or MissingTool.
    """
    if not is_gpcc(file):
        return None
    read_line(file, SectionId.TOOL)
    header = file.header
    if header.block_count > 1 and header.block_size < _LEAST_BLOCK:
        raise CorruptStream(
            f"gpcc: blocks of {counted(header.block_size, 'Gaussian')}, expected at "
            f"least {_LEAST_BLOCK:,}"
        )
    return Tmc3.find(path)


def decode_gpcc(
    file: EgsFile, tool: Tmc3, channels: list[Channel], block: int
) -> tuple[NDArray[np.uint32], NDArray[np.uint16]]:
    """Symbols of positions and of SH-DC ``(3, n)`` of a block, in canonical order.

    Raises TruncatedStream or CorruptStream. Raises ToolFailed if decoding fails; the stream or the
    program may be at fault.
    """
    quantisers = [channel.quantiser for channel in channels[:6]]
    axes, colours = triple_depths(quantisers[:3]), triple_depths(quantisers[3:])
    for name, depths in (("geometry", axes), ("sh-dc", colours)):
        if max(depths) > GPCC_DEPTHS[name]:
            most = GPCC_DEPTHS[name]
            raise CorruptStream(
                f"gpcc: {name} of {counted(max(depths), 'bit')}, expected at most {most:,}"
            )
    start, stop = file.header.block_range(block)
    data = file.section(SectionId.GPCC, block)
    where = f"gpcc of block {block}"
    reader = ByteReader(data, where)
    checksum = reader.unpack("I")[0]
    try:
        return _decode(tool, reader.rest(), checksum, stop - start, axes, colours)
    except ToolFailed as error:
        written = read_line(file, SectionId.TOOL)
        by = "" if written == tool.version else f"; written by {written}"
        raise ToolFailed(f"{where}: tmc3 ({tool.version}{by}) {error}") from error


def _decode(
    tool: Tmc3,
    coded: bytes | memoryview,
    checksum: int,
    count: int,
    axes: Depths,
    colours: Depths,
) -> tuple[NDArray[np.uint32], NDArray[np.uint16]]:
    """Decode points to symbols in canonical order, and verify their checksum."""
    cells, symbols = decode_points(tool, coded, count, axes, colours)
    order = canonical_order(encode_morton(cells, axes), *symbols)
    cells, symbols = cells[:, order], symbols[:, order]
    if _checksum(cells, symbols) != checksum:
        raise ToolFailed("decoded other points than were encoded (checksum mismatch)")
    return cells, symbols


def _checksum(cells: NDArray[np.uint32], colours: NDArray[np.uint16]) -> int:
    """CRC-32C of points in canonical order."""
    rows = np.empty(cells.shape[1], [("cell", "<u4", 3), ("colour", "u1", 3)])
    rows["cell"], rows["colour"] = cells.T, colours.T
    return crc32c(rows.tobytes())

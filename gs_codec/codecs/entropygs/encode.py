"""Scene to stream, for profiles that code channel by channel."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.entropygs.gpcc import Tmc3, encode_gpcc, tool_of, tool_section
from gs_codec.codecs.entropygs.section import write_channels
from gs_codec.codecs.entropygs.symbols import Coded, Ordered, order_scene, quantise_and_model
from gs_codec.codecs.entropygs.torchac_coder import coder_section, encode_stream, require_torchac
from gs_codec.coding.count_tree import encode_geometry
from gs_codec.coding.extent import block_extent
from gs_codec.coding.far import bring_nearer
from gs_codec.coding.predicted_colour import encode_colour
from gs_codec.coding.quantise import dequantise
from gs_codec.coding.rans import TableSet, encode_symbols
from gs_codec.config import Config
from gs_codec.egs.egs_file import Section, SectionId
from gs_codec.egs.header import Feature, Header
from gs_codec.egs.index import index_section
from gs_codec.egs.sections import pack_scene
from gs_codec.report import EncodeReport, Progress, StageTimes, step_counter
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene


def encode_entropygs(
    scene: Scene, config: Config, times: StageTimes, progress: Progress | None = None
) -> tuple[list[bytes | memoryview], EncodeReport]:
    """Encode a scene cleaned by `clean_scene`."""
    tool = tool_of(config)
    if config.coder == "torchac":
        require_torchac()
    with times.stage("order"):
        scene, lost = bring_nearer(scene)
        ordered = order_scene(scene, config.resolved_depths())
    with times.stage("quantise and model"):
        coded = quantise_and_model(scene, ordered.order, config, progress)
    with times.stage("code"):
        header = Header.of(scene, config)
        channels = write_channels([*ordered.channels, *coded.channels])
        by_tool = tool_section(tool, ordered)
        by_coder = coder_section(config) if coded.tables else []
        features = Feature.GPCC * bool(by_tool) | Feature.TORCHAC * bool(by_coder)
        header = replace(header, features=Feature(features))
        extents = run_all(
            lambda block: _extent(ordered, coded, *header.block_range(block)),
            range(header.block_count),
        )
        sections = [*index_section(extents), Section(SectionId.CHANNELS, 0, channels)]
        sections += [*by_tool, *by_coder]
        sections += _encode_blocks(header, ordered, coded, config, tool, progress)
    parts, report = pack_scene(
        scene, header, sections, ordered.order, times, coded.costs, coded.rectified
    )
    return parts, replace(report, lost=lost)


def _extent(ordered: Ordered, coded: Coded, start: int, stop: int) -> NDArray[np.float32]:
    """Bounding boxes of the decoded Gaussians of a block."""
    planes: dict[str, list[NDArray[np.float32]]] = {"positions": [], "log_scale": [], "rot": []}
    cells = zip(ordered.cells[:, start:stop], ordered.channels, strict=False)
    planes["positions"] = [dequantise(row, channel.quantiser) for row, channel in cells]
    rows = iter(coded.symbols[:, start:stop])
    for channel in coded.channels:
        if channel.quantiser.depth:
            values = dequantise(next(rows), channel.quantiser)
        else:
            values = np.full(stop - start, channel.quantiser.origin, np.float32)
        if channel.group in planes:
            planes[channel.group].append(values)
    return block_extent(*map(np.stack, planes.values()))


def _encode_blocks(
    header: Header,
    ordered: Ordered,
    coded: Coded,
    config: Config,
    tool: Tmc3 | None,
    progress: Progress | None,
) -> list[Section]:
    """Sections of all blocks, block by block."""
    if config.coder == "torchac":
        attributes = partial(_encode_by_torchac, coded)
    else:
        attributes = partial(_encode_by_rans, coded, TableSet.pack(coded.tables))
    stages = [partial(_encode_geometry, ordered), partial(_encode_colour, ordered)]
    if tool is not None:
        stages = [partial(encode_gpcc, tool, config.verify, ordered)]
    stages += [attributes] if coded.tables else []
    jobs = [
        partial(stage, block, *header.block_range(block))
        for block in range(header.block_count)
        for stage in stages
    ]
    advance = step_counter(progress, "code", len(jobs))
    done = run_all(lambda job: job(), jobs, advance=advance)
    return [section for sections in done for section in sections]


def _encode_geometry(ordered: Ordered, block: int, start: int, stop: int) -> list[Section]:
    total_bits = sum(ordered.depths[0])
    if not total_bits:
        return []
    data = encode_geometry(ordered.codes[start:stop], total_bits)
    return [Section.kept(SectionId.GEOMETRY, block, data)]


def _encode_colour(ordered: Ordered, block: int, start: int, stop: int) -> list[Section]:
    depths = ordered.depths[1]
    if not sum(depths):
        return []
    data = encode_colour(ordered.cells[:, start:stop], ordered.colours[:, start:stop], depths)
    return [Section.kept(SectionId.SH_DC, block, data)]


def _encode_by_rans(
    coded: Coded, tables: TableSet, block: int, start: int, stop: int
) -> list[Section]:
    states, words = encode_symbols(coded.symbols, start, stop, tables)
    sections = [Section(SectionId.STATES, block, states)]
    for stream, rows in coded.streams.items():
        data = b"".join(words[row] for row in rows)
        sections.append(Section.kept(SectionId.of_stream(stream), block, data))
    return sections


def _encode_by_torchac(coded: Coded, block: int, start: int, stop: int) -> list[Section]:
    sections = []
    for stream, rows in coded.streams.items():
        symbols = [coded.symbols[row, start:stop] for row in rows]
        data = encode_stream(symbols, [coded.tables[row] for row in rows])
        sections.append(Section.kept(SectionId.of_stream(stream), block, data))
    return sections

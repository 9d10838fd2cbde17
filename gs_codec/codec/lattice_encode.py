"""Scene to stream, for profiles whose steps follow what is seen."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.codec.guidance import Guidance
from gs_codec.codec.lattice_arrange import Arranged, arrange_scene
from gs_codec.codec.lattice_blocks import Block, ShapedBlock, colour_block, shape_block
from gs_codec.config import Config, LatticeProfile
from gs_codec.container.carried import carried_sections
from gs_codec.container.file import (
    Header,
    Section,
    SectionId,
    even_block_size,
    file_parts,
    section_sizes,
)
from gs_codec.container.lattice import PassModels, fit_weights, write_bounds, write_lattice
from gs_codec.entropy.bits import BitWriter
from gs_codec.entropy.passes import PassTables, PassWriter
from gs_codec.lattice.fixed import to_float
from gs_codec.lattice.place import from_grid
from gs_codec.lattice.plan import Pass, passes
from gs_codec.lattice.tokens import ALPHABET
from gs_codec.model.contexts import ContextTables, share_tables
from gs_codec.model.table import shannon_bits
from gs_codec.report import ChannelCost, EncodeReport, Progress, StageTimes, step_counter
from gs_codec.scene import Scene, gather
from gs_codec.transform.axes import quaternions
from gs_codec.workers import run_all


@dataclass(frozen=True)
class Modelled:
    """A scene on its lattices, and the tables of its passes.

    Attributes
    ----------
    header : Header
    arranged : Arranged
    blocks : list of Block
    listed : list of Pass
    models : PassModels
    costs : list of ChannelCost
        Of each pass, all blocks together.
    """

    header: Header
    arranged: Arranged
    blocks: list[Block]
    listed: list[Pass]
    models: PassModels
    costs: list[ChannelCost]


def encode_lattice(
    scene: Scene,
    config: Config,
    guide: Callable[[Scene], Guidance] | None = None,
    progress: Progress | None = None,
) -> tuple[list[bytes | memoryview], EncodeReport]:
    """Encode a scene without values that are not finite; see `encode_parts`."""
    times = StageTimes()
    modelled = model_lattice(scene, config, guide, times, progress)
    blocks, arranged = modelled.blocks, modelled.arranged
    with times.stage("code"):
        advance = step_counter(progress, "code", len(blocks))
        coded = code_blocks(modelled, config.threads, advance)
    with times.stage("container"):
        lattice = write_lattice(arranged.lattice, modelled.models)
        sections = [Section(SectionId.LATTICE, 0, lattice)]
        if blocks:
            bounds = write_bounds([block.box for block in blocks])
            sections.append(Section(SectionId.BOUNDS, 0, bounds))
        sections += [section for block in coded for section in block]
        sections += carried_sections(arranged.source, arranged.order)
        parts = file_parts(modelled.header, sections)
    return parts, EncodeReport(
        count=scene.count,
        raw_bytes=scene.float_bytes,
        section_bytes=section_sizes(sections),
        costs=modelled.costs,
        rectified=sum(block.clamped for block in blocks),
        zero_quaternions=0,
        dropped=0,
        seconds=times.seconds,
    )


def model_lattice(
    scene: Scene,
    config: Config,
    guide: Callable[[Scene], Guidance] | None,
    times: StageTimes,
    progress: Progress | None = None,
) -> Modelled:
    """Everything of `encode_lattice` before symbols are coded."""
    guidance = None
    if guide is not None and scene.count:
        with times.stage("views"):
            guidance = guide(scene)
    size = even_block_size(scene.count, config.block_size)
    header = Header(scene.count, scene.sh_degree, config.profile, size, scene.has_normals)
    with times.stage("order"):
        arranged = arrange_scene(scene, config, guidance)
    arranged, blocks = _quantise(header, arranged, guidance, config, times, progress)
    listed = passes(len(scene.f_rest) // 3)
    with times.stage("model"):
        models, costs = _models(listed, blocks, config.threads)
    return Modelled(header, arranged, blocks, listed, models, costs)


def _quantise(
    header: Header,
    arranged: Arranged,
    guidance: Guidance | None,
    config: Config,
    times: StageTimes,
    progress: Progress | None,
) -> tuple[Arranged, list[Block]]:
    """Blocks on their lattices; with guidance, of the scene that this recolours on the way."""
    threads = config.threads
    ranges = [header.block_range(block) for block in range(header.block_count)]
    advance = step_counter(progress, "quantise", len(ranges))
    if guidance is None:

        def both(span: tuple[int, int]) -> Block:
            return colour_block(arranged, shape_block(arranged, *span), diffusing=True).kept()

        with times.stage("quantise"):
            return arranged, run_all(both, ranges, threads, advance)
    with times.stage("quantise"):
        shaped = run_all(lambda span: shape_block(arranged, *span), ranges, threads)
    with times.stage("recolour"):
        coloured = _recolour(arranged, shaped, guidance, config.resolved_lattice())
    with times.stage("quantise"):
        return coloured, run_all(
            lambda block: colour_block(coloured, block, diffusing=False), shaped, threads, advance
        )


def _recolour(
    arranged: Arranged, blocks: list[ShapedBlock], guidance: Guidance, profile: LatticeProfile
) -> Arranged:
    """Let views choose colours that make up for what shapes have lost."""
    source, order, lattice = arranged.source, arranged.order, arranged.lattice
    shapes = [block.shape for block in blocks]
    places = np.concatenate([block.places for block in blocks], axis=1)
    decoded = replace(
        source.take(order),
        positions=from_grid(places, np.array(lattice.grid.origin), lattice.grid.step),
        opacity=np.float32(to_float(np.concatenate([s.opacity for s in shapes])))[None],
        log_scale=np.float32(to_float(np.concatenate([s.scales for s in shapes], axis=1))),
        rot=quaternions(to_float(np.concatenate([s.vectors for s in shapes], axis=1))),
    )
    shifts = np.concatenate([block.shifts for block in blocks])
    finest = min(lattice.units[f"sh{band}"] for band in (1, 2, 3))
    steps = to_float(finest << shifts).astype(np.float32)
    coloured = guidance.refit(guidance.compact(decoded, order, steps, profile))
    place = np.empty_like(order)
    place[order] = np.arange(len(order), dtype=order.dtype)
    f_dc, f_rest = gather(coloured.f_dc, place), gather(coloured.f_rest, place)
    return replace(arranged, source=replace(source, f_dc=f_dc, f_rest=f_rest))


def _models(
    listed: list[Pass], blocks: list[Block], threads: int | None
) -> tuple[PassModels, list[ChannelCost]]:
    """Tables for the passes of all blocks together."""

    def share(p: int) -> ContextTables:
        counts = np.zeros((listed[p].contexts, ALPHABET), np.int64)
        for block in blocks:
            counts += block.passes[p].histograms(listed[p].contexts)
        return share_tables(counts)

    shared = run_all(share, range(len(listed)), threads)
    rows: list[NDArray[np.int64]] = []
    weights: list[NDArray[np.int64]] = []
    costs = []
    for p, (item, found) in enumerate(zip(listed, shared, strict=True)):
        rows.append(len(weights) + found.table_of)
        fitted = [fit_weights(histogram) for histogram in found.histograms]
        models = PassModels([], fitted).tables()
        coded = sum(
            table.code_length(histogram[: len(table.frequencies)])
            for table, histogram in zip(models, found.histograms, strict=True)
        )
        raw = sum(int(block.passes[p].raw_widths.sum(dtype=np.int64)) for block in blocks)
        entropy = raw + sum(shannon_bits(histogram) for histogram in found.histograms)
        costs.append(
            ChannelCost(item.name, item.stream, "table", raw + coded, raw + coded, entropy)
        )
        weights += fitted
    return PassModels(rows, weights), costs


def code_blocks(
    modelled: Modelled, threads: int | None, advance: Callable[[], None] | None = None
) -> list[list[Section]]:
    """Sections of each block."""
    tables = PassTables.pack(modelled.models.tables())
    numbers = range(len(modelled.blocks))
    return run_all(lambda number: _sections(modelled, number, tables), numbers, threads, advance)


def _sections(modelled: Modelled, number: int, tables: PassTables) -> list[Section]:
    """Sections of a block."""
    block = modelled.blocks[number]
    writer = PassWriter(tables)
    bits: dict[str, BitWriter] = {}
    for item, data, rows in zip(modelled.listed, block.passes, modelled.models.rows, strict=True):
        writer.add(item.stream, data.tokens, data.contexts, rows)
        bits.setdefault(item.stream, BitWriter()).add(data.raw_levels, data.raw_widths)
    states, words = writer.finish()
    sections = [
        Section(SectionId.GEOMETRY, number, block.tree),
        Section(SectionId.STATES, number, states),
        Section(SectionId.LOW_BITS, number, block.low_bits),
    ]
    for stream, low_bits in bits.items():
        packed = struct.pack("<I", len(words[stream])) + words[stream] + low_bits.finish()
        sections.append(Section.kept(SectionId.of_stream(stream), number, packed))
    return sections

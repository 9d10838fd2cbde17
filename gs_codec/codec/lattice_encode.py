"""Scene to stream, for profiles whose steps follow what is seen."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.codec.guidance import Guidance
from gs_codec.codec.lattice_arrange import Arranged, arrange_scene
from gs_codec.codec.lattice_blocks import Block, ShapedBlock, colour_block, shape_block
from gs_codec.config import LATTICE_PROFILES, Config
from gs_codec.container.carried import carried_sections
from gs_codec.container.file import (
    Header,
    Section,
    SectionId,
    even_block_size,
    section_sizes,
    write_file,
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
from gs_codec.scene import Scene
from gs_codec.transform.axes import quaternions
from gs_codec.workers import run_all


def encode_lattice(
    scene: Scene,
    config: Config,
    guide: Callable[[Scene], Guidance] | None = None,
    progress: Progress | None = None,
) -> tuple[bytes, EncodeReport]:
    """Encode a scene without values that are not finite; see `encode_scene`."""
    times = StageTimes()
    guidance = None
    if guide is not None and scene.count:
        with times.stage("views"):
            guidance = guide(scene)
    size = even_block_size(scene.count, config.block_size)
    header = Header(scene.count, scene.sh_degree, config.profile, size, scene.has_normals)
    with times.stage("order"):
        profile = LATTICE_PROFILES[config.profile]
        arranged = arrange_scene(scene, profile, guidance, config.threads)
    arranged, blocks = _quantise(header, arranged, guidance, config.threads, times, progress)
    listed = passes(len(scene.f_rest) // 3)
    with times.stage("model"):
        models, costs = _models(listed, blocks, config.threads)
    with times.stage("code"):
        coded = _code(listed, blocks, models, config.threads, progress)
    with times.stage("container"):
        sections = [Section(SectionId.LATTICE, 0, write_lattice(arranged.lattice, models))]
        if blocks:
            bounds = write_bounds([block.box for block in blocks])
            sections.append(Section(SectionId.BOUNDS, 0, bounds))
        sections += coded + carried_sections(arranged.source, arranged.order)
        data = write_file(header, sections)
    return data, EncodeReport(
        count=scene.count,
        raw_bytes=scene.float_bytes,
        section_bytes=section_sizes(data, sections),
        costs=costs,
        rectified=sum(block.clamped for block in blocks),
        zero_quaternions=0,
        dropped=0,
        seconds=times.seconds,
    )


def _quantise(
    header: Header,
    arranged: Arranged,
    guidance: Guidance | None,
    threads: int | None,
    times: StageTimes,
    progress: Progress | None,
) -> tuple[Arranged, list[Block]]:
    """Blocks on their lattices; with guidance, of the scene that this recolours on the way."""
    ranges = [header.block_range(block) for block in range(header.block_count)]
    advance = step_counter(progress, "quantise", len(ranges))
    if guidance is None:

        def both(span: tuple[int, int]) -> Block:
            return colour_block(arranged, shape_block(arranged, *span), diffusing=True)

        with times.stage("quantise"):
            return arranged, run_all(both, ranges, threads, advance)
    with times.stage("quantise"):
        shaped = run_all(lambda span: shape_block(arranged, *span), ranges, threads)
    with times.stage("recolour"):
        coloured = _recolour(arranged, shaped, guidance)
    with times.stage("quantise"):
        return coloured, run_all(
            lambda block: colour_block(coloured, block, diffusing=False), shaped, threads, advance
        )


def _recolour(arranged: Arranged, blocks: list[ShapedBlock], guidance: Guidance) -> Arranged:
    """Let views choose colours that make up for what shapes have lost."""
    lattice = arranged.lattice
    shapes = [block.shape for block in blocks]
    places = np.concatenate([block.places for block in blocks], axis=1)
    decoded = replace(
        arranged.source.take(arranged.order),
        positions=from_grid(places, np.array(lattice.grid.origin), lattice.grid.step),
        opacity=np.float32(to_float(np.concatenate([s.opacity for s in shapes])))[None],
        log_scale=np.float32(to_float(np.concatenate([s.scales for s in shapes], axis=1))),
        rot=quaternions(to_float(np.concatenate([s.vectors for s in shapes], axis=1))),
    )
    shifts = np.concatenate([block.shifts for block in blocks])
    steps = to_float(lattice.units["sh1"] << shifts).astype(np.float32)
    coloured = guidance.recolour(decoded, steps)
    return replace(arranged, source=coloured, order=np.arange(coloured.count, dtype=np.uint32))


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


def _code(
    listed: list[Pass],
    blocks: list[Block],
    models: PassModels,
    threads: int | None,
    progress: Progress | None,
) -> list[Section]:
    """Sections of all blocks, block after block."""
    tables = PassTables.pack(models.tables())
    advance = step_counter(progress, "code", len(blocks))
    done = run_all(
        lambda item: _sections(*item, listed, models, tables),
        list(enumerate(blocks)),
        threads,
        advance,
    )
    return [section for sections in done for section in sections]


def _sections(
    number: int, block: Block, listed: list[Pass], models: PassModels, tables: PassTables
) -> list[Section]:
    """Sections of a block."""
    writer = PassWriter(tables)
    bits: dict[str, BitWriter] = {}
    for item, data, rows in zip(listed, block.passes, models.rows, strict=True):
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
        sections.append(Section(SectionId.of_stream(stream), number, packed))
    return sections

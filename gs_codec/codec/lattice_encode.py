"""Scene to stream, for profiles whose steps follow what is seen."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gs_codec.codec.guidance import Guidance
from gs_codec.codec.lattice_prepare import Shaped, shape_scene
from gs_codec.codec.lattice_symbols import (
    PassData,
    ac_passes,
    class_passes,
    dc_pass,
    shape_passes,
)
from gs_codec.config import Config
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
from gs_codec.geometry.count_tree import encode_tree
from gs_codec.geometry.diffusion import round_diffusing
from gs_codec.lattice.fixed import LARGEST, PLACES, to_float
from gs_codec.lattice.place import centres, from_grid
from gs_codec.lattice.plan import Pass, passes
from gs_codec.lattice.tokens import ALPHABET
from gs_codec.model.contexts import ContextTables, share_tables
from gs_codec.model.table import shannon_bits
from gs_codec.report import ChannelCost, EncodeReport, Progress, StageTimes, step_counter
from gs_codec.scene import Scene
from gs_codec.transform.axes import quaternions
from gs_codec.transform.ycocg import to_ycocg
from gs_codec.workers import run_all


@dataclass(frozen=True)
class _Block:
    """What a block holds: its tree, low bits of positions, and its passes by stream."""

    tree: bytes
    low_bits: bytes
    places: NDArray[np.int64]
    passes: list[PassData]


def encode_lattice(
    scene: Scene,
    config: Config,
    guide: Callable[[Scene], Guidance] | None = None,
    progress: Progress | None = None,
) -> tuple[bytes, EncodeReport]:
    """Encode a scene without values that are not finite; see `encode_scene`."""
    profile = config.resolved_lattice()
    times = StageTimes()
    guidance = None
    if guide is not None and scene.count:
        with times.stage("views"):
            guidance = guide(scene)
    with times.stage("quantise"):
        shaped = shape_scene(scene, profile, guidance)
        size = even_block_size(scene.count, config.block_size)
        header = Header(scene.count, scene.sh_degree, config.profile, size, scene.has_normals)
        ranges = [header.block_range(block) for block in range(header.block_count)]
        placed = run_all(lambda r: _place(shaped, *r), ranges, config.threads)
        places = np.concatenate([np.zeros((3, 0), np.int64), *(p.places for p in placed)], axis=1)
    if guidance is not None:
        with times.stage("recolour"):
            shaped = _recolour(shaped, places, guidance)
    with times.stage("colour"):
        shifts = _colour_shifts(shaped)
        advance = step_counter(progress, "quantise", len(ranges))
        jobs = [
            partial(_symbols, shaped, shifts, guidance is None, block, *span)
            for block, span in zip(placed, ranges, strict=True)
        ]
        found = run_all(lambda job: job(), jobs, config.threads, advance)
        coded = [block for block, _ in found]
        clamped = sum(beyond for _, beyond in found)
    with times.stage("model"):
        models, costs = _models(shaped, coded, config.threads)
        tables = PassTables.pack(models.tables())
    with times.stage("code"):
        advance = step_counter(progress, "code", len(ranges))
        listed = passes(len(scene.f_rest) // 3)
        done = run_all(
            lambda item: _sections(item[0], item[1], listed, models, tables),
            list(enumerate(coded)),
            config.threads,
            advance,
        )
    with times.stage("container"):
        lattice = write_lattice(shaped.lattice, models)
        sections = [Section(SectionId.LATTICE, 0, lattice)]
        if header.block_count:
            sections.append(Section(SectionId.BOUNDS, 0, _bounds(places, ranges)))
        sections += [section for block in done for section in block]
        sections += carried_sections(shaped.source, shaped.order)
        data = write_file(header, sections)
    return data, EncodeReport(
        count=scene.count,
        raw_bytes=scene.float_bytes,
        section_bytes=section_sizes(data, sections),
        costs=costs,
        rectified=shaped.quantiser.clamped + clamped,
        zero_quaternions=0,
        dropped=0,
        seconds=times.seconds,
    )


def _place(shaped: Shaped, start: int, stop: int) -> _Block:
    """Tree and low bits of a block's positions, and the places they decode to."""
    lattice = shaped.lattice
    codes = shaped.codes[start:stop]
    tree, lefts = encode_tree(codes, lattice.grid.total_bits)
    dropped = np.minimum(_dropped(shaped, start, stop), lefts)
    kept = codes >> dropped
    bits = BitWriter()
    bits.add(kept, (lefts - dropped).astype(np.uint8))
    places = centres(kept << dropped, dropped, lattice.grid.bits)
    return _Block(tree, bits.finish(), places, [])


def _dropped(shaped: Shaped, start: int, stop: int) -> NDArray[np.int64]:
    rule = shaped.lattice.rules["position"]
    shape = shaped.shape
    return rule.shifts(
        shaped.classes[0, start:stop], 3, shape.opacity[start:stop], shape.scales[:, start:stop]
    )


def _recolour(shaped: Shaped, places: NDArray[np.int64], guidance: Guidance) -> Shaped:
    """Let views choose colours that make up for what shapes have lost."""
    lattice, shape, scene = shaped.lattice, shaped.shape, shaped.scene
    decoded = replace(
        scene,
        positions=from_grid(places, np.array(lattice.grid.origin), lattice.grid.step),
        opacity=to_float(shape.opacity)[None].astype(np.float32),
        log_scale=to_float(shape.scales).astype(np.float32),
        rot=quaternions(to_float(shape.vectors)),
    )
    steps = to_float(lattice.units["sh1"] << _colour_shifts(shaped)).astype(np.float32)
    coloured = guidance.recolour(decoded, steps)
    return replace(shaped, source=coloured, order=np.arange(coloured.count))


def _colour_shifts(shaped: Shaped) -> NDArray[np.int64]:
    rule = shaped.lattice.rules["colour"]
    return rule.shifts(shaped.classes[1], 1, shaped.shape.opacity, shaped.shape.scales)


def _symbols(
    shaped: Shaped,
    shifts: NDArray[np.int64],
    diffusing: bool,
    placed: _Block,
    start: int,
    stop: int,
) -> tuple[_Block, int]:
    """All passes of a block, and how many colour values were clamped.

    Errors of SH-AC are diffused where no views have chosen them.
    """
    classes, shifts = shaped.classes[:, start:stop], shifts[start:stop]
    units = shaped.lattice.units
    dc = to_ycocg(shaped.source.f_dc[:, shaped.order[start:stop]])
    clamped = int(np.count_nonzero(np.abs(dc) > LARGEST))
    fixed = np.floor(np.clip(dc, -LARGEST, LARGEST) * (1 << PLACES) + 0.5).astype(np.int64)
    listed = [
        *class_passes(classes[0], classes[1]),
        *shape_passes(shaped.quantiser, start, stop),
        dc_pass(placed.places, fixed, units["sh-dc"], shifts),
    ]
    coefficients = len(shaped.source.f_rest) // 3
    if coefficients:
        ac, beyond = _in_steps(shaped, shifts, start, stop)
        clamped += beyond
        levels = round_diffusing(placed.places, ac) if diffusing else np.floor(ac + 0.5)
        listed += ac_passes(levels.astype(np.int64).reshape(3, coefficients, -1), shifts)
    return replace(placed, passes=listed), clamped


def _in_steps(
    shaped: Shaped, shifts: NDArray[np.int64], start: int, stop: int
) -> tuple[NDArray[np.float32], int]:
    """SH-AC of a block in Y, Co, Cg and in steps ``(3 K, n)``, and how many were clamped."""
    coefficients = len(shaped.source.f_rest) // 3
    planes = shaped.source.f_rest.reshape(3, coefficients, -1)
    members = shaped.order[start:stop]
    ac = np.empty((3, coefficients, len(members)), np.float32)
    clamped = 0
    for k in range(coefficients):
        band = 1 + (k > 2) + (k > 7)
        values = to_ycocg(np.take(planes[:, k], members, axis=1))
        clamped += int(np.count_nonzero(np.abs(values) > LARGEST))
        steps = to_float(shaped.lattice.units[f"sh{band}"] << shifts)
        ac[:, k] = np.clip(values, -LARGEST, LARGEST) / steps
    return ac.reshape(3 * coefficients, -1), clamped


def _models(
    shaped: Shaped, blocks: list[_Block], threads: int | None
) -> tuple[PassModels, list[ChannelCost]]:
    """Tables for the passes of all blocks together."""
    listed = passes(len(shaped.source.f_rest) // 3)

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


def _sections(
    number: int, block: _Block, listed: list[Pass], models: PassModels, tables: PassTables
) -> list[Section]:
    """Sections of a block."""
    writer = PassWriter(tables)
    bits: dict[str, BitWriter] = {}
    for item, data, rows in zip(listed, block.passes, models.rows, strict=True):
        writer.add(item.stream, data.tokens, rows[data.contexts].astype(np.uint16))
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


def _bounds(places: NDArray[np.int64], ranges: list[tuple[int, int]]) -> bytes:
    """Lowest and highest x, y, z of each block's places, in half steps."""
    bounds = [
        (*places[:, start:stop].min(axis=1), *places[:, start:stop].max(axis=1))
        for start, stop in ranges
    ]
    return write_bounds(bounds)

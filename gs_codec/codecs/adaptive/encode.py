"""Encoder of profiles ``l``, ``m`` and ``s``: scene to stream."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gs_codec.codecs.adaptive.arrange import Arranged, arrange_scene
from gs_codec.codecs.adaptive.blocks import Block, ShapedBlock, colour_block, shape_block
from gs_codec.codecs.adaptive.contexts import ContextList, Pass, passes, share_tables
from gs_codec.codecs.adaptive.section import MANTISSA, PassModels, write_lattice
from gs_codec.codecs.adaptive.shaped import ShapedScene, spans
from gs_codec.codecs.adaptive.step_sizes import StepSizes
from gs_codec.codecs.adaptive.tokens import ALPHABET, RAW_WIDTHS
from gs_codec.codecs.adaptive.watched import Watched
from gs_codec.coding.context_rans import PRECISION, CodedPass, PassTables, encode_passes
from gs_codec.coding.exact_math import dot
from gs_codec.coding.frequency_table import FrequencyTable, SentModel, shannon_bits
from gs_codec.config import Config
from gs_codec.egs.egs_file import Section, SectionId
from gs_codec.egs.header import Feature, Header
from gs_codec.egs.index import errors_section, index_section
from gs_codec.egs.sections import pack_scene
from gs_codec.report import ChannelCost, EncodeReport, Progress, StageTimes, step_counter
from gs_codec.runtime.threads import run_all
from gs_codec.scene import Scene


def encode_adaptive(
    scene: Scene,
    config: Config,
    steps: StepSizes | None,
    times: StageTimes,
    progress: Progress | None = None,
    watched: Watched | None = None,
) -> tuple[list[bytes | memoryview], EncodeReport]:
    """Encode a scene cleaned by `clean_scene`; camera-free if `steps` is None.

    `watched` receives the decoded values of its Gaussians.
    """
    header, arranged = _arrange(scene, config, steps, times, watched)
    return _code(
        header, arranged, _blocks(header, arranged, steps is None, times, progress), times, progress
    )


def encode_level(
    scene: Scene,
    config: Config,
    header: Header,
    errors: NDArray[np.float32],
    progress: Progress | None = None,
) -> list[bytes | memoryview]:
    """Encode a coarser level of a scene, camera-free, to the pieces of a file.

    `header` gives the blocks, which are not rearranged, and whether there may be far Gaussians;
    `errors` are the errors of the blocks. See FORMAT.md.
    """
    times = StageTimes()
    may_have_far = Feature.FAR in header.features
    arranged = arrange_scene(scene, config, None, header.block_size, may_have_far)
    arranged = replace(arranged, may_have_basis=Feature.LOCAL_BASIS in header.features)
    header = header.having(Feature.FAR, arranged.lattice.grid.has_far)
    blocks = _blocks(header, arranged, True, times, progress)
    further = [errors_section(errors)]
    return _code(header, arranged, blocks, times, progress, further)[0]


def _blocks(
    header: Header,
    arranged: Arranged,
    diffusing: bool,
    times: StageTimes,
    progress: Progress | None,
) -> list[Block]:
    """Quantise all blocks."""
    advance = step_counter(progress, "quantise", header.block_count)

    def code(span: tuple[int, int]) -> Block:
        return colour_block(arranged, shape_block(arranged, *span), diffusing).kept()

    with times.stage("quantise"):
        return run_all(code, spans(header), advance=advance)


def shape_scene(
    scene: Scene,
    config: Config,
    steps: StepSizes | None,
    times: StageTimes,
    progress: Progress | None = None,
    watched: Watched | None = None,
) -> ShapedScene:
    """Quantise everything but the colours of a cleaned scene; camera-free if `steps` is None.

    `watched` receives the decoded values of its Gaussians once the scene is encoded.
    """
    header, arranged = _arrange(scene, config, steps, times, watched)
    advance = step_counter(progress, "quantise", header.block_count)
    with times.stage("quantise"):
        blocks = run_all(lambda span: shape_block(arranged, *span), spans(header), advance=advance)
    return ShapedScene(header, arranged, blocks)


def code_shaped(
    shaped: ShapedScene, times: StageTimes, progress: Progress | None = None
) -> tuple[list[bytes | memoryview], EncodeReport]:
    """Encode a scene from `shape_scene`, with its current colours."""
    header, arranged = shaped.header, shaped.arranged
    advance = step_counter(progress, "quantise", header.block_count)

    def colour(block: ShapedBlock) -> Block:
        return colour_block(arranged, block, diffusing=False)

    with times.stage("quantise"):
        blocks = run_all(colour, shaped.blocks, advance=advance)
    return _code(header, arranged, blocks, times, progress)


def _arrange(
    scene: Scene,
    config: Config,
    steps: StepSizes | None,
    times: StageTimes,
    watched: Watched | None,
) -> tuple[Header, Arranged]:
    with times.stage("order"):
        arranged = arrange_scene(scene, config, steps, watched=watched)
        has_far = arranged.lattice.grid.has_far
        header = Header.of(scene, config).having(Feature.FAR, has_far)
        return header, arranged


def _code(
    header: Header,
    arranged: Arranged,
    blocks: list[Block],
    times: StageTimes,
    progress: Progress | None,
    further: Sequence[Section] = (),
) -> tuple[list[bytes | memoryview], EncodeReport]:
    """Entropy-code blocks and return the file, with further sections in `further`."""
    header = header.having(Feature.LOCAL_BASIS, any(block.basis for block in blocks))
    listed = passes(len(arranged.source.f_rest) // 3)
    with times.stage("model"):
        models, tables, costs = choose_models(listed, count_tokens(listed, blocks))
    with times.stage("code"):
        packed = PassTables.pack(tables)
        rows = [models.rows(item) for item in listed]
        advance = step_counter(progress, "code", len(blocks))
        coded = run_all(
            lambda item: block_sections(*item, listed, rows, packed),
            enumerate(blocks),
            advance=advance,
        )
    sections = [*index_section([block.extent for block in blocks]), *further]
    sections.append(Section(SectionId.LATTICE, 0, write_lattice(arranged.lattice, models)))
    sections += [section for block in coded for section in block]
    clamped = sum(block.clamped for block in blocks)
    return pack_scene(arranged.source, header, sections, arranged.order, times, costs, clamped)


def count_tokens(listed: list[Pass], blocks: list[Block]) -> list[NDArray[np.int64]]:
    """Occurrences of each token in each context of each list of passes, ``(contexts, A)``."""

    def count(number: int) -> list[NDArray[np.int64]]:
        lists = listed[number].lists
        counts = np.zeros((sum(item.contexts for item in lists), ALPHABET), np.int64)
        for block in blocks:
            block.passes[number].count(counts)
        return np.split(counts, np.cumsum([item.contexts for item in lists])[:-1])

    return [own for one in run_all(count, range(len(listed))) for own in one]


def choose_models(
    listed: list[Pass], counted: list[NDArray[np.int64]]
) -> tuple[PassModels, list[FrequencyTable], list[ChannelCost]]:
    """Choose models, their tables and the bits of each list, from `count_tokens` of all blocks."""
    lists = [item for one in listed for item in one.lists]
    rows: dict[str, NDArray[np.int64]] = {}
    weights: list[NDArray[np.int64]] = []
    for item, (table_of, histograms) in zip(lists, run_all(share_tables, counted), strict=True):
        rows[item.name] = len(weights) + table_of
        for histogram in histograms:
            used = np.trim_zeros(histogram, "b") if histogram.any() else np.ones(1, np.int64)
            weights.append(SentModel.fit(used, MANTISSA, PRECISION).weights)
    models = PassModels(rows, weights)
    tables = models.tables()
    costs = [
        _cost(item, own, rows[item.name], tables) for item, own in zip(lists, counted, strict=True)
    ]
    return models, tables, costs


def _cost(
    item: ContextList,
    counts: NDArray[np.int64],
    rows: NDArray[np.int64],
    tables: list[FrequencyTable],
) -> ChannelCost:
    """Bits of a list whose tokens occur ``counts (contexts, ALPHABET)`` times."""
    entropy = bits = float(dot(counts.sum(axis=0), RAW_WIDTHS))
    for row in np.unique(rows[counts.any(axis=1)]):
        histogram = counts[rows == row].sum(axis=0)
        entropy += shannon_bits(histogram)
        bits += tables[row].code_length(histogram[: tables[row].frequencies.size])
    return ChannelCost(item.name, item.stream, "table", bits, bits, entropy)


def block_sections(
    number: int,
    block: Block,
    listed: list[Pass],
    rows: list[NDArray[np.uint16]],
    tables: PassTables,
) -> list[Section]:
    """Encode the sections of block `number`."""
    coded = [
        CodedPass(item.streams, item.cycle, own, *vars(data).values())
        for item, own, data in zip(listed, rows, block.passes, strict=True)
    ]
    states, streams = encode_passes(coded, tables)
    sections = [
        Section(SectionId.GEOMETRY, number, block.tree),
        Section(SectionId.STATES, number, states),
        Section(SectionId.LOW_BITS, number, block.low_bits),
    ]
    if block.far:
        sections.append(Section(SectionId.FAR, number, block.far))
    if block.basis:
        sections.append(Section(SectionId.BASIS, number, block.basis))
    for stream, data in streams.items():
        sections.append(Section.kept(SectionId.of_stream(stream), number, data))
    return sections

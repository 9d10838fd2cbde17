"""The order of the stages, in both directions. Nothing else knows it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from gs_codec.config import Config
from gs_codec.container.carried import read_comments, read_extra, write_comments, write_extra
from gs_codec.container.channels import (
    RANS_STREAMS,
    Channel,
    channel_places,
    read_channels,
    sent_table_bytes,
    write_channels,
)
from gs_codec.container.file import (
    EgsFile,
    Header,
    Section,
    SectionId,
    read_file,
    write_file,
)
from gs_codec.entropy.rans import TableSet, decode_symbols, encode_symbols
from gs_codec.errors import CorruptStream, InvalidInput
from gs_codec.geometry.colour import decode_colour, encode_colour
from gs_codec.geometry.count_tree import decode_geometry, encode_geometry
from gs_codec.model.select import Choice, choose_model
from gs_codec.model.table import FrequencyTable
from gs_codec.quantise import (
    Quantiser,
    count_nonfinite,
    dequantise,
    fit_centred,
    fit_range,
    quantise,
    quantise_positions,
)
from gs_codec.report import ChannelCost, EncodeReport, Progress, StageTimes
from gs_codec.scene import GROUPS, SH_COEFFICIENTS, Scene
from gs_codec.transform.morton import canonical_order, decode_morton, encode_morton
from gs_codec.workers import run_all

#: A stream may decode to this many bytes, or to `EXPANSION` times its size if that is more.
DECODED_BYTES = 1 << 30
EXPANSION = 1000

_STREAM_SECTIONS = {name: SectionId[name.upper()] for name in RANS_STREAMS}


@dataclass(frozen=True)
class _Ordered:
    """Geometry and SH-DC of a scene in canonical order, and the order itself."""

    order: NDArray[np.int64]
    codes: NDArray[np.int64]
    cells: NDArray[np.uint32]
    colours: NDArray[np.uint16]
    channels: list[Channel]


@dataclass(frozen=True)
class Coded:
    """The rANS-coded channels of a scene, in canonical order.

    Attributes
    ----------
    channels : list of Channel
        Those that are not constant, in stream order.
    symbols : ndarray, shape (C, N), uint16
    histograms : list of ndarray, shape (2**depth,), int64
    tables : list of FrequencyTable
    costs : list of ChannelCost
    constants : list of Channel
        Those that are.
    rectified : int
        SH-AC values moved to the edge of their Laplace range.
    """

    channels: list[Channel]
    symbols: NDArray[np.uint16]
    histograms: list[NDArray[np.int64]]
    tables: list[FrequencyTable]
    costs: list[ChannelCost]
    constants: list[Channel]
    rectified: int


def encode_scene(
    scene: Scene, config: Config | None = None, progress: Progress | None = None
) -> tuple[bytes, EncodeReport]:
    """Encode a scene as `.egs`.

    Parameters
    ----------
    scene : Scene
    config : Config, optional
    progress : callable, optional
        Called as ``progress(stage, done, total)`` from the calling thread.

    Returns
    -------
    data : bytes
    report : EncodeReport

    Raises
    ------
    InvalidInput
        If values are not finite and `config` does not say to drop them.
    """
    config = config or Config()
    times = StageTimes()
    with times.stage("check"):
        scene, dropped = drop_nonfinite(scene, config)
        scene, zero_quaternions = _identity_for_zero(scene)
    with times.stage("order"):
        depths = config.resolved_depths()
        ordered = _order(scene, depths["geometry"], depths["sh-dc"])
    with times.stage("quantise and model"):
        coded = _quantise_and_model(scene, ordered.order, config, progress)
    with times.stage("code"):
        header = _header(scene, config)
        block_sections = _encode_blocks(header, ordered, coded, config.threads, progress)
    with times.stage("container"):
        by_place = {
            (c.group, c.index): c for c in (*ordered.channels, *coded.constants, *coded.channels)
        }
        places = channel_places(len(scene.f_rest) // 3)
        channels = write_channels(by_place[group, index] for group, index, _ in places)
        sections = [Section(SectionId.CHANNELS, 0, channels), *block_sections]
        if scene.comments:
            sections.append(Section(SectionId.COMMENTS, 0, write_comments(scene.comments)))
        if scene.extra:
            sections.append(Section(SectionId.EXTRA, 0, write_extra(scene.extra, ordered.order)))
        data = write_file(header, sections)
    sizes = Counter[str]()
    for section in sections:
        sizes[section.id.label] += len(section.data)
    sizes = Counter({"header": len(data) - sizes.total()}) + sizes
    return data, EncodeReport(
        count=scene.count,
        raw_bytes=scene.float_bytes,
        section_bytes=dict(sizes),
        costs=coded.costs,
        rectified=coded.rectified,
        zero_quaternions=zero_quaternions,
        dropped=dropped,
        seconds=times.seconds,
    )


def drop_nonfinite(scene: Scene, config: Config) -> tuple[Scene, int]:
    """The scene without Gaussians that hold NaN or infinity, and how many there were.

    Raises
    ------
    InvalidInput
        If there are any and ``config.nonfinite`` is ``error``.
    """
    planes = [(group, row) for group in GROUPS for row in getattr(scene, group)]
    counts = run_all(lambda item: count_nonfinite(item[1]), planes, config.threads)
    bad = Counter[str]()
    for (group, _), count in zip(planes, counts, strict=True):
        bad[group] += count
    if not bad.total():
        return scene, 0
    if config.nonfinite == "error":
        listed = ", ".join(f"{n} in {group}" for group, n in bad.items() if n)
        raise InvalidInput(f"values that are not finite: {listed}; --nonfinite drop removes them")
    keep = np.ones(scene.count, bool)
    for _, row in planes:
        keep &= np.isfinite(row)
    return scene.take(keep), int(np.count_nonzero(~keep))


def _identity_for_zero(scene: Scene) -> tuple[Scene, int]:
    """The scene with quaternions of norm 0 replaced by the identity, and how many there were."""
    zero = ~scene.rot.any(axis=0)
    count = int(np.count_nonzero(zero))
    if count:
        rot = scene.rot.copy()
        rot[0, zero] = 1.0
        scene = replace(scene, rot=rot)
    return scene, count


def _header(scene: Scene, config: Config) -> Header:
    """Blocks as large as the limit allows, all of nearly the same size."""
    blocks = max(-(-scene.count // config.block_size), 1)
    size = max(-(-scene.count // blocks), 1)
    return Header(scene.count, scene.sh_degree, config.profile, size, scene.has_normals)


def _order(scene: Scene, geometry_depth: int, colour_depth: int) -> _Ordered:
    position_quantisers = [fit_range(row, geometry_depth) for row in scene.positions]
    colour_quantisers = [fit_range(row, colour_depth) for row in scene.f_dc]
    order, codes, cells, colours = _sort(scene, position_quantisers, colour_quantisers)
    channels = [
        Channel(group, index, stream, quantiser)
        for group, stream, quantisers in (
            ("positions", "geometry", position_quantisers),
            ("f_dc", "sh-dc", colour_quantisers),
        )
        for index, quantiser in enumerate(quantisers)
    ]
    return _Ordered(order, codes[order], cells[:, order], colours[:, order], channels)


def _sort(
    scene: Scene, position_quantisers: list[Quantiser], colour_quantisers: list[Quantiser]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.uint32], NDArray[np.uint16]]:
    """Canonical order, and what it is made of in the scene's own order."""
    cells = quantise_positions(scene.positions, position_quantisers)
    as_given = np.arange(scene.count)
    colours = np.stack(
        [
            quantise(row, q, as_given)[0]
            for row, q in zip(scene.f_dc, colour_quantisers, strict=True)
        ]
    )
    codes = encode_morton(cells, _depths(position_quantisers))
    return canonical_order(codes, colours), codes, cells, colours


def _depths(quantisers: list[Quantiser]) -> tuple[int, int, int]:
    x, y, z = (q.depth for q in quantisers)
    return x, y, z


def quantise_and_model(scene: Scene, config: Config, progress: Progress | None = None) -> Coded:
    """Symbols, models and tables of the rANS-coded channels, as `encode_scene` makes them."""
    depths = config.resolved_depths()
    ordered = _order(scene, depths["geometry"], depths["sh-dc"])
    return _quantise_and_model(scene, ordered.order, config, progress)


def _quantise_and_model(
    scene: Scene, order: NDArray[np.int64], config: Config, progress: Progress | None
) -> Coded:
    depths = config.resolved_depths()
    places = [p for p in channel_places(len(scene.f_rest) // 3) if p[2] in RANS_STREAMS]
    symbols = np.empty((len(places), scene.count), np.uint16)

    def work(row: int):
        group, index, stream = places[row]
        values = getattr(scene, group)[index]
        scale = None
        if group == "f_rest":
            quantiser, scale = fit_centred(values, depths[stream])
        else:
            quantiser = fit_range(values, depths[stream])
        symbols[row], histogram, clamped = quantise(values, quantiser, order)
        channel = Channel(group, index, stream, quantiser)
        if not quantiser.depth:
            return channel, histogram, None, clamped
        choice = choose_model(histogram, scale, sent_table_bytes)
        return replace(channel, model=choice.model), histogram, choice, clamped

    advance = _counter(progress, "quantise", len(places))
    results = run_all(work, range(len(places)), config.threads, advance)
    varying = [row for row, (_, _, choice, _) in enumerate(results) if choice]
    if len(varying) < len(places):
        symbols = symbols[varying]
    kept = [results[row] for row in varying]
    return Coded(
        channels=[channel for channel, *_ in kept],
        symbols=symbols,
        histograms=[histogram for _, histogram, *_ in kept],
        tables=[choice.table for _, _, choice, _ in kept],
        costs=[_cost(channel, choice) for channel, _, choice, _ in kept],
        constants=[channel for channel, _, choice, _ in results if not choice],
        rectified=sum(clamped for *_, clamped in results),
    )


def _cost(channel: Channel, choice: Choice) -> ChannelCost:
    return ChannelCost(
        channel.name,
        channel.stream,
        choice.model.kind,
        choice.bits,
        choice.parametric_bits,
        choice.shannon_bits,
    )


def _encode_blocks(
    header: Header,
    ordered: _Ordered,
    coded: Coded,
    threads: int | None,
    progress: Progress | None,
) -> list[Section]:
    """Sections of all blocks, block after block."""
    position_depths = _depths([c.quantiser for c in ordered.channels[:3]])
    colour_depths = _depths([c.quantiser for c in ordered.channels[3:]])
    tables = TableSet.pack(coded.tables)

    def geometry(block: int, start: int, stop: int) -> list[Section]:
        if not sum(position_depths):
            return []
        data = encode_geometry(ordered.codes[start:stop], sum(position_depths))
        return [Section(SectionId.GEOMETRY, block, data)]

    def colour(block: int, start: int, stop: int) -> list[Section]:
        if not sum(colour_depths):
            return []
        cells, colours = ordered.cells[:, start:stop], ordered.colours[:, start:stop]
        return [Section(SectionId.SH_DC, block, encode_colour(cells, colours, colour_depths))]

    def symbols(block: int, start: int, stop: int) -> list[Section]:
        if not coded.channels:
            return []
        states, words = encode_symbols(coded.symbols, start, stop, tables)
        sections = [Section(SectionId.STATES, block, states)]
        for stream, section_id in _STREAM_SECTIONS.items():
            members = [w for w, c in zip(words, coded.channels, strict=True) if c.stream == stream]
            if members:
                sections.append(Section(section_id, block, b"".join(members)))
        return sections

    jobs = [
        partial(stage, block, *header.block_range(block))
        for block in range(header.block_count)
        for stage in (geometry, colour, symbols)
    ]
    advance = _counter(progress, "code", len(jobs))
    done = run_all(lambda job: job(), jobs, threads, advance)
    return [section for sections in done for section in sections]


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

    Returns
    -------
    Scene
        In canonical order.

    Raises
    ------
    CorruptStream, TruncatedStream, UnsupportedVersion
    """
    file = read_file(data)
    header = file.header
    limit = max(DECODED_BYTES, EXPANSION * len(data)) if max_bytes is None else max_bytes
    coefficients = SH_COEFFICIENTS[header.sh_degree]
    needed = 4 * header.count * (14 + 3 * coefficients)
    if needed > limit:
        raise CorruptStream(
            f"header: {header.count} Gaussians are {needed} bytes, the limit is {limit}"
        )
    channels = read_channels(file.section(SectionId.CHANNELS), coefficients)
    planes = np.empty((len(channels), header.count), np.float32)
    _check_expected(file, channels)
    _decode_blocks(file, channels, planes, threads, progress)
    rows: dict[str, list[int]] = {group: [] for group in GROUPS}
    for row, channel in sorted(enumerate(channels), key=lambda item: item[1].index):
        rows[channel.group].append(row)
    comments = file.sections.get((SectionId.COMMENTS, 0))
    extra = file.sections.get((SectionId.EXTRA, 0))
    return Scene(
        **{group: planes[rows[group]] for group in GROUPS},
        has_normals=header.has_normals,
        comments=() if comments is None else read_comments(comments),
        extra={} if extra is None else read_extra(extra, header.count),
    )


def _check_expected(file: EgsFile, channels: list[Channel]) -> None:
    """Refuse sections of streams that have no channel to fill."""
    streams = {c.stream for c in channels if c.quantiser.depth}
    expected = {SectionId[name.upper().replace("-", "_")] for name in streams}
    expected |= {SectionId.CHANNELS, SectionId.COMMENTS, SectionId.EXTRA}
    if streams & set(RANS_STREAMS):
        expected.add(SectionId.STATES)
    for section_id, block in file.sections:
        if section_id not in expected:
            label = SectionId(section_id).label
            raise CorruptStream(f"section '{label}' of block {block}: nothing is coded there")


def _decode_blocks(
    file: EgsFile,
    channels: list[Channel],
    planes: NDArray[np.float32],
    threads: int | None,
    progress: Progress | None,
) -> None:
    """Fill `planes` (C, N), rows in the order of `channels`."""
    position_depths = _depths([c.quantiser for c in channels[:3]])
    colour_depths = _depths([c.quantiser for c in channels[3:6]])
    varying = [row for row, c in enumerate(channels) if c.stream in RANS_STREAMS and c.model]
    tables = TableSet.pack(
        [channels[row].model.frequencies(channels[row].alphabet) for row in varying]
    )
    levels = [
        dequantise(np.arange(channels[row].alphabet), channels[row].quantiser) for row in varying
    ]
    for row, channel in enumerate(channels):
        if not channel.quantiser.depth:
            planes[row] = channel.quantiser.origin

    def cloud(block: int, start: int, stop: int) -> None:
        codes = np.zeros(stop - start, np.int64)
        if sum(position_depths):
            data = file.section(SectionId.GEOMETRY, block)
            codes = decode_geometry(
                data, stop - start, sum(position_depths), f"geometry of block {block}"
            )
        cells = decode_morton(codes, position_depths)
        symbols = [cells]
        if sum(colour_depths):
            data = file.section(SectionId.SH_DC, block)
            symbols.append(decode_colour(data, cells, colour_depths, f"sh-dc of block {block}"))
        for row, plane in enumerate(plane for group in symbols for plane in group):
            if channels[row].quantiser.depth:
                planes[row, start:stop] = dequantise(plane, channels[row].quantiser)

    def attributes(block: int, start: int, stop: int) -> None:
        if not varying:
            return
        groups = []
        for stream, section_id in _STREAM_SECTIONS.items():
            members = sum(channels[row].stream == stream for row in varying)
            if members:
                groups.append((members, file.section(section_id, block)))
        states = file.section(SectionId.STATES, block)
        symbols = decode_symbols(states, groups, stop - start, tables, f"block {block}")
        for plane, table, row in zip(symbols, levels, varying, strict=True):
            np.take(table, plane, out=planes[row, start:stop], mode="clip")

    jobs = [
        partial(stage, block, *file.header.block_range(block))
        for block in range(file.header.block_count)
        for stage in (cloud, attributes)
    ]
    run_all(lambda job: job(), jobs, threads, _counter(progress, "decode", len(jobs)))


def order_like(scene: Scene, quantisers: list[Quantiser]) -> NDArray[np.int64]:
    """The order in which `scene` is coded under the quantisers of x, y, z and f_dc."""
    return _sort(scene, quantisers[:3], quantisers[3:])[0]


def _counter(progress: Progress | None, stage: str, total: int) -> Callable[[], None] | None:
    """A callback that counts the steps of a stage."""
    if progress is None:
        return None
    done = 0

    def advance() -> None:
        nonlocal done
        done += 1
        progress(stage, done, total)

    return advance

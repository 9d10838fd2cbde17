"""Describe a file from its header and descriptive sections, without decoding its blocks.

Those sections are the index, channels or lattices, and the version lines of external coders.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from gs_codec.codecs.adaptive.contexts import ContextList, passes
from gs_codec.codecs.adaptive.lattice import FRACTION_BITS, Lattice, PositionGrid
from gs_codec.codecs.adaptive.rotation import rules_of
from gs_codec.codecs.adaptive.section import PassModels, far_count, lattice_of
from gs_codec.codecs.adaptive.step_sizes import SHAPE_RULES
from gs_codec.codecs.skipped import skipped_by_channels, skipped_by_header, skipped_by_passes
from gs_codec.config import ADAPTIVE_PROFILES, LOSSLESS
from gs_codec.egs.egs_file import (
    EgsFile,
    Readable,
    SectionId,
    section_label,
)
from gs_codec.egs.frame_sections import read_described
from gs_codec.egs.index import Box, bounds_of, errors_of, levels_of, open_level
from gs_codec.egs.sections import read_line
from gs_codec.scene import SH_COEFFICIENTS

if TYPE_CHECKING:
    from gs_codec.codecs.entropygs.section import Channel


@dataclass(frozen=True)
class StreamInfo:
    """Size of one kind of section, all blocks together.

    Attributes
    ----------
    name : str
        Name of the section, as in FORMAT.md.
    bytes : int
        Size of all sections of that kind.
    bits_per_gaussian : float
        The same size, in bits per Gaussian of the file.
    tables : int
        Number of frequency tables of its passes; 0 if it has none.

    Examples
    --------
    >>> sizes = {stream.name: stream.bytes for stream in gs_codec.inspect("scene.egs").streams}
    >>> sizes["sh3"] > sizes["sh-dc"] > sizes["header"]
    True
    """

    name: str
    bytes: int
    bits_per_gaussian: float
    tables: int


@dataclass(frozen=True)
class PassInfo:
    """One kind of symbols of profiles `l`, `m` and `s`: its tables and step sizes.

    Attributes
    ----------
    name : str
        What the symbols code.
    stream : str
        The stream with these symbols.
    tables : int
        Number of frequency tables of its contexts.
    finest_step, coarsest_step : float
        Step sizes, in the attribute's own domain.

    Examples
    --------
    >>> found = {each.name: each for each in gs_codec.inspect("scene.egs").passes}
    >>> found["opacity"].stream, found["opacity"].finest_step < found["opacity"].coarsest_step
    ('opacity', True)
    """

    name: str
    stream: str
    tables: int
    finest_step: float
    coarsest_step: float


@dataclass(frozen=True)
class LevelInfo:
    """A coarser level of detail of a file.

    Attributes
    ----------
    level : int
        Level 1 has a quarter of the Gaussians of the file, level 2 a sixteenth, ...
    count, blocks : int
        Number of Gaussians and of blocks.
    bytes : int
        Size of its section.
    least_error, largest_error : float
        Errors of its blocks, scene units. At the distance where a block's error is one pixel, it
        replaces four blocks of the next finer level.

    Examples
    --------
    >>> data = gs_codec.encode("scene.ply", gs_codec.Config(lod=True, block_size=1024))
    >>> [level] = gs_codec.inspect(data).levels
    >>> level.level, level.count, level.largest_error > 0
    (1, 500, True)
    """

    level: int
    count: int
    blocks: int
    bytes: int
    least_error: float
    largest_error: float


@dataclass(frozen=True, kw_only=True)
class Info:
    """Everything that `inspect` reports, from a file's header, index and tables alone.

    Attributes
    ----------
    version : int
        Format version of the file.
    count : int
        Number of Gaussians.
    sh_degree : int
        0-3.
    profile : str
        Profile, as `Config` names it.
    features : tuple of str
        Features that a reader must support besides the profile: ``G-PCC``, ``torchac``.
    blocks, block_size : int
        Number of independent blocks, and maximum Gaussians per block.
    has_normals : bool
        Whether the source had all-zero normals.
    keeps_order : bool
        Whether the Gaussians are in the source's order.
    geometry : str
        Coder of positions: ``octree``, ``gpcc`` (SH-DC too), or ``columns`` (`lossless`).
    tool : str or None
        With ``gpcc``, the version line of the program that coded the positions.
    coder : str
        Entropy coder of attributes: ``rans``, ``pcodec`` (`lossless`), or torchac's version line.
    bounds : tuple of two tuples of float, or None
        Lowest and highest x, y, z of the centres; None without Gaussians.
    file_bytes : int
        Size of the file.
    raw_bytes : int
        Size of the same attributes as float32.
    streams : tuple of StreamInfo
        In stream order; ``header`` includes the section table.
    channels : tuple of Channel
        Quantiser and model of each channel, with a `paper` profile.
    passes : tuple of PassInfo
        Kinds of symbols with profiles `l`, `m` and `s`, in stream order.
    grid : PositionGrid or None
        Grid of positions, with profiles `l`, `m` and `s`.
    coordinates : str or None
        Directions of x, y and z, if stated: three letters such as ``RDF`` (right, down, forward) or
        ``RUB`` (right, up, back).
    antialiased : bool
        Whether the scene uses opacity compensation.
    far : int
        Number of far Gaussians: those outside the grid, whose centres are stored exactly.
    skipped : tuple of str
        Sentences on what takes no bits, derived from header and tables.
    levels : tuple of LevelInfo
        Coarser levels of detail, the finest first.

    Examples
    --------
    >>> info = gs_codec.inspect("scene.egs")
    >>> info.version, info.blocks, info.geometry, info.ratio > 5
    (1, 1, 'octree', True)
    """

    version: int
    count: int
    sh_degree: int
    profile: str
    features: tuple[str, ...]
    blocks: int
    block_size: int
    has_normals: bool
    keeps_order: bool
    geometry: str
    tool: str | None
    coder: str
    bounds: Box | None
    file_bytes: int
    raw_bytes: int
    streams: tuple[StreamInfo, ...]
    channels: tuple[Channel, ...] = ()
    passes: tuple[PassInfo, ...] = ()
    grid: PositionGrid | None = None
    coordinates: str | None
    antialiased: bool
    far: int = 0
    skipped: tuple[str, ...]
    levels: tuple[LevelInfo, ...] = ()

    @property
    def ratio(self) -> float:
        """Compression ratio: raw bytes divided by file bytes."""
        return self.raw_bytes / self.file_bytes

    def as_dict(self) -> dict[str, Any]:
        """Convert to plain types, for JSON."""
        plain = dict(vars(self), ratio=self.ratio)
        plain["streams"] = [vars(stream) for stream in self.streams]
        plain["channels"] = [_channel_dict(channel) for channel in self.channels]
        plain["grid"] = None if self.grid is None else vars(self.grid)
        plain["passes"] = [vars(item) for item in self.passes]
        plain["levels"] = [vars(level) for level in self.levels]
        return plain

    def _repr_html_(self) -> str:
        """A table of the streams, for notebooks."""
        from gs_codec.pages.tables import Table
        from gs_codec.runtime.wording import counted, size_text

        size = f"{size_text(self.file_bytes)}, {self.ratio:.2f}x relative to the floats"
        caption = f"{counted(self.count, 'Gaussian')}, profile {self.profile}, {size}"
        rows = [[s.name, f"{s.bytes:,}", f"{s.bits_per_gaussian:.3f}"] for s in self.streams]
        return Table(["stream", "bytes", "bits/Gaussian"], rows).html(caption)


def inspect_bytes(data: bytes | Readable) -> Info:
    """Describe a stream from its header and descriptive sections, without decoding its blocks.

    Raises CorruptStream, TruncatedStream or UnsupportedVersion.
    """
    return describe(read_described(data))


def describe(file: EgsFile) -> Info:
    """Describe a file from its header and descriptive sections."""
    header = file.header
    details, coder = _channel_details, "octree"
    if header.profile in ADAPTIVE_PROFILES:
        details = _adaptive_details
    elif header.profile == LOSSLESS:
        details, coder = _lossless_details, "columns"
    tool, packed = (read_line(file, section) for section in (SectionId.TOOL, SectionId.CODER))
    return Info(
        version=file.version,
        count=header.count,
        sh_degree=header.sh_degree,
        profile=header.profile,
        features=header.features.labels,
        blocks=header.block_count,
        block_size=header.block_size,
        has_normals=header.has_normals,
        keeps_order=header.keeps_order,
        geometry=coder if tool is None else "gpcc",
        tool=tool,
        coder=packed or ("pcodec" if header.profile == LOSSLESS else "rans"),
        file_bytes=len(file.data),
        raw_bytes=header.float_bytes,
        streams=_streams(file),
        coordinates=header.coordinates,
        antialiased=header.antialiased,
        far=far_count(file),
        bounds=bounds_of(file),
        levels=tuple(_level_info(file, level) for level in levels_of(file)),
        **details(file),
    )


def _level_info(file: EgsFile, level: int) -> LevelInfo:
    found = open_level(file, level)
    errors, size = errors_of(found), file.sizes[SectionId.LEVEL, level]
    ends = float(errors.min()), float(errors.max())
    return LevelInfo(level, found.header.count, found.header.block_count, size, *ends)


def _streams(file: EgsFile) -> tuple[StreamInfo, ...]:
    sizes = {"header": file.header_size}
    for (section_id, _), size in sorted(file.sizes.items()):
        label = section_label(section_id)
        sizes[label] = sizes.get(label, 0) + size
    count = max(file.header.count, 1)
    tables: dict[str, set[int]] = {}
    if file.header.profile in ADAPTIVE_PROFILES:
        models = lattice_of(file)[1]
        for item in passes(SH_COEFFICIENTS[file.header.sh_degree]):
            for own in item.lists:
                tables.setdefault(own.stream, set()).update(models.listed[own.name].tolist())
    return tuple(
        StreamInfo(name, size, 8 * size / count, len(tables.get(name, ())))
        for name, size in sizes.items()
    )


def _adaptive_details(file: EgsFile) -> dict[str, Any]:
    """Fields of `Info` for profiles `l`, `m` and `s`."""
    coefficients = SH_COEFFICIENTS[file.header.sh_degree]
    lattice, models = lattice_of(file)
    skipped = skipped_by_header(file.header)
    if file.header.count:
        skipped += skipped_by_passes(lattice, models, coefficients)
    return {
        "passes": tuple(_inspect_passes(lattice, models, coefficients)),
        "grid": lattice.grid,
        "skipped": tuple(skipped),
    }


def _channel_details(file: EgsFile) -> dict[str, Any]:
    """Fields of `Info` for `paper` profiles."""
    from gs_codec.codecs.entropygs.section import channels_of

    channels = channels_of(file)
    skipped = skipped_by_header(file.header)
    if file.header.count:
        skipped += skipped_by_channels(channels)
    return {"channels": tuple(channels), "skipped": tuple(skipped)}


def _lossless_details(file: EgsFile) -> dict[str, Any]:
    """Fields of `Info` for profile `lossless`."""
    return {"skipped": tuple(skipped_by_header(file.header))}


def _inspect_passes(lattice: Lattice, models: PassModels, coefficients: int) -> list[PassInfo]:
    listed = []
    for item in (own for one in passes(coefficients) for own in one.lists):
        unit, limit = _steps(lattice, item)
        tables = len(np.unique(models.listed[item.name]))
        listed.append(PassInfo(item.name, item.stream, tables, unit, unit * 2.0**limit))
    return listed


def _steps(lattice: Lattice, item: ContextList) -> tuple[float, int]:
    """The finest step size of some symbols, and the range of step sizes in octaves."""
    if item.stream == "classes" or item.name.startswith("SH sum"):
        return 1.0, 0
    used = rules_of(item.name) if item.stream in SHAPE_RULES else ("colour",)
    limit = max(lattice.rules[name].limit for name in used)
    return lattice.units[item.stream] / (1 << FRACTION_BITS), limit


def _channel_dict(channel: Channel) -> dict:
    from gs_codec.codecs.entropygs.section import RANS_STREAMS

    quantiser = channel.quantiser
    plain = {
        "name": channel.name,
        "stream": channel.stream,
        "quantiser": quantiser.kind,
        "depth": quantiser.depth,
        "origin": quantiser.origin,
        "step": quantiser.step,
    }
    if channel.model is not None:
        plain["model"] = channel.model.kind
        plain["precision"] = channel.model.precision
        plain["parameters"] = channel.model.describe()
    elif channel.stream in RANS_STREAMS:
        plain["model"] = "constant"
    return plain

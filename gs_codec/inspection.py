"""What a file says of itself, read from its header and `channels` or `box` section alone."""

from __future__ import annotations

from dataclasses import dataclass

from gs_codec.config import LOSSLESS
from gs_codec.container.box import Box, read_box
from gs_codec.container.channels import RANS_STREAMS, Channel, read_channels
from gs_codec.container.file import VERSION, EgsFile, SectionId, read_file
from gs_codec.scene import SH_COEFFICIENTS


@dataclass(frozen=True)
class StreamInfo:
    """Bytes of one kind of section, blocks together, and bits for each Gaussian."""

    name: str
    bytes: int
    bits_per_gaussian: float


@dataclass(frozen=True)
class Info:
    """Everything `inspect` knows.

    Attributes
    ----------
    version, count, sh_degree, profile, blocks, block_size, has_normals, keeps_order
        As in the header.
    bounds : tuple of two tuples of float
        Lowest and highest x, y, z of the centres.
    file_bytes : int
    raw_bytes : int
        Size of the same attributes as float32.
    streams : tuple of StreamInfo
        In stream order; ``header`` includes the section table.
    channels : tuple of Channel
        Quantiser and model of each channel; none where every bit is kept.
    """

    version: int
    count: int
    sh_degree: int
    profile: str
    blocks: int
    block_size: int
    has_normals: bool
    keeps_order: bool
    bounds: Box
    file_bytes: int
    raw_bytes: int
    streams: tuple[StreamInfo, ...]
    channels: tuple[Channel, ...]

    @property
    def ratio(self) -> float:
        """Raw bytes for each byte of the file."""
        return self.raw_bytes / self.file_bytes

    def as_dict(self) -> dict:
        """The same as plain types, for JSON."""
        plain = dict(vars(self), ratio=self.ratio)
        plain["streams"] = [vars(stream) for stream in self.streams]
        plain["channels"] = [_channel_dict(channel) for channel in self.channels]
        return plain


def inspect_bytes(data: bytes | memoryview) -> Info:
    """Read the header and what is read with it of a stream; the rest is not touched.

    Raises
    ------
    CorruptStream, TruncatedStream, UnsupportedVersion
    """
    file = read_file(data, header_only=True)
    header = file.header
    channels, bounds = _channels_and_bounds(file)
    sizes = {"header": file.header_size}
    for (section_id, _), size in sorted(file.sizes.items()):
        known = section_id in set(SectionId)
        label = SectionId(section_id).label if known else f"section {section_id}"
        sizes[label] = sizes.get(label, 0) + size
    return Info(
        version=VERSION,
        count=header.count,
        sh_degree=header.sh_degree,
        profile=header.profile,
        blocks=header.block_count,
        block_size=header.block_size,
        has_normals=header.has_normals,
        keeps_order=header.keeps_order,
        bounds=bounds,
        file_bytes=len(data),
        raw_bytes=header.float_bytes,
        streams=tuple(
            StreamInfo(name, size, 8 * size / max(header.count, 1)) for name, size in sizes.items()
        ),
        channels=tuple(channels),
    )


def _channels_and_bounds(file: EgsFile) -> tuple[list[Channel], Box]:
    """The channels, if there are quantisers, and the box of the centres."""
    if file.header.profile == LOSSLESS:
        return [], read_box(file.section(SectionId.BOX))
    coefficients = SH_COEFFICIENTS[file.header.sh_degree]
    channels = read_channels(file.section(SectionId.CHANNELS), coefficients)
    axes = [channel.quantiser for channel in channels[:3]]
    top = [axis.origin + axis.step * ((1 << axis.depth) - 1) for axis in axes]
    return channels, (tuple(axis.origin for axis in axes), tuple(top))


def _channel_dict(channel: Channel) -> dict:
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

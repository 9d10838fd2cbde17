"""The ``channels`` section: quantiser and model of every channel. FORMAT.md, "Channels"."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from dataclasses import astuple, dataclass, replace

import numpy as np

from gs_codec.codecs.entropygs.models import Model, pack_model, unpack_model
from gs_codec.coding.fields import ByteReader
from gs_codec.coding.frequency_table import SentModel, decode_tables, encode_tables
from gs_codec.coding.quantise import CentredQuantiser, ConstantQuantiser, Quantiser, RangeQuantiser
from gs_codec.config import DEPTH_GROUPS, MAX_DEPTH, SH_STREAMS
from gs_codec.egs.egs_file import EgsFile, SectionId
from gs_codec.errors import CorruptStream
from gs_codec.scene import GROUPS, SH_COEFFICIENTS, group_rows, property_names, sh_bands

_QUANTISERS = (ConstantQuantiser, RangeQuantiser, CentredQuantiser)
_WHERE = "section 'channels'"
_NAMES = property_names()

#: Streams of rANS-coded channels, in the order in which they share states.
RANS_STREAMS = DEPTH_GROUPS[2:]


@dataclass(frozen=True)
class Channel:
    """How one channel is quantised and, if rANS-coded, modelled.

    Attributes
    ----------
    group : str
        Attribute: ``positions``, ``f_dc``, ``f_rest``, ``opacity``, ``log_scale`` or ``rot``.
    index : int
        Row in the attribute.
    stream : str
        The stream of its symbols, named like its depth group.
    quantiser : Quantiser
        Kind, depth (bits), origin and step.
    model : Model or None
        Mixture, Laplace or sent table; None if constant or not coded by rANS.

    Examples
    --------
    >>> channels = gs_codec.inspect(gs_codec.encode("scene.ply", "paper-m")).channels
    >>> channels[0].name, channels[0].quantiser.depth, channels[0].model
    ('x', 16, None)
    >>> type(channels[-1].model).__name__
    'LaplaceModel'
    """

    group: str
    index: int
    stream: str
    quantiser: Quantiser
    model: Model | None = None

    @property
    def alphabet(self) -> int:
        """Number of symbols."""
        return 1 << self.quantiser.depth

    @property
    def name(self) -> str:
        """Property name in the PLY."""
        return _NAMES[self.group][self.index]


def channel_order(coefficients: int) -> list[tuple[str, int, str]]:
    """Group, index in the group, and stream of each channel, in stream order.

    `coefficients` is the number of SH-AC coefficients of a colour; streams are named as in
    `DEPTH_GROUPS`.
    """
    streams = [group for group in GROUPS if group != "f_rest"]
    rows = group_rows(coefficients)
    keys = [
        (group, index, stream)
        for group, stream in zip(streams, DEPTH_GROUPS, strict=False)
        for index in range(rows[group])
    ]
    for stream, band in zip(SH_STREAMS, sh_bands(coefficients), strict=False):
        keys += [("f_rest", colour * coefficients + i, stream) for colour in range(3) for i in band]
    return keys


def write_channels(channels: Iterable[Channel]) -> bytes:
    """Serialise channels given in stream order."""
    out = bytearray()
    sent: list[SentModel] = []
    for channel in channels:
        out += _pack_quantiser(channel.quantiser)
        if channel.model is None:
            continue
        out += pack_model(channel.model)
        if isinstance(channel.model, SentModel):
            sent.append(channel.model)
    return bytes(out) + encode_tables([m.weights for m in sent], [m.mantissa for m in sent])


def channels_of(file: EgsFile) -> list[Channel]:
    """The channels of a file, in stream order."""
    coefficients = SH_COEFFICIENTS[file.header.sh_degree]
    return file.parsed(SectionId.CHANNELS, lambda data: read_channels(data, coefficients))


def read_channels(data: memoryview, coefficients: int) -> list[Channel]:
    """Invert `write_channels`, for `coefficients` SH-AC coefficients per colour.

    Raises TruncatedStream or CorruptStream.
    """
    reader = ByteReader(data, _WHERE)
    channels = []
    for group, index, stream in channel_order(coefficients):
        channel = Channel(group, index, stream, _unpack_quantiser(reader, stream))
        if stream in RANS_STREAMS and channel.quantiser.depth:
            where = f"{_WHERE}: '{channel.name}'"
            model = unpack_model(reader, channel.quantiser.depth, where)
            channel = replace(channel, model=model)
        channels.append(channel)
    return _fill_tables(channels, reader.rest())


def _fill_tables(channels: list[Channel], data: memoryview) -> list[Channel]:
    sent = [(c.alphabet, c.model.mantissa) for c in channels if isinstance(c.model, SentModel)]
    alphabets, mantissas = [a for a, _ in sent], [m for _, m in sent]
    tables = iter(decode_tables(data, alphabets, mantissas, _WHERE))
    filled = []
    for channel in channels:
        if isinstance(channel.model, SentModel):
            model = replace(channel.model, weights=next(tables))
            if np.count_nonzero(model.weights) > 1 << model.precision:
                raise CorruptStream(f"{_WHERE}: more symbols than slots in '{channel.name}'")
            channel = replace(channel, model=model)
        filled.append(channel)
    return filled


def _pack_quantiser(quantiser: Quantiser) -> bytes:
    kind = _QUANTISERS.index(type(quantiser))
    layout = "<BBff" if quantiser.depth else "<Bf"
    return struct.pack(layout, kind, *astuple(quantiser))


def _unpack_quantiser(reader: ByteReader, stream: str) -> Quantiser:
    kind = reader.unpack("B")[0]
    if kind >= len(_QUANTISERS):
        raise CorruptStream(f"{_WHERE}: quantiser {kind}, expected 0-{len(_QUANTISERS) - 1}")
    if kind == 0:
        value = reader.unpack("f")[0]
        if not math.isfinite(value):
            raise CorruptStream(f"{_WHERE}: constant {value}, expected a finite number")
        return ConstantQuantiser(value)
    depth, first, second = reader.unpack("Bff")
    limit = MAX_DEPTH[stream]
    if not 1 <= depth <= limit:
        raise CorruptStream(f"{_WHERE}: depth {depth}, expected 1-{limit}")
    ordered = first < second if kind == 1 else second > 0
    if not (math.isfinite(first) and math.isfinite(second) and ordered):
        raise CorruptStream(f"{_WHERE}: quantiser of range {first}, {second}")
    return (
        RangeQuantiser(depth, first, second)
        if kind == 1
        else CentredQuantiser(depth, first, second)
    )

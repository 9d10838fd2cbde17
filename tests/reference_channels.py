"""Profiles 0-2 of the reference decoder: Annexes A and B, without G-PCC.

Written only from FORMAT.md; shares no code with the codec, and favours clarity over speed.
"""

from dataclasses import dataclass
from itertools import pairwise

from reference_tools import (
    LANES,
    BinaryCoder,
    RawBits,
    Reader,
    axes_of,
    cells_of,
    check,
    check_last_states,
    crc32c,
    finite,
    first_states,
    frequencies,
    neighbours_of,
    rans_symbol,
    read_tree,
    rounded,
    sent_tables,
    table_of,
)

GEOMETRY, SH_DC, STATES, OPACITY, SCALING, ROTATION, SH_1, SH_2, SH_3 = range(2, 11)
CODED = (OPACITY, SCALING, ROTATION, SH_1, SH_2, SH_3)
BANDS = ((SH_1, range(3)), (SH_2, range(3, 8)), (SH_3, range(8, 15)))


@dataclass
class Channel:
    """A property, the section of its stream, its quantiser and its table."""

    name: str
    stream: int
    depth: int = 0
    first: float = 0.0
    step: float = 0.0
    table: object = None
    precision: int = 0

    @property
    def varies(self):
        return self.depth > 0

    def values(self, symbols):
        """Values of symbols (section "Quantisers")."""
        return rounded([self.first + q * self.step for q in symbols])


def channels_of(sh_degree):
    """Channels in stream order, without quantisers."""
    names = [(GEOMETRY, name) for name in "xyz"]
    names += [(SH_DC, f"f_dc_{c}") for c in range(3)]
    names += [(OPACITY, "opacity")]
    names += [(SCALING, f"scale_{k}") for k in range(3)]
    names += [(ROTATION, f"rot_{k}") for k in range(4)]
    coefficients = (sh_degree + 1) ** 2 - 1
    for stream, band in BANDS[:sh_degree]:
        names += [(stream, f"f_rest_{c * coefficients + i}") for c in range(3) for i in band]
    return [Channel(name, stream) for stream, name in names]


def read_channels(content, sh_degree):
    """Channels with quantisers and tables, of the section `channels`."""
    reader = Reader(content, "channels")
    channels = channels_of(sh_degree)
    sent = []
    for channel in channels:
        read_quantiser(reader, channel)
        if channel.stream in CODED and channel.varies:
            kind, channel.precision, found = read_model(reader, 1 << channel.depth)
            if kind == 2:
                sent.append((channel, found))
            else:
                channel.table = table_of(frequencies(found, channel.precision))
    shapes = [(1 << channel.depth, mantissa) for channel, mantissa in sent]
    for (channel, _), weights in zip(sent, sent_tables(reader.rest(), shapes), strict=False):
        channel.table = table_of(frequencies(weights, channel.precision))
    return channels


# Section "Quantisers"


def read_quantiser(reader, channel):
    kind = reader.u8()
    check(kind <= 2, f"channels: {channel.name}: quantiser of kind {kind}")
    if kind == 0:
        channel.first = reader.f32()
        check(finite(channel.first), f"channels: {channel.name}: value is not finite")
        return
    depth, low, high = reader.numbers("Bff")
    most = 21 if channel.stream == GEOMETRY else 12
    check(1 <= depth <= most, f"channels: {channel.name}: depth {depth}")
    check(finite(low, high), f"channels: {channel.name}: parameters are not finite")
    channel.depth = depth
    if kind == 1:
        check(low < high, f"channels: {channel.name}: low is not below high")
        channel.first, channel.step = low, (high - low) / (2**depth - 1)
    else:
        check(high > 0, f"channels: {channel.name}: half_range is not above 0")
        channel.step = (2 * high) / (2**depth - 1)
        channel.first = low - 2 ** (depth - 1) * channel.step


# Section "Models"


def read_model(reader, size):
    """Kind, precision, and the weights (the mantissa bits, of kind 2)."""
    kind, precision = reader.u8(), reader.u8()
    check(kind <= 2, f"channels: model of kind {kind}")
    check(8 <= precision <= 15, f"channels: precision {precision}")
    check(1 << precision >= size, f"channels: precision {precision} of {size} symbols")
    if kind == 0:
        return kind, precision, laplace_weights(reader, size)
    if kind == 1:
        return kind, precision, mixture_weights(reader, size)
    mantissa = reader.u8()
    check(mantissa <= 15, f"channels: {mantissa} mantissa bits")
    return kind, precision, mantissa


def model_frequencies(content, size):
    """Frequencies of `size` symbols from a model of kind 0 or 1, given as bytes."""
    reader = Reader(content, "model")
    kind, precision, weights = read_model(reader, size)
    reader.finish()
    check(kind < 2, "model: kind 2 has its weights elsewhere")
    return frequencies(weights, precision)


def weights_of(cumulative):
    return [max(above - below, 1) for below, above in pairwise(cumulative)]


def laplace_weights(reader, size):
    decay = reader.u16()
    check(decay >= 1, "channels: decay 0")
    half = size // 2
    tail = [decay << 15]
    while len(tail) < half:
        tail.append((((tail[-1] * decay) >> 16) * decay) >> 16)
    below = [tail[half - q] for q in range(1, half + 1)]
    above = [(1 << 32) - tail[q - half - 1] for q in range(half + 1, size)]
    return weights_of([0, *below, *above, 1 << 32])


def mixture_weights(reader, size):
    count = reader.u8()
    check(1 <= count <= 4, f"channels: {count} components")
    components = [reader.numbers("HII") for _ in range(count)]
    for weight, _, sigma in components:
        check(weight >= 1 and sigma >= 1, "channels: weight or sigma 0")
    cumulative = [0]
    for q in range(1, size):
        edge = (q << 16) - (1 << 15)
        total = sum(weight * normal(edge, mean, sigma) for weight, mean, sigma in components)
        cumulative.append(total >> 16)
    cumulative.append(sum(weight << 30 for weight, _, _ in components) >> 16)
    return weights_of(cumulative)


def normal(edge, mean, sigma):
    """The normal distribution function at an edge, in 1 / 2^30."""
    z = min((abs(edge - mean) << 16) // sigma, (1 << 19) - 1)
    i = z >> 10
    found = NORMAL[i] + (((NORMAL[i + 1] - NORMAL[i]) * (z & 1023)) >> 10)
    return (1 << 30) - found if edge < mean else found


def normal_table():
    """T_0 to T_512 (Annex B)."""
    density, ratio = 1 << 60, 1152780775708076725
    factor = (ratio * ratio) >> 60
    sums = [0]
    for _ in range(512):
        following = (density * ratio) >> 60
        sums.append(sums[-1] + density + following)
        density, ratio = following, (ratio * factor) >> 60
    return [(1 << 29) + ((1 << 29) * found) // sums[-1] for found in sums]


NORMAL = normal_table()


# Blocks


def expected_sections(channels, torchac):
    """Ids of the sections that each block has (table of sections)."""
    ids = {channel.stream for channel in channels if channel.varies}
    if ids & set(CODED) and not torchac:
        ids.add(STATES)
    return ids


def decode_block(channels, sections, count, torchac):
    """Symbols of each varying channel, by name."""
    symbols = {}
    cells = [[0, 0, 0]] * count
    if GEOMETRY in sections:
        cells = read_geometry(sections[GEOMETRY], channels[:3], count)
        for axis, channel in enumerate(channels[:3]):
            if channel.varies:
                symbols[channel.name] = [cell[axis] for cell in cells]
    if SH_DC in sections:
        symbols.update(read_sh_dc(sections[SH_DC], channels[3:6], cells))
    coded = [channel for channel in channels if channel.stream in CODED and channel.varies]
    if torchac:
        symbols.update(read_torchac(coded, sections, count))
    elif coded:
        symbols.update(read_rans(coded, sections, count))
    return symbols


def read_geometry(content, channels, count):
    """Cells of the points (section "Geometry of channels")."""
    reader = Reader(content, "geometry")
    coded = reader.take(reader.u32())
    raw = RawBits(reader.rest(), "geometry")
    axes = axes_of([channel.depth for channel in channels])
    cells = []
    for leaf in read_tree(coded, count, len(axes)):
        code = (leaf.prefix << leaf.missing) + (raw.take(leaf.missing) if leaf.count == 1 else 0)
        cells += [cells_of(code, axes)] * leaf.count
    raw.finish()
    return cells


# Section "SH-DC"


def read_sh_dc(content, channels, points):
    """Symbols of f_dc, by name."""
    coder = BinaryCoder(content, 9408, "sh-dc")
    red, green, blue = (channel.varies for channel in channels)
    kinds = [kind for kind, varies in enumerate((green, red, blue)) if varies]
    values = [[0] * len(points) for _ in range(3)]
    for i in range(len(points)):
        neighbours = neighbours_of(points, i)
        residual = 0
        for kind in kinds:
            guess, spread = neighbours.predict(values[kind])
            activity = min((4 * spread // max(neighbours.total, 1)).bit_length(), 13)
            size = min(abs(residual).bit_length() >> 1, 3)
            residual = read_residual(coder, 56 * ((14 * kind + activity) * 4 + size))
            values[kind][i] = guess + residual
    coder.finish()
    base = values[0]
    planes = [[v + g for v, g in zip(values[1], base, strict=False)], base]
    planes.append([v + g for v, g in zip(values[2], base, strict=False)])
    return checked_symbols(channels, planes)


def checked_symbols(channels, planes):
    found = {}
    for channel, plane in zip(channels, planes, strict=False):
        if channel.varies:
            inside = all(0 <= symbol < 1 << channel.depth for symbol in plane)
            check(inside, f"sh-dc: a symbol of {channel.name} is out of range")
            found[channel.name] = plane
    return found


def read_residual(coder, base):
    bits = 0
    while bits < 13 and coder.bit(base + bits):
        bits += 1
    if bits == 0:
        return 0
    negative = coder.bit(base + 14)
    size = 1
    for j in range(bits - 1):
        size = 2 * size + coder.bit(base + 14 * (1 + min(j, 2)) + bits)
    return -size if negative else size


# Section "rANS of channels"


def read_rans(channels, sections, count):
    states = first_states(Reader(sections[STATES], "states"), min(LANES, count))
    symbols = {}
    for stream in CODED:
        here = [channel for channel in channels if channel.stream == stream]
        words = Reader(sections.get(stream, b""), f"section {stream}")
        for channel in here:
            symbols[channel.name] = [
                rans_symbol(states, i % LANES, channel.table, channel.precision, words)
                for i in range(count)
            ]
        words.finish()
    check_last_states(states)
    return symbols


# Section "Torchac"


def read_torchac(channels, sections, count):
    symbols = {}
    for stream in CODED:
        here = [channel for channel in channels if channel.stream == stream]
        if not here:
            continue
        reader = Reader(sections[stream], f"section {stream}")
        checksum = reader.u32()
        coded = b""
        for channel in here:
            found = read_torchac_channel(reader, channel, count)
            coded += b"".join(symbol.to_bytes(2, "little") for symbol in found)
            symbols[channel.name] = found
        reader.finish()
        check(crc32c(coded) == checksum, f"section {stream}: symbols of another checksum")
    return symbols


def read_torchac_channel(reader, channel, count):
    run = 1 << (22 - channel.depth)
    symbols = []
    for first in range(0, count, run):
        coded = reader.take(reader.u32())
        symbols += read_torchac_run(coded, channel, min(run, count - first))
    return symbols


def read_torchac_run(data, channel, count):
    low, high, at = 0, 0xFFFFFFFF, 32
    code = int.from_bytes(data[:4].ljust(4, b"\0"), "big")
    more = 16 - channel.precision
    table, symbols = channel.table, []
    for _ in range(count):
        size = high - low + 1
        symbol = table.symbol((((code - low + 1) << 16) - 1) // size >> more)
        symbols.append(symbol)
        begin, end = table.starts[symbol], table.starts[symbol] + table.frequencies[symbol]
        high = low - 1 + ((size * (end << more)) >> 16)
        low += (size * (begin << more)) >> 16
        while (taken := common(low, high)) is not None:
            bit = (data[at // 8] >> (7 - at % 8)) & 1 if at < 8 * len(data) else 0
            low, high = 2 * (low - taken), 2 * (high - taken) + 1
            code, at = 2 * (code - taken) + bit, at + 1
    return symbols


def common(low, high):
    """The result of step 3 for the three numbers; None if the next symbol follows."""
    if low >= 1 << 31:
        return 1 << 31
    if high < 1 << 31:
        return 0
    if low >= 1 << 30 and high < 3 << 30:
        return 1 << 30
    return None

"""Slow decoder of `.egs` files in plain Python, written from ``gs_codec/egs/FORMAT.md`` alone.

It shares no code with ``gs_codec``, so that the tests tell an error of the text from an error of
the codec. The comments name the sections of the text. numpy only rounds binary64 to binary32 and
holds the results; columns of lossless files are pcodec's own business.
"""

import struct
import zlib
from bisect import bisect_right
from dataclasses import dataclass, field
from functools import cache
from heapq import heapify, heapreplace
from itertools import pairwise
from math import sqrt

import numpy as np
from pcodec.wrapped import FileDecompressor

MAGIC = b"\x89EGS\r\n\x1a\n"
CHANNELS, GEOMETRY, SH_DC, STATES, COMMENTS, EXTRA, BOX, CODER = 1, 2, 3, 4, 11, 12, 17, 20
LOSSLESS = 6
RANS_STREAMS = (5, 6, 7, 8, 9, 10)
BLOCK_SECTIONS = (GEOMETRY, SH_DC, STATES, *RANS_STREAMS)
BLOCK_SECTIONS_OF_LATTICES = (14, 15)
EXTRA_DTYPES = ("<i1", "<u1", "<i2", "<u2", "<i4", "<u4", "<f4", "<f8")
LANES = 32
STATE_MIN = 1 << 16


def check(condition, text):
    if not condition:
        raise ValueError(text)


@dataclass
class Channel:
    name: str
    stream: int
    depth: int = 0  # 0: constant
    origin: float = 0.0  # binary64
    step: float = 0.0
    precision: int = 0
    mantissa_bits: int = 0
    weights: list | None = None
    starts: list = field(default_factory=list)
    frequencies: list = field(default_factory=list)


class Reader:
    def __init__(self, data, place):
        self.data, self.place, self.position = data, place, 0

    def bytes(self, size):
        end = self.position + size
        check(
            end <= len(self.data), f"{self.place}: {len(self.data)} bytes, expected at least {end}"
        )
        self.position = end
        return self.data[end - size : end]

    def take(self, layout):
        values = struct.unpack("<" + layout, self.bytes(struct.calcsize("<" + layout)))
        return values if len(values) > 1 else values[0]

    def rest(self):
        return self.bytes(len(self.data) - self.position)


# File


@cache
def crc_table():
    table = []
    for value in range(256):
        for _ in range(8):
            value = (value >> 1) ^ (0x82F63B78 if value & 1 else 0)
        table.append(value)
    return table


def crc32c(data):
    table, crc = crc_table(), 0xFFFFFFFF
    for byte in data:
        crc = (crc >> 8) ^ table[(crc ^ byte) & 255]
    return crc ^ 0xFFFFFFFF


def read_header(data):
    """Return flags, count, sh_degree, profile, block_size, sections as {(id, block): bytes}."""
    reader = Reader(data, "header")
    check(reader.bytes(8) == MAGIC, "magic: not an .egs file")
    version, flags, header_size = reader.take("HHI")
    check(version == 1, f"version {version}, expected 1")
    count, sh_degree, profile, reserved, block_size, entries = reader.take("QBBHII")
    check(
        header_size == 36 + 20 * entries + 4, f"header_size {header_size} with {entries} sections"
    )
    table = [reader.take("HHIQI") for _ in range(entries)]
    check(reader.take("I") == crc32c(data[: header_size - 4]), "header: checksum")
    check(flags <= (3 if profile == LOSSLESS else 1) and reserved == 0, "header: reserved bits")
    check(
        sh_degree <= 3 and profile <= LOSSLESS and 1 <= block_size <= 65536,
        "header: SH degree, profile or block size",
    )
    sections = read_sections(reader, table, -(-count // block_size))
    check(not reader.rest(), "bytes after the last section")
    return flags, count, sh_degree, profile, block_size, sections


def read_sections(reader, table, blocks):
    sections, seen = {}, set()
    for number, flags, block, size, checksum in table:
        place, content = f"section {number} of block {block}", reader.bytes(size)
        check(crc32c(content) == checksum, f"{place}: checksum")
        check(flags <= 1, f"{place}: reserved bits")
        check((number, block) not in seen, f"{place}: twice")
        seen.add((number, block))
        known = CHANNELS <= number <= BOX or number == CODER
        check(known or flags == 1, f"{place}: unknown and not optional")
        of_block = number in (*BLOCK_SECTIONS, *BLOCK_SECTIONS_OF_LATTICES)
        limit = blocks if of_block else 1 if known else max(blocks, 1)
        check(block < limit, f"{place}: no such block")
        if known:
            sections[number, block] = content
    return sections


def check_presence(sections, channels, blocks):
    needed = {channel.stream for channel in channels if channel.depth}
    found = [number for number, _ in sections]
    if CODER in found:
        check(needed & set(RANS_STREAMS), "section 20: nothing is coded")
        check_line(sections[CODER, 0])
    elif needed & set(RANS_STREAMS):
        needed.add(STATES)
    check(CHANNELS in found and not any(13 <= number <= BOX for number in found), "sections")
    for number in BLOCK_SECTIONS:
        expected = blocks if number in needed else 0
        text = f"section {number}: in {found.count(number)} blocks, expected {expected}"
        check(found.count(number) == expected, text)


# Channels


def channel_list(sh_degree):
    names = [(GEOMETRY, name) for name in "xyz"]
    names += [(SH_DC, f"f_dc_{c}") for c in range(3)] + [(5, "opacity")]
    names += [(6, f"scale_{i}") for i in range(3)] + [(7, f"rot_{i}") for i in range(4)]
    coefficients = (sh_degree + 1) ** 2 - 1
    for degree in range(1, sh_degree + 1):
        indices = range(degree**2 - 1, (degree + 1) ** 2 - 1)
        names += [(7 + degree, f"f_rest_{c * coefficients + i}") for c in range(3) for i in indices]
    return [Channel(name, stream) for stream, name in names]


def read_channels(content, sh_degree):
    reader, channels = Reader(content, "channels"), channel_list(sh_degree)
    for channel in channels:
        read_quantiser(reader, channel)
        if channel.stream in RANS_STREAMS and channel.depth:
            read_model(reader, channel)
    coder = BinaryDecoder(reader.rest(), 94, "sent tables")
    for channel in channels:
        if channel.stream in RANS_STREAMS and channel.depth:
            if channel.weights is None:
                channel.weights = sent_weights(coder, 1 << channel.depth, channel.mantissa_bits)
            set_frequencies(channel)
    coder.finish()
    return channels


def read_quantiser(reader, channel):
    kind = reader.take("B")
    check(kind <= 2, f"{channel.name}: quantiser {kind}")
    if kind == 0:
        channel.origin = reader.take("f")
        check(np.isfinite(channel.origin), f"{channel.name}: value is not finite")
        return
    channel.depth, first, second = reader.take("Bff")
    check(
        1 <= channel.depth <= (21 if channel.stream == GEOMETRY else 12),
        f"{channel.name}: depth {channel.depth}",
    )
    check(np.isfinite(first) and np.isfinite(second), f"{channel.name}: parameters are not finite")
    levels = (1 << channel.depth) - 1
    if kind == 1:
        check(first < second, f"{channel.name}: low {first}, high {second}")
        channel.origin, channel.step = first, (second - first) / levels
    else:
        check(second > 0, f"{channel.name}: half_range {second}")
        channel.step = 2.0 * second / levels
        channel.origin = first - float(1 << (channel.depth - 1)) * channel.step


def channel_values(channel, symbols, count):
    if not channel.depth:
        return np.full(count, channel.origin, dtype=np.float32)
    largest = float(np.finfo(np.float32).max)
    values = [channel.origin + float(symbol) * channel.step for symbol in symbols]
    return np.array(
        [max(-largest, min(largest, value)) for value in values], dtype=np.float64
    ).astype(np.float32)


# Models


def read_model(reader, channel):
    kind, channel.precision = reader.take("BB")
    check(kind <= 2, f"{channel.name}: model {kind}")
    check(
        max(8, channel.depth) <= channel.precision <= 15,
        f"{channel.name}: precision {channel.precision}",
    )
    if kind == 0:
        cumulative = laplace_cumulative(reader, 1 << channel.depth)
    elif kind == 1:
        cumulative = mixture_cumulative(reader, 1 << channel.depth)
    else:
        channel.mantissa_bits = reader.take("B")
        check(
            channel.mantissa_bits <= 15, f"{channel.name}: mantissa of {channel.mantissa_bits} bits"
        )
        return
    channel.weights = [max(upper - lower, 1) for lower, upper in pairwise(cumulative)]


def laplace_cumulative(reader, size):
    decay = reader.take("H")
    check(decay >= 1, "laplace: decay 0")
    half = size // 2
    tail = [decay << 15]
    for _ in range(half):
        tail.append((tail[-1] * decay * decay) >> 32)
    lower = [tail[half - q] for q in range(1, half + 1)]
    upper = [(1 << 32) - tail[q - half - 1] for q in range(half + 1, size)]
    return [0, *lower, *upper, 1 << 32]


@cache
def normal_table():
    """Normal distribution from 0 to 8 sigma in steps of 1/64, times 2^30."""
    g, r = 1 << 60, 1152780775708076725
    k, sums = (r * r) >> 60, [0]
    for _ in range(512):
        following = (g * r) >> 60
        r = (r * k) >> 60
        sums.append(sums[-1] + g + following)
        g = following
    return [(1 << 29) + (partial << 29) // sums[512] for partial in sums]


def normal_distribution(edge, mean, sigma):
    table = normal_table()
    z = min((abs(edge - mean) << 16) // sigma, (1 << 19) - 1)
    i = z >> 10
    value = table[i] + (((table[i + 1] - table[i]) * (z & 1023)) >> 10)
    return (1 << 30) - value if edge < mean else value


def mixture_cumulative(reader, size):
    number = reader.take("B")
    check(1 <= number <= 4, f"mixture: {number} components")
    components = [reader.take("HII") for _ in range(number)]
    check(
        all(weight >= 1 and sigma >= 1 for weight, _, sigma in components),
        "mixture: weight or sigma 0",
    )
    cumulative = [0]
    for q in range(1, size):
        edge = (q << 16) - (1 << 15)
        cumulative.append(
            sum(w * normal_distribution(edge, mean, sigma) for w, mean, sigma in components) >> 16
        )
    return [*cumulative, sum(weight << 30 for weight, _, _ in components) >> 16]


def sent_weights(coder, size, mantissa_bits):
    large, before, changed, weights = int(size > 32), 0, 1, []
    for _ in range(size):
        kind = 3 * large + (changed if before else 2)
        if coder.decode(kind):
            changed = 0
        else:
            shorter, difference = coder.decode(6 + kind), 1
            while difference < 33 and coder.decode(12 + 33 * large + difference - 1):
                difference += 1
            before += -difference if shorter else difference
            changed = 1
            check(0 <= before <= 32, f"sent tables: weight of {before} bits")
        weight = int(before > 0)
        for j in range(before - 1):
            weight = 2 * weight + (coder.decode(78 + j) if j < mantissa_bits else 0)
        weights.append(weight)
    return weights


def set_frequencies(channel):
    """Set starts and frequencies (Frequency tables)."""
    total, scale = sum(channel.weights), 1 << channel.precision
    used = sum(weight > 0 for weight in channel.weights)
    check(1 <= used <= scale, f"{channel.name}: {used} weights above 0")
    shares = [weight * scale // total for weight in channel.weights]
    frequencies = [
        max(share, 1) if weight else 0
        for share, weight in zip(shares, channel.weights, strict=True)
    ]
    missing = scale - sum(frequencies)
    if missing > 0:
        remainders = [
            weight * scale - share * total
            for share, weight in zip(shares, channel.weights, strict=True)
        ]
        order = sorted(range(len(shares)), key=lambda q: (shares[q] == 0, -remainders[q], q))
        for q in order[:missing]:
            frequencies[q] += 1
    heap = [(-frequency, q) for q, frequency in enumerate(frequencies)]
    heapify(heap)
    for _ in range(-missing):
        q = heap[0][1]
        frequencies[q] -= 1
        heapreplace(heap, (-frequencies[q], q))
    channel.frequencies = frequencies
    channel.starts = [0]
    for frequency in frequencies:
        channel.starts.append(channel.starts[-1] + frequency)


# Binary coder


class BinaryDecoder:
    def __init__(self, data, contexts, place):
        self.data, self.place, self.shifted = data, place, 0
        self.low, self.high = 0, 0xFFFFFFFF
        self.code = int.from_bytes(data[:4].ljust(4, b"\0"), "big")
        self.probability, self.seen = [32768] * contexts, [0] * contexts

    def decode(self, context):
        p, n = self.probability[context], self.seen[context]
        middle = self.low + (((self.high - self.low) * p) >> 16)
        rate, decision = 131072 // (2 * n + 3), int(self.code <= middle)
        if decision:
            self.high = middle
            p += ((65536 - p) * rate) >> 16
        else:
            self.low = middle + 1
            p -= (p * rate) >> 16
        self.probability[context] = max(32, min(65504, p))
        self.seen[context] = min(n + 1, 255)
        while self.low >> 24 == self.high >> 24:
            self.shift()
        return decision

    def shift(self):
        position = self.shifted + 4
        following = self.data[position] if position < len(self.data) else 0
        self.low = (self.low << 8) & 0xFFFFFFFF
        self.high = ((self.high << 8) & 0xFFFFFFFF) + 255
        self.code = ((self.code << 8) & 0xFFFFFFFF) + following
        self.shifted += 1

    def finish(self):
        heads = [self.high >> (32 - 8 * j) << (32 - 8 * j) for j in range(5)]
        expected = self.shifted + next(j for j, head in enumerate(heads) if head >= self.low)
        check(
            len(self.data) == expected,
            f"{self.place}: {len(self.data)} coded bytes, expected {expected}",
        )


# Geometry


def morton_axes(depths):
    """Axis of each bit of the Morton code, most significant first."""
    return [axis for level in range(20, -1, -1) for axis in range(3) if depths[axis] > level]


def decode_geometry(content, depths, points):
    """Return the symbols of x, y and z of a block."""
    reader = Reader(content, "geometry")
    coder = BinaryDecoder(reader.bytes(reader.take("I")), 864, "geometry")
    raw = reader.rest()
    codes, used = [], 0
    total = sum(depths)
    nodes = [(points, total, 0, 0)]
    while nodes:
        n, left, prefix, one_sided = nodes.pop()
        if n == 1:
            for _ in range(left):
                check(used < 8 * len(raw), "geometry: raw bits are missing")
                prefix = 2 * prefix + ((raw[used >> 3] >> (7 - (used & 7))) & 1)
                used += 1
        if n == 1 or left == 0:
            codes += [prefix] * n
            continue
        k = decode_split(coder, n, one_sided)
        one_sided = int(k in (0, n))
        children = [
            (n - k, left - 1, 2 * prefix + 1, one_sided),
            (k, left - 1, 2 * prefix, one_sided),
        ]
        nodes += [child for child in children if child[0]]
    coder.finish()
    check(
        len(raw) == (used + 7) // 8, f"geometry: {len(raw)} raw bytes, expected {(used + 7) // 8}"
    )
    check(used % 8 == 0 or raw[-1] & ((1 << (8 - used % 8)) - 1) == 0, "geometry: padding is not 0")
    symbols = [[0] * points for _ in range(3)]
    for shift, axis in enumerate(morton_axes(depths), start=1):
        symbols[axis] = [
            2 * value + ((code >> (total - shift)) & 1)
            for value, code in zip(symbols[axis], codes, strict=True)
        ]
    return symbols


def decode_split(coder, n, one_sided):
    """Return how many of n points have a 0 as their next bit."""
    s = n - 2 if n < 10 else 8 + max(n.bit_length() - 4, 0)
    if coder.decode(4 * s + 2 * one_sided):
        return 0
    if coder.decode(4 * s + 2 * one_sided + 1):
        return n
    a, b, v = 1, n - 1, 1
    while a < b:
        middle = (a + b) >> 1
        if coder.decode(96 + 32 * s + min(v, 31)):
            a, v = middle + 1, 2 * v + 1
        else:
            b, v = middle, 2 * v
    return a


# SH-DC


def decode_sh_dc(content, depths, positions):
    """Return the symbols of R, G and B of a block; those of a constant channel mean nothing."""
    coder = BinaryDecoder(content, 56 * 14 * 4 * 3, "sh-dc")
    coded = [kind for kind, colour in enumerate((1, 0, 2)) if depths[colour]]
    values = []
    for point in range(len(positions)):
        neighbours, current, residual = weighted_neighbours(positions, point), [0, 0, 0], 0
        for kind in coded:
            prediction, activity = predict([(w, values[i][kind]) for w, i in neighbours])
            spread = min(abs(residual).bit_length() >> 1, 3)
            residual = decode_residual(coder, 56 * ((14 * kind + activity) * 4 + spread))
            current[kind] = prediction + residual
        values.append(current)
    coder.finish()
    red, green, blue = (
        [v[1] + v[0] for v in values],
        [v[0] for v in values],
        [v[2] + v[0] for v in values],
    )
    for depth, symbols in zip(depths, (red, green, blue), strict=True):
        check(depth == 0 or all(0 <= q < 1 << depth for q in symbols), "sh-dc: symbol out of range")
    return red, green, blue


def weighted_neighbours(positions, point):
    """Return (weight, index) of the 4 nearest of the 8 points before."""
    x, y, z = positions[point]
    found = []
    for index in range(point - 1, max(point - 9, -1), -1):
        a, b, c = positions[index]
        found.append(((a - x) ** 2 + (b - y) ** 2 + (c - z) ** 2, -index))
    found = sorted(found)[:4]
    return [((256 * (found[0][0] + 1)) // (d + found[0][0] + 1), -index) for d, index in found]


def predict(weighted):
    """Return (prediction, activity) from (weight, value) of the neighbours."""
    if not weighted:
        return 0, 0
    total = sum(w for w, _ in weighted)
    prediction = (2 * sum(w * v for w, v in weighted) + total) // (2 * total)
    deviation = (4 * sum(w * abs(v - prediction) for w, v in weighted)) // total
    return prediction, min(deviation.bit_length(), 13)


def decode_residual(coder, base):
    n = 0
    while n < 13 and coder.decode(base + n):
        n += 1
    if n == 0:
        return 0
    negative, magnitude = coder.decode(base + 14), 1
    for j in range(n - 1):
        magnitude = 2 * magnitude + coder.decode(base + 14 * (1 + min(j, 2)) + n)
    return -magnitude if negative else magnitude


# rANS


def decode_rans(sections, block, channels, points):
    """Return {name: symbols of the block} of the streams 5-10, constant channels left out."""
    coded = [channel for channel in channels if channel.stream in RANS_STREAMS and channel.depth]
    if not coded:
        return {}
    lanes = min(LANES, points)
    content, symbols = sections[STATES, block], {}
    check(
        len(content) == 4 * lanes,
        f"states of block {block}: {len(content)} bytes, expected {4 * lanes}",
    )
    states = list(struct.unpack(f"<{lanes}I", content))
    for stream in RANS_STREAMS:
        words = Reader(sections.get((stream, block), b""), f"section {stream} of block {block}")
        for channel in coded:
            if channel.stream == stream:
                symbols[channel.name] = [
                    decode_symbol(channel, states, i % LANES, words) for i in range(points)
                ]
        check(not words.rest(), f"section {stream} of block {block}: words left over")
    check(
        states == [STATE_MIN] * lanes, f"states of block {block}: not 2^16 after the last channel"
    )
    return symbols


def decode_symbol(channel, states, lane, words):
    x = states[lane]
    slot = x & ((1 << channel.precision) - 1)
    symbol = bisect_right(channel.starts, slot) - 1
    x = channel.frequencies[symbol] * (x >> channel.precision) + slot - channel.starts[symbol]
    states[lane] = (x << 16) + words.take("H") if x < STATE_MIN else x
    return symbol


# Torchac


def check_line(content):
    check(1 <= len(content) <= 200, "section 20: length")
    check(all(32 <= byte < 127 for byte in content), "section 20: not printable ASCII")


def decode_torchac(sections, block, channels, points):
    """Return {name: symbols of the block} of the streams 5-10, constant channels left out."""
    coded = [channel for channel in channels if channel.stream in RANS_STREAMS and channel.depth]
    symbols = {}
    for stream in RANS_STREAMS:
        members = [channel for channel in coded if channel.stream == stream]
        if not members:
            continue
        reader = Reader(sections[stream, block], f"section {stream} of block {block}")
        checksum = reader.take("I")
        for channel in members:
            run, column = 1 << (22 - channel.depth), []
            for start in range(0, points, run):
                data = reader.bytes(reader.take("I"))
                column += decode_run(channel, data, min(run, points - start))
            symbols[channel.name] = column
        packed = b"".join(struct.pack(f"<{points}H", *symbols[c.name]) for c in members)
        check(crc32c(packed) == checksum, f"{reader.place}: other symbols")
        check(not reader.rest(), f"{reader.place}: bytes left over")
    return symbols


def decode_run(channel, data, count):
    bits = iter(f"{int.from_bytes(data, 'big'):0{8 * len(data)}b}")
    low, high, code = 0, (1 << 32) - 1, 0
    for _ in range(32):
        code = 2 * code + int(next(bits, 0))
    run, up = [], 16 - channel.precision
    for _ in range(count):
        span = high - low + 1
        place = ((code - low + 1) * (1 << 16) - 1) // span
        symbol = bisect_right(channel.starts, place >> up) - 1
        run.append(symbol)
        start, end = channel.starts[symbol], channel.starts[symbol] + channel.frequencies[symbol]
        high = low - 1 + ((span * (end << up)) >> 16)
        low += (span * (start << up)) >> 16
        while True:
            if high < 1 << 31 or low >= 1 << 31:
                away = low & 1 << 31
            elif low >= 1 << 30 and high < 3 << 30:
                away = 1 << 30
            else:
                break
            low, high = 2 * (low - away), 2 * (high - away) + 1
            code = 2 * (code - away) + int(next(bits, 0))
    return run


# Lossless


def decode_lossless(sections, count, sh_degree, block_size):
    blocks = -(-count // block_size)
    check((BOX, 0) in sections, "section 17: missing")
    reader = Reader(sections[BOX, 0], "box")
    box = np.array(reader.take("6f"))
    check(not reader.rest() and np.isfinite(box).all() and (box[:3] <= box[3:]).all(), "box")
    numbers = [GEOMETRY, SH_DC, 5, 6, 7, *range(8, 8 + sh_degree)]
    found = {key for key in sections if key[0] not in (BOX, COMMENTS, EXTRA)}
    check(found == {(n, block) for n in numbers for block in range(blocks)}, "sections of blocks")
    names = [channel.name for channel in channel_list(sh_degree)]
    values = {name: [] for name in names}
    for block in range(blocks):
        points = min(block_size, count - block * block_size)
        for name, patterns in lossless_block(sections, block, sh_degree, points).items():
            values[name] += patterns
    return {name: np.array(values[name], np.uint32).view(np.float32) for name in names}


def lossless_block(sections, block, sh_degree, points):
    def reader(number):
        return Reader(sections[number, block], f"section {number} of block {block}")

    readers = {number: reader(number) for number in (GEOMETRY, SH_DC, 5, 6, 7)}
    values = dict(zip("xyz", read_stack(readers[GEOMETRY], 3, points), strict=True))
    names = [f"f_dc_{c}" for c in range(3)]
    values |= read_triple(readers[SH_DC], [[name] for name in names], [[True] * points] * 3)
    values["opacity"] = read_stack(readers[5], 1, points)[0]
    values |= {f"scale_{i}": v for i, v in enumerate(read_stack(readers[6], 3, points))}
    values |= {f"rot_{i}": v for i, v in enumerate(read_quaternions(readers[7], points))}
    coefficients, has = (sh_degree + 1) ** 2 - 1, []
    for degree in range(1, sh_degree + 1):
        readers[7 + degree] = reader(7 + degree)
        if degree == 1:
            (mask,) = read_columns(readers[8], [points])
            check(max(mask) <= 7, "mask")
            has = [[m >> c & 1 for m in mask] for c in range(3)]
        indices = range(degree**2 - 1, (degree + 1) ** 2 - 1)
        names = [[f"f_rest_{c * coefficients + i}" for i in indices] for c in range(3)]
        values |= read_triple(readers[7 + degree], names, has)
    check(not any(r.rest() for r in readers.values()), f"block {block}: bytes left over")
    return values


def read_columns(reader, counts):
    sizes = [reader.take("I") for _ in counts]
    return [read_column(reader.bytes(s), n) for s, n in zip(sizes, counts, strict=True)]


def read_column(content, count):
    if not count:
        check(not content, "column: bytes of no values")
        return []
    check(len(content) > 2 and content[0] == 4, "column: not of major version 4")
    check(content[2] % 16 == 0 and content[2] // 16 <= 1, "column: mode or delta encoding")
    content, values = bytes(content), np.zeros(count, np.uint32)
    try:
        file, header = FileDecompressor.new(content)
        chunk, meta = file.chunk_decompressor(content[header:], "u32")
        progress, page = chunk.read_page_into(content[header + meta :], count, values)
    except RuntimeError as error:
        raise ValueError(f"column: {error}") from error
    check(progress.n_processed == count and header + meta + page == len(content), "column: size")
    return values.tolist()


def ordered_integer(pattern):
    return 2**32 - 1 - pattern if pattern >= 2**31 else pattern + 2**31


def pattern_of(integer):
    return integer - 2**31 if integer >= 2**31 else 2**32 - 1 - integer


def read_stack(reader, columns, count):
    return [[pattern_of(n) for n in column] for column in read_columns(reader, [count] * columns)]


def read_guided(reader, guide):
    classes = [
        [min(max(g >> 23 & 255, 116), 131) - 116 + 16 * (g >> 31) for g in column]
        for column in guide
    ]
    counts = [sum(column.count(k) for column in classes) for k in range(32)]
    values = [iter(column) for column in read_columns(reader, counts)]
    return [[pattern_of(next(values[k])) for k in column] for column in classes]


def read_triple(reader, names, has):
    """Values by name; ``names[c]`` are those of colour c, ``has[c]`` says who has it."""
    values = {}
    for c in (1, 0, 2):
        members = [i for i, there in enumerate(has[c]) if there]
        if c == 1:
            columns = read_stack(reader, len(names[c]), len(members))
        else:
            columns = read_guided(reader, [[values[g][i] for i in members] for g in names[1]])
        for name, column in zip(names[c], columns, strict=True):
            values[name] = [0] * len(has[c])
            for i, value in zip(members, column, strict=True):
                values[name][i] = value
    return values


def read_quaternions(reader, count):
    kind = reader.take("B")
    check(kind <= 1, f"quaternions of kind {kind}")
    stack = read_stack(reader, 4, count)
    if kind == 1:
        for i, pattern in enumerate(stack[0]):
            x, y, z = np.array([column[i] for column in stack[1:]], np.uint32).view(np.float32)
            t = 1.0 - float(x) * float(x) - float(y) * float(y) - float(z) * float(z)
            unit = np.float32(sqrt(t) if t > 0 else 0.0).view(np.uint32)
            integer = ordered_integer(pattern) - 2**31 + ordered_integer(int(unit))
            stack[0][i] = pattern_of(integer % 2**32)
    return stack


# Comments and extra


def read_comments(content):
    check(len(content) <= 1 << 20, f"comments: {len(content)} bytes")
    check(all(byte in b"\t\n" or 32 <= byte < 127 for byte in content), "comments: not plain ASCII")
    return content.decode("ascii").split("\n")


def read_extra(content, count):
    reader, properties = Reader(content, "extra"), {}
    for _ in range(reader.take("H")):
        raw = reader.bytes(reader.take("B"))
        check(all(32 <= byte < 127 for byte in raw), "extra: name is not printable ASCII")
        kind, size = reader.take("BQ")
        check(kind < len(EXTRA_DTYPES), f"extra: type {kind}")
        dtype, inflater = np.dtype(EXTRA_DTYPES[kind]), zlib.decompressobj()
        try:
            planes = inflater.decompress(reader.bytes(size)) + inflater.flush()
        except zlib.error as error:
            raise ValueError(f"extra: {error}") from error
        check(inflater.eof and not inflater.unused_data, "extra: zlib stream and size differ")
        check(
            len(planes) == count * dtype.itemsize,
            f"extra: {len(planes)} bytes, expected {count * dtype.itemsize}",
        )
        values = b"".join(planes[i::count] for i in range(count))
        properties[raw.decode("ascii")] = np.frombuffer(values, dtype)
    check(not reader.rest(), "extra: bytes left over")
    return properties


def decode(data):
    """Decode an `.egs` file.

    Returns
    -------
    dict
        count, sh_degree, has_normals, comments (list of str), extra (name -> array),
        symbols (PLY property -> list of int; constant channels absent, all of profiles 3-6) and
        values (PLY property -> float32 array), all in stream order.

    Raises
    ------
    ValueError
        The file is truncated, corrupt or of another version.
    """
    from reference_lattice import lattice_values

    flags, count, sh_degree, profile, block_size, sections = read_header(data)
    common = {
        "count": count,
        "sh_degree": sh_degree,
        "has_normals": bool(flags & 1),
        "comments": read_comments(sections[COMMENTS, 0]) if (COMMENTS, 0) in sections else [],
        "extra": read_extra(sections[EXTRA, 0], count) if (EXTRA, 0) in sections else {},
    }
    if profile == LOSSLESS:
        values = decode_lossless(sections, count, sh_degree, block_size)
        return {**common, "symbols": {}, "values": values}
    if profile > 2:
        values = lattice_values(count, sh_degree, block_size, sections)
        return {**common, "symbols": {}, "values": values}
    check((BOX, 0) not in sections, "section 17: without profile 6")
    check((CHANNELS, 0) in sections, "section 1: missing")
    channels = read_channels(sections[CHANNELS, 0], sh_degree)
    blocks = -(-count // block_size)
    check_presence(sections, channels, blocks)
    symbols = {channel.name: [] for channel in channels if channel.depth}
    for block in range(blocks):
        points = min(block_size, count - block * block_size)
        for name, values in decode_block(sections, block, channels, points).items():
            symbols[name] += values
    return {
        **common,
        "symbols": symbols,
        "values": {c.name: channel_values(c, symbols.get(c.name), count) for c in channels},
    }


def decode_block(sections, block, channels, points):
    depths = [channel.depth for channel in channels]
    position_symbols, colour_symbols = [[0] * points] * 3, [[0] * points] * 3
    if any(depths[:3]):
        position_symbols = decode_geometry(sections[GEOMETRY, block], depths[:3], points)
    if any(depths[3:6]):
        colour_symbols = decode_sh_dc(
            sections[SH_DC, block], depths[3:6], list(zip(*position_symbols, strict=True))
        )
    columns = [*position_symbols, *colour_symbols]
    decode_attributes = decode_torchac if (CODER, 0) in sections else decode_rans
    symbols = decode_attributes(sections, block, channels, points)
    for channel, column in zip(channels[:6], columns, strict=True):
        if channel.depth:
            symbols[channel.name] = column
    return symbols

"""Tools of the reference decoder: readers, checksum, entropy coders, tables, tree, neighbours.

Written only from FORMAT.md; shares no code with the codec, and favours clarity over speed.
"""

import heapq
import math
import struct
from bisect import bisect_right
from dataclasses import dataclass, field
from itertools import accumulate

import numpy

LANES = 32
LEAST_STATE = 1 << 16
LARGEST_FLOAT = (2.0 - 2.0**-23) * 2.0**127


def check(condition, text):
    """Raise ValueError with this text if the condition is false."""
    if not condition:
        raise ValueError(text)


# Bytes and bits


@dataclass
class Reader:
    """Reads little-endian numbers from bytes, never past the end."""

    data: bytes
    name: str = "data"
    at: int = 0

    def take(self, size):
        check(size <= len(self.data) - self.at, f"{self.name}: truncated at byte {self.at}")
        self.at += size
        return self.data[self.at - size : self.at]

    def numbers(self, form):
        return struct.unpack("<" + form, self.take(struct.calcsize("<" + form)))

    def u8(self):
        return self.take(1)[0]

    def u16(self):
        return int.from_bytes(self.take(2), "little")

    def u32(self):
        return int.from_bytes(self.take(4), "little")

    def u64(self):
        return int.from_bytes(self.take(8), "little")

    def f32(self):
        return self.numbers("f")[0]

    def rest(self):
        return self.take(len(self.data) - self.at)

    def finish(self):
        left = len(self.data) - self.at
        check(left == 0, f"{self.name}: {left} bytes after the end")


@dataclass
class RawBits:
    """Reads raw bits, most significant bit of a byte first."""

    data: bytes
    name: str = "raw bits"
    at: int = 0

    def take(self, count):
        end = self.at + count
        check(end <= 8 * len(self.data), f"{self.name}: raw bits run out")
        last = (end + 7) // 8
        number = int.from_bytes(self.data[self.at // 8 : last], "big") >> (8 * last - end)
        self.at = end
        return number & ((1 << count) - 1)

    def finish(self):
        left = 8 * len(self.data) - self.at
        check(left < 8, f"{self.name}: bytes after the last raw bit")
        check(self.take(left) == 0, f"{self.name}: padding is not 0")


def table_of_crc():
    table = []
    for value in range(256):
        for _ in range(8):
            value = (value >> 1) ^ (0x82F63B78 if value & 1 else 0)
        table.append(value)
    return table


CRC_TABLE = table_of_crc()


def crc32c(data):
    """CRC-32C (section "File")."""
    table, value = CRC_TABLE, 0xFFFFFFFF
    for byte in data:
        value = (value >> 8) ^ table[(value ^ byte) & 255]
    return value ^ 0xFFFFFFFF


def finite(*numbers):
    return all(map(math.isfinite, numbers))


def rounded(numbers):
    """binary64 numbers, clamped to the finite range of binary32 and rounded to it."""
    clamped = [min(max(number, -LARGEST_FLOAT), LARGEST_FLOAT) for number in numbers]
    return numpy.array(clamped, "<f8").astype("<f4")


# Section "Binary coder"


@dataclass
class BinaryCoder:
    """Decodes decisions with adaptive contexts; initially, all contexts are fresh."""

    data: bytes
    contexts: int
    name: str = "binary coder"
    low: int = 0
    high: int = 0xFFFFFFFF
    shifted: int = 0
    code: int = 0
    chances: list = field(default_factory=list)
    seen: list = field(default_factory=list)

    def __post_init__(self):
        self.code = int.from_bytes(self.data[:4].ljust(4, b"\0"), "big")
        self.chances = [32768] * self.contexts
        self.seen = [0] * self.contexts

    def bit(self, context):
        chance, seen = self.chances[context], self.seen[context]
        middle = self.low + (((self.high - self.low) * chance) >> 16)
        rate = 131072 // (2 * seen + 3)
        decision = int(self.code <= middle)
        if decision:
            self.high = middle
            chance += ((65536 - chance) * rate) >> 16
        else:
            self.low = middle + 1
            chance -= (chance * rate) >> 16
        self.chances[context], self.seen[context] = chance, min(seen + 1, 255)
        while not (self.low ^ self.high) >> 24:
            self.shift()
        return decision

    def shift(self):
        following = self.shifted + 4
        byte = self.data[following] if following < len(self.data) else 0
        self.low = (self.low << 8) & 0xFFFFFFFF
        self.high = ((self.high << 8) & 0xFFFFFFFF) + 255
        self.code = ((self.code << 8) & 0xFFFFFFFF) + byte
        self.shifted += 1

    def finish(self):
        size = 0
        while (self.high >> (32 - 8 * size)) << (32 - 8 * size) < self.low:
            size += 1
        expected = self.shifted + size
        check(
            len(self.data) == expected,
            f"{self.name}: {len(self.data)} bytes of binary coder, expected {expected}",
        )


# Sections "Frequency tables", "Sent tables" and "rANS"


@dataclass(frozen=True, eq=False)
class Table:
    """Frequencies of symbols, and the first slot of each."""

    frequencies: list
    starts: list

    def symbol(self, slot):
        return bisect_right(self.starts, slot) - 1


def table_of(frequencies):
    return Table(frequencies, [0, *accumulate(frequencies)][:-1])


def frequencies(weights, precision):
    """The frequencies, with sum 2^precision, of symbols with these weights."""
    total = sum(weights)
    positive = sum(weight > 0 for weight in weights)
    check(0 < positive <= 1 << precision, "table: no symbols, or too many")
    shares = [(weight << precision) // total for weight in weights]
    result = [max(share, 1) if w > 0 else 0 for w, share in zip(weights, shares, strict=False)]
    difference = (1 << precision) - sum(result)
    if difference > 0:
        rests = [
            (share * total - (weight << precision), q)
            for q, (weight, share) in enumerate(zip(weights, shares, strict=False))
            if share > 0
        ]
        for _, q in heapq.nsmallest(difference, rests):
            result[q] += 1
    else:
        lower_largest(result, -difference)
    return result


def lower_largest(counts, times):
    heap = [(-count, q) for q, count in enumerate(counts)]
    heapq.heapify(heap)
    for _ in range(times):
        count, q = heap[0]
        counts[q] -= 1
        heapq.heapreplace(heap, (count + 1, q))


def sent_tables(data, shapes):
    """Weights of the tables with these (number of symbols, mantissa bits)."""
    coder = BinaryCoder(data, 94, "sent tables")
    tables = []
    for size, mantissa in shapes:
        tables.append(sent_table(coder, size, mantissa))
    coder.finish()
    return tables


def sent_table(coder, size, mantissa):
    large = int(size > 32)
    length, changed, weights = 0, 1, []
    for _ in range(size):
        kind = 3 * large + (2 if length == 0 else changed)
        if coder.bit(kind):
            changed = 0
        else:
            length += length_difference(coder, kind, large)
            check(0 <= length <= 32, "sent tables: length of a weight outside 0-32")
            changed = 1
        weights.append(sent_weight(coder, length, mantissa))
    return weights


def length_difference(coder, kind, large):
    shorter = coder.bit(6 + kind)
    difference = 1
    while difference < 33 and coder.bit(12 + 33 * large + difference - 1):
        difference += 1
    return -difference if shorter else difference


def sent_weight(coder, length, mantissa):
    if length == 0:
        return 0
    weight = 1
    for j in range(length - 1):
        weight = 2 * weight + (coder.bit(78 + j) if j < mantissa else 0)
    return weight


def first_states(reader, count):
    """Initial states of the lanes (section "rANS")."""
    states = list(reader.numbers(f"{count}I"))
    reader.finish()
    check(all(state >= LEAST_STATE for state in states), "states: a state below 2^16")
    return states


def rans_symbol(states, lane, table, precision, words):
    """Decode a symbol with a lane; `words` is a Reader of u16."""
    state = states[lane]
    slot = state & ((1 << precision) - 1)
    symbol = table.symbol(slot)
    state = table.frequencies[symbol] * (state >> precision) + slot - table.starts[symbol]
    if state < LEAST_STATE:
        state = (state << 16) + words.u16()
    states[lane] = state
    return symbol


def check_last_states(states):
    check(all(state == LEAST_STATE for state in states), "states: wrong after the last symbol")


# Section "Geometry"


@dataclass(frozen=True)
class Leaf:
    """Points of one node without children, whose codes lack the lowest bits."""

    prefix: int
    missing: int
    count: int


def axes_of(depths):
    """Axis of each bit of a Morton code, most significant bit first."""
    return [axis for level in range(20, -1, -1) for axis in range(3) if depths[axis] > level]


def cells_of(code, axes):
    """Cells x, y, z of a Morton code."""
    cells = [0, 0, 0]
    for place, axis in enumerate(axes):
        cells[axis] = 2 * cells[axis] + ((code >> (len(axes) - 1 - place)) & 1)
    return cells


def read_tree(data, count, bits):
    """Leaves of the tree of `count` codes of `bits` bits, ascending."""
    coder = BinaryCoder(data, 864, "geometry")
    leaves = []
    visit(coder, leaves, count, bits, 0, 0)
    coder.finish()
    return leaves


def visit(coder, leaves, count, missing, prefix, lopsided):
    if count == 0:
        return
    if count == 1 or missing == 0:
        leaves.append(Leaf(prefix, missing, count))
        return
    zeros = split(coder, count, lopsided)
    below = int(zeros in (0, count))
    visit(coder, leaves, zeros, missing - 1, 2 * prefix, below)
    visit(coder, leaves, count - zeros, missing - 1, 2 * prefix + 1, below)


def split(coder, count, lopsided):
    """Number of points of a node whose next bit is 0."""
    size = count - 2
    if count >= 10:
        size = 8
        while count >> (size - 8) >= 16:
            size += 1
    if coder.bit(4 * size + 2 * lopsided):
        return 0
    if coder.bit(4 * size + 2 * lopsided + 1):
        return count
    least, most, path = 1, count - 1, 1
    while least < most:
        middle = (least + most) >> 1
        if coder.bit(96 + 32 * size + min(path, 31)):
            least, path = middle + 1, 2 * path + 1
        else:
            most, path = middle, 2 * path
    return least


# Section "Neighbours"


@dataclass(frozen=True)
class Neighbours:
    """Indices within the block of up to 4 neighbours, nearest first, and their weights."""

    places: list
    weights: list
    total: int

    def predict(self, values):
        """Prediction, and sum of weighted differences from it; 0, 0 without neighbours."""
        if not self.places:
            return 0, 0
        pairs = [(weight, values[i]) for weight, i in zip(self.weights, self.places, strict=False)]
        doubled = 2 * sum(weight * value for weight, value in pairs)
        guess = (doubled + self.total) // (2 * self.total)
        return guess, sum(weight * abs(value - guess) for weight, value in pairs)


def neighbours_of(points, i):
    """Neighbours of point i among the 8 before it."""
    x, y, z = points[i]
    near = []
    for j in range(max(i - 8, 0), i):
        u, v, w = points[j]
        near.append(((x - u) ** 2 + (y - v) ** 2 + (z - w) ** 2, -j))
    near = sorted(near)[:4]
    distances = [min(distance, (1 << 44) - 1) for distance, _ in near]
    weights = [(256 * (distances[0] + 1)) // (d + distances[0] + 1) for d in distances]
    return Neighbours([-j for _, j in near], weights, sum(weights))

"""Lattices (profiles 3-5) of the reference decoder, written from ``gs_codec/egs/FORMAT.md`` alone.

Integers are Python's; numpy only rounds binary64 to binary32.
"""

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from math import isfinite, sqrt

import numpy as np
from reference_decoder import (
    GEOMETRY,
    LANES,
    SH_DC,
    STATE_MIN,
    STATES,
    BinaryDecoder,
    Channel,
    Reader,
    check,
    decode_split,
    morton_axes,
    sent_weights,
    set_frequencies,
    weighted_neighbours,
)

LATTICE, CLASSES, LOW_BITS, BOUNDS = 13, 14, 15, 16
OPACITY, SCALING, ROTATION, SH1 = 5, 6, 7, 8
BANDS = (range(3), range(3, 8), range(8, 15))
ONE = 1 << 20
BOUND = 1600 * ONE
UNITS = ("opacity", "scaling", "rotation", "sh-dc", "sh1", "sh2", "sh3")
TURNS = ("turn_0", "turn_1", "turn_2")
RULES = ("opacity", "scale_0", "scale_1", "scale_2", *TURNS, "positions", "colour")


@dataclass
class Rule:
    a: int
    b: int
    c: tuple
    limit: int
    weight: int = 1

    def shift(self, k, o=0, s=(), e=0):
        total = self.a + (self.weight * k << 16) + ((self.b * min(o, 0)) >> 20)
        total += sum((c * value) >> 20 for c, value in zip(self.c, s, strict=False))
        return max(0, min(self.limit, (total >> 16) + e))


@dataclass
class Lattice:
    origin: tuple
    step: float
    bits: tuple
    classes: tuple
    centres: tuple
    units: dict
    rules: dict
    tables: list = field(default_factory=list)  # of each list, the table of each context


# The lattice section


def context_lists(sh_degree):
    """Number of contexts of each list."""
    sizes = [31, 16, *[256] * 4, *[32] * 3, 288]
    for band in range(1, sh_degree + 1):
        sizes += [256] * (band == 1) + [16] * (band < sh_degree) + [384] * 3
    return sizes


def bucket(n):
    """What a sum counts as in a context."""
    k = n.bit_length() - 1
    return n if n < 2 else min(2 * k + ((n >> (k - 1)) & 1), 15)


def sh_bands(sh_degree):
    """(band, coefficient) of every SH-AC coefficient."""
    return [(band, i) for band in range(1, sh_degree + 1) for i in BANDS[band - 1]]


def read_lattice(content, sh_degree):
    reader = Reader(content, "lattice")
    origin, step = reader.take("3f"), reader.take("f")
    check(all(isfinite(x) for x in (*origin, step)) and step > 0, "lattice: grid")
    bits, classes = reader.take("3B"), reader.take("2B")
    check(max(bits) <= 21, f"lattice: bits {bits}")
    check(all(1 <= number <= 16 for number in classes), f"lattice: classes {classes}")
    centres, units = reader.take("2i"), dict(zip(UNITS, reader.take("7I"), strict=True))
    check(max(map(abs, centres)) <= 400 * ONE, f"lattice: centres {centres}")
    check(min(units.values()) > 0, f"lattice: units {units}")
    rules = {}
    for name in RULES:
        a, b, *c = reader.take("5i")
        limit = reader.take("B")
        rules[name] = Rule(a, b, tuple(c), limit, 3 if name == "positions" else 1)
    check_limits(units, rules)
    lattice = Lattice(origin, step, bits, classes, centres, units, rules)
    read_tables(reader, lattice, sh_degree)
    return lattice


def check_limits(units, rules):
    limits = dict.fromkeys(UNITS, rules["colour"].limit)
    limits["opacity"] = rules["opacity"].limit
    limits["rotation"] = max(rules[name].limit for name in TURNS)
    limits["scaling"] = max(rules[f"scale_{i}"].limit for i in range(3))
    for name, unit in units.items():
        check(unit.bit_length() + limits[name] <= 31, f"lattice: {name}: unit and limit")
    check(rules["positions"].limit <= 93, "lattice: limit of positions")


def read_tables(reader, lattice, sh_degree):
    used, number = [], -1
    size, expected = reader.take("2H")
    marks = BinaryDecoder(reader.bytes(size), 2, "marks")
    for contexts in context_lists(sh_degree):
        begins, tables = 0, [number := number + 1]
        for _ in range(contexts - 1):
            begins = marks.decode(begins)
            number += begins
            tables.append(number)
        check(number - tables[0] < 64, "lattice: more than 64 tables of a list")
        used.append(tables)
    marks.finish()
    check(expected == number + 1, f"lattice: expected {number + 1} tables")
    alphabets = list(reader.bytes(number + 1))
    check(all(1 <= size <= 240 for size in alphabets), "lattice: alphabet")
    coder, tables = BinaryDecoder(reader.rest(), 94, "weights"), []
    for size in alphabets:
        weights = sent_weights(coder, size, 3)
        tables.append(Channel(f"table {len(tables)}", 0, precision=12, weights=weights))
        set_frequencies(tables[-1])
    coder.finish()
    lattice.tables = [[tables[t] for t in each] for each in used]


# Passes


class Bits:
    """Raw bits of a section, most significant first."""

    def __init__(self, content, place):
        self.content, self.place, self.used = content, place, 0

    def take(self, count):
        value = 0
        for _ in range(count):
            check(self.used < 8 * len(self.content), f"{self.place}: raw bits are missing")
            byte = self.content[self.used >> 3]
            value = 2 * value + ((byte >> (7 - (self.used & 7))) & 1)
            self.used += 1
        return value

    def finish(self):
        check(len(self.content) == -(-self.used // 8), f"{self.place}: raw bytes left over")
        padding = -self.used % 8
        check(not padding or not self.content[-1] & ((1 << padding) - 1), f"{self.place}: padding")


class Passes:
    """rANS over the streams of a block."""

    def __init__(self, content, tables, place):
        check(len(content) == 4 * LANES, f"{place}: {len(content)} bytes of states")
        self.states = list(Reader(content, place).take(f"{LANES}I"))
        check(min(self.states) >= STATE_MIN, f"{place}: a state is below 2^16")
        self.lists: Iterator = iter(tables)
        self.place = place

    def open(self, content, stream):
        reader = Reader(content, f"section {stream}, {self.place}")
        self.words = Reader(reader.bytes(reader.take("I")), reader.place)
        self.raw = Bits(reader.rest(), reader.place)

    def start(self, shared=None):
        """Begin a pass, with a list of contexts of its own if none is shared."""
        self.table, self.symbol = shared or next(self.lists), 0

    def close(self):
        check(not self.words.rest(), f"{self.words.place}: words left over")
        self.raw.finish()

    def finish(self):
        check(self.states == [STATE_MIN] * LANES, f"{self.place}: states are not 2^16")

    def integer(self, context):
        table, lane = self.table[context], self.symbol % LANES
        x = self.states[lane]
        slot = x & 4095
        token = bisect_right(table.starts, slot) - 1
        x = table.frequencies[token] * (x >> 12) + slot - table.starts[token]
        self.states[lane] = (x << 16) + self.words.take("H") if x < STATE_MIN else x
        self.symbol += 1
        m, negative = token >> 1, token & 1
        if m >= 16:
            n = ((m - 16) >> 2) + 2
            m = ((4 + ((m - 16) & 3)) << n) + self.raw.take(n)
        return -m if negative else m


# Positions


def decode_tree(content, total, points):
    """Return (code, missing bits) of the points of a block."""
    coder, found = BinaryDecoder(content, 864, "geometry"), []
    nodes = [(points, total, 0, 0)]
    while nodes:
        n, left, prefix, one_sided = nodes.pop()
        if n == 1 or left == 0:
            found += [(prefix, left)] * n
            continue
        k = decode_split(coder, n, one_sided)
        one_sided = int(k in (0, n))
        children = [
            (n - k, left - 1, 2 * prefix + 1, one_sided),
            (k, left - 1, 2 * prefix, one_sided),
        ]
        nodes += [child for child in children if child[0]]
    coder.finish()
    return found


def place_of(code, dropped, axes):
    """Place of a code whose lowest bits were dropped."""
    cell, width = [0, 0, 0], [0, 0, 0]
    for bit, axis in enumerate(axes):
        lower = len(axes) - 1 - bit
        cell[axis] = 2 * cell[axis] + ((code >> lower) & 1)
        width[axis] += lower < dropped
    return tuple(2 * c + (1 << w) for c, w in zip(cell, width, strict=True))


def decode_places(lattice, content, low_bits, shifts):
    axes, raw, places = morton_axes(lattice.bits), Bits(low_bits, "low-bits"), []
    found = decode_tree(content, len(axes), len(shifts))
    for (prefix, missing), shift in zip(found, shifts, strict=True):
        dropped = min(shift, missing)
        kept = missing - dropped
        places.append(place_of(((prefix << kept) + raw.take(kept)) << dropped, dropped, axes))
    raw.finish()
    return places


# Blocks


def bounded(values):
    check(all(abs(value) < BOUND for value in values), "a value is 1600 or more")
    return values


def decode_classes(passes, classes, points):
    passes.start()
    shape = []
    for _ in range(points):
        shape.append(passes.integer(two_before(shape)))
        check(0 <= shape[-1] < classes[0], "shape class out of range")
    passes.start()
    colour = [passes.integer(k) for k in shape]
    check(all(0 <= k < classes[1] for k in colour), "colour class out of range")
    return shape, colour


def two_before(values):
    """Sum of the last two values, as far as there are any."""
    return sum(values[-2:])


def decode_shapes(lattice, passes, sections, block, shape):
    """Return o; s as three lists; the lists of r, t_0, t_1; and the poles."""
    s = []
    passes.open(sections[OPACITY, block], OPACITY)
    shifts = [lattice.rules["opacity"].shift(k) for k in shape]
    steps = decode_following(passes, lattice.units["opacity"], shifts, 21, 4)
    o = [lattice.centres[0] + step for step in steps]
    passes.close()
    bounded(o)
    passes.open(sections[SCALING, block], SCALING)
    for axis in range(3):
        rule = lattice.rules[f"scale_{axis}"]
        shifts = [rule.shift(k, o[i], [each[i] for each in s]) for i, k in enumerate(shape)]
        steps = decode_following(passes, lattice.units["scaling"], shifts, 20, 0 if axis else 4)
        if axis:
            s.append(bounded([before - step for before, step in zip(s[-1], steps, strict=True)]))
        else:
            s.append(bounded([lattice.centres[1] + step for step in steps]))
    passes.close()
    passes.open(sections[ROTATION, block], ROTATION)
    turns, poles = decode_turns(lattice, passes, shape, o, s)
    passes.close()
    return o, s, turns, poles


def decode_turns(lattice, passes, shape, o, s):
    shifts, poles, turns = [], [], []
    for k, logit, scales in zip(shape, o, zip(*s, strict=True), strict=True):
        each = []
        for axis, (one, other) in enumerate(((1, 2), (0, 2), (0, 1))):
            e = max(20 - abs(scales[one] - scales[other]).bit_length(), 0)
            each.append(lattice.rules[TURNS[axis]].shift(k, logit, scales, e))
        shifts.append(each)
        poles.append(2 if each[2] > each[0] else 0)
    for which in range(3):
        passes.start()
        column = []
        for each, p in zip(shifts, poles, strict=True):
            shift = each[(p, 1, 2 - p)[which]]
            column.append(passes.integer(min(shift, 31)) * (lattice.units["rotation"] << shift))
        turns.append(bounded(column))
    return turns, poles


def decode_following(passes, unit, shifts, fraction, centre):
    """Return L (unit 2^shift) of a pass whose contexts depend on the two Gaussians before."""
    passes.start()
    values = []
    for shift in shifts:
        b = min(max((two_before(values) >> fraction) + centre, 0), 7)
        values.append(passes.integer(8 * min(shift, 31) + b) * (unit << shift))
    return values


def decode_f_dc(lattice, passes, places, shifts):
    """Return [Y, Co, Cg] of each Gaussian."""
    passes.start()
    values = []
    for point, shift in enumerate(shifts):
        step, current = lattice.units["sh-dc"] << shift, []
        neighbours = weighted_neighbours(places, point)
        for channel in range(3):
            u = activity = 0
            if neighbours:
                near = [(w, values[i][channel]) for w, i in neighbours]
                total = sum(w for w, _ in near)
                u = (2 * sum(w * v for w, v in near) + total) // (2 * total)
                spread = (4 * sum(w * abs(v - u) for w, v in near)) // (total * step)
                activity = min(5, spread.bit_length())
            context = 96 * channel + 6 * min(shift, 15) + activity
            current.append(u + passes.integer(context) * step)
        values.append(bounded(current))
    return values


def decode_f_rest(lattice, passes, sections, block, sh_degree, shifts, places):
    """Return {coefficient: [Y, Co, Cg], each a list}."""
    found = {}
    near = [[i for _, i in weighted_neighbours(places, p)[:2]] for p in range(len(places))]
    for band in range(1, sh_degree + 1):
        passes.open(sections[SH1 + band - 1, block], SH1 + band - 1)
        if band == 1:
            left = decode_sums(passes, shifts)
        sums = list(left)
        if band < sh_degree:
            passes.start()
            sums = [passes.integer(bucket(each)) if each else 0 for each in left]
            check(all(0 <= own <= each for own, each in zip(sums, left, strict=True)), "sum_1, 2")
        left = [each - own for own, each in zip(sums, left, strict=True)]
        for channel, levels in decode_band(passes, BANDS[band - 1], near, sums):
            for i, column in levels.items():
                values = [
                    level * (lattice.units[f"sh{band}"] << shift)
                    for level, shift in zip(column, shifts, strict=True)
                ]
                found.setdefault(i, [None] * 3)[channel] = bounded(values)
        passes.close()
    return found


def decode_sums(passes, shifts):
    passes.start()
    sums = []
    for shift in shifts:
        sums.append(passes.integer(16 * min(shift, 15) + bucket(two_before(sums))))
        check(sums[-1] >= 0, "a sum is negative")
    return sums


def decode_band(passes, coefficients, near, left):
    """Yield a channel and its levels by coefficient; `left` becomes 0."""
    for channel in range(3):
        tables, levels = next(passes.lists), {}
        for j, i in enumerate(coefficients):
            passes.start(tables[j::8])
            last = channel == 2 and i == coefficients[-1]
            column = levels[i] = []
            for point, r in enumerate(left):
                t = sum((column[n] > 0) - (column[n] < 0) for n in near[point])
                level = passes.integer(3 * bucket(r) + abs(t)) if r else 0
                if last and r:
                    check(abs(level) == 1, "the last level of a band is not 1 or -1")
                    level *= r
                check(abs(level) <= r, "a level is above what is left")
                left[point] -= abs(level)
                column.append(-level if t < 0 else level)
        yield channel, levels


def decode_block(lattice, sections, block, sh_degree, points):
    """Return the binary64 values of each property of a block, and its places."""
    passes = Passes(sections[STATES, block], lattice.tables, f"block {block}")
    passes.open(sections[CLASSES, block], CLASSES)
    shape, colour = decode_classes(passes, lattice.classes, points)
    passes.close()
    o, s, turns, poles = decode_shapes(lattice, passes, sections, block, shape)
    scales = list(zip(*s, strict=True))
    shifts = {
        name: [lattice.rules[name].shift(*each) for each in zip(classes, o, scales, strict=True)]
        for name, classes in (("positions", shape), ("colour", colour))
    }
    low_bits = sections[LOW_BITS, block]
    places = decode_places(lattice, sections[GEOMETRY, block], low_bits, shifts["positions"])
    passes.open(sections[SH_DC, block], SH_DC)
    f_dc = list(zip(*decode_f_dc(lattice, passes, places, shifts["colour"]), strict=True))
    passes.close()
    f_rest = decode_f_rest(lattice, passes, sections, block, sh_degree, shifts["colour"], places)
    passes.finish()
    columns = {"opacity": [v / ONE for v in o]}
    columns |= {f"scale_{i}": [v / ONE for v in s[i]] for i in range(3)}
    columns |= dict(zip([f"rot_{i}" for i in range(4)], rotations(turns, poles), strict=True))
    columns |= dict(zip([f"f_dc_{c}" for c in range(3)], colours(f_dc), strict=True))
    for i, channels in f_rest.items():
        names = [f"f_rest_{c * len(f_rest) + i}" for c in range(3)]
        columns |= dict(zip(names, colours(channels), strict=True))
    for axis, name in enumerate("xyz"):
        columns[name] = [lattice.origin[axis] + p[axis] * (lattice.step / 2) for p in places]
    return columns, places


def rotations(turns, poles):
    rows = []
    for *turn, p in zip(*turns, poles, strict=True):
        r, t_0, t_1 = (value / ONE for value in turn)
        r = max(-1.0, min(r, 1.0))
        c, total = sqrt(1.0 - r * r), t_0 * t_0 + t_1 * t_1
        n, h = sqrt(max(total, 1.0)), sqrt(max(1.0 - total, 0.0))
        a, b = t_0 / n, t_1 / n
        if p == 0:
            rows.append((c * h, r * h, c * a - r * b, c * b + r * a))
        else:
            rows.append((c * h, c * b - r * a, c * a + r * b, r * h))
    return zip(*rows, strict=True)


def colours(channels):
    """R, G and B columns of Y, Co and Cg columns."""
    roots = [1.0 / sqrt(3.0), 1.0 / sqrt(2.0), 1.0 / sqrt(6.0)]
    rows = []
    for each in zip(*channels, strict=True):
        a, b, c = ((v / ONE) * root for v, root in zip(each, roots, strict=True))
        rows.append(((a - c) + b, a + 2.0 * c, (a - c) - b))
    return zip(*rows, strict=True)


def check_sections(sections, sh_degree, blocks):
    block_sections = {GEOMETRY, SH_DC, STATES, OPACITY, SCALING, ROTATION, CLASSES, LOW_BITS}
    block_sections |= {SH1 + band for band in range(sh_degree)}
    expected = {(number, block) for number in block_sections for block in range(blocks)}
    expected |= {(LATTICE, 0), (BOUNDS, 0)} if blocks else {(LATTICE, 0)}
    found = {key for key in sections if key[0] not in (11, 12)}
    check(found == expected, f"sections {sorted(found ^ expected)} missing or too many")


def lattice_values(count, sh_degree, block_size, sections):
    """Return PLY property -> float32 array of a file of lattices."""
    blocks = -(-count // block_size)
    check_sections(sections, sh_degree, blocks)
    lattice = read_lattice(sections[LATTICE, 0], sh_degree)
    names = ["x", "y", "z", "opacity", *[f"f_dc_{c}" for c in range(3)]]
    names += [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]
    names += [f"f_rest_{i}" for i in range(3 * len(sh_bands(sh_degree)))]
    values = {name: [] for name in names}
    bounds = Reader(sections.get((BOUNDS, 0), b""), "bounds")
    for block in range(blocks):
        points = min(block_size, count - block * block_size)
        columns, places = decode_block(lattice, sections, block, sh_degree, points)
        for name in names:
            values[name] += columns[name]
        box = [f(p[axis] for p in places) for f in (min, max) for axis in range(3)]
        check(list(bounds.take("6I")) == box, f"bounds of block {block}")
    check(not bounds.rest(), "bounds: bytes left over")
    return {
        name: np.array(column, np.float64).astype(np.float32) for name, column in values.items()
    }

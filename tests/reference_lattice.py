"""Profiles 3-5 of the reference decoder (section "Lattices").

Written only from FORMAT.md; shares no code with the codec, and favours clarity over speed.
"""

import math
from dataclasses import dataclass

from reference_tools import (
    LANES,
    BinaryCoder,
    RawBits,
    Reader,
    axes_of,
    cells_of,
    check,
    check_last_states,
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
CLASSES, LOW_BITS, FAR_CENTRES, BASIS = 14, 15, 22, 23
BANDS = (SH_1, SH_2, SH_3)
PRECISION = 12
ONE = 1 << 20
RULES = ("opacity", "s_0", "s_1", "s_2", "turn_0", "turn_1", "turn_2", "positions", "colour")
SHAPE_LISTS = (31, 16, 256, 256, 256, 256, 32, 32, 32)
SHAPE_STREAMS = (CLASSES, CLASSES, OPACITY, *[SCALING] * 3, *[ROTATION] * 3)


@dataclass(frozen=True)
class Rule:
    """a, b, c_0 to c_2 and limit of a rule."""

    a: int
    b: int
    c: tuple
    limit: int
    weight: int = 1

    def shift(self, gaussian, number, extra=0):
        """Shift of a Gaussian of class `number`."""
        total = self.a + (self.weight * number << 16)
        total += (self.b * min(gaussian.opacity, 0)) >> 20
        total += sum((c * s) >> 20 for c, s in zip(self.c, gaussian.scales, strict=False))
        return min(max((total >> 16) + extra, 0), self.limit)


@dataclass
class Lattice:
    """The section `lattice`; units are of opacity, scaling, rotation, sh-dc, sh1, sh2, sh3."""

    origin: tuple
    step: float
    bits: tuple
    classes: tuple
    centres: tuple
    units: tuple
    rules: dict
    tables: list = None


@dataclass
class Gaussian:
    """Decoded values of a Gaussian, in fixed point; initially 0."""

    shape: int = 0
    colour: int = 0
    opacity: int = 0
    scales: tuple = (0, 0, 0)
    pole: int = 0
    turns: tuple = ()
    shift: int = 0


@dataclass
class Block:
    """A decoded block; the last Gaussians are the far ones, with their `centres`.

    `missing` has the missing bits of each Gaussian's leaf, `colours` the planes of f_dc, `levels`
    those of SH-AC by colour, `basis` the section of the local basis, if there is one.
    """

    gaussians: list
    quaternions: list
    places: list
    missing: list
    centres: list
    colours: list
    levels: list
    basis: bytes | None


# Section "The `lattice` section"


def read_lattice(content, sh_degree):
    """The section `lattice`; its tables are in the order of the lists of contexts."""
    reader = Reader(content, "lattice")
    origin, step = reader.numbers("3f"), reader.f32()
    check(finite(*origin, step) and step > 0, "lattice: origin or step")
    bits, classes, centres = reader.numbers("3B"), reader.numbers("2B"), reader.numbers("2i")
    check(max(bits) <= 21, f"lattice: {bits} bits")
    check(all(1 <= number <= 16 for number in classes), f"lattice: {classes} classes")
    check(all(abs(centre) <= 400 * ONE for centre in centres), "lattice: a centre above 400")
    units = reader.numbers("7I")
    rules = {name: read_rule(reader, name) for name in RULES}
    check_units(units, rules)
    lattice = Lattice(origin, step, bits, classes, centres, units, rules)
    lattice.tables = read_tables(reader, list_sizes(sh_degree))
    return lattice


def read_rule(reader, name):
    a, b, *c, limit = reader.numbers("5iB")
    check(all(abs(number) < 1 << 22 for number in (b, *c)), f"lattice: rule of {name}")
    return Rule(a, b, tuple(c), limit, 3 if name == "positions" else 1)


def check_units(units, rules):
    limits = [rule.limit for rule in rules.values()]
    colour = limits[8]
    of_units = [limits[0], max(limits[1:4]), max(limits[4:7]), *[colour] * 4]
    for unit, limit in zip(units, of_units, strict=False):
        check(unit > 0, "lattice: a unit of 0")
        check(unit.bit_length() + limit <= 31, f"lattice: unit {unit} with limit {limit}")
    check(limits[7] <= 93, f"lattice: limit {limits[7]} of positions")


def list_sizes(sh_degree):
    """Number of contexts of each list (table of section "Passes")."""
    sizes = [*SHAPE_LISTS, 288]
    if sh_degree > 0:
        sizes.append(256)
    for band in range(sh_degree):
        sizes += [16] * (band + 1 < sh_degree) + [384] * 3
    return sizes


def read_tables(reader, sizes):
    """The table of each context of each list."""
    marked, count = reader.u16(), reader.u16()
    marks = BinaryCoder(reader.take(marked), 2, "lattice: marks")
    places = []
    total = 0
    for size in sizes:
        begins = [1]
        while len(begins) < size:
            begins.append(marks.bit(begins[-1] if len(begins) > 1 else 0))
        check(sum(begins) <= 64, "lattice: a list of more than 64 tables")
        places.append([total + sum(begins[: i + 1]) - 1 for i in range(size)])
        total += sum(begins)
    marks.finish()
    check(total == count, f"lattice: {count} tables, expected {total}")
    alphabets = reader.take(count)
    check(all(1 <= size <= 240 for size in alphabets), "lattice: size of an alphabet")
    sent = sent_tables(reader.rest(), [(size, 3) for size in alphabets])
    tables = [table_of(frequencies(weights, PRECISION)) for weights in sent]
    return [[tables[place] for place in one] for one in places]


# Sections "Tokens" and "Passes"


@dataclass
class Stream:
    """Words and raw bits of a section."""

    words: Reader
    raw: RawBits

    def finish(self):
        self.words.finish()
        self.raw.finish()


def open_stream(content, name):
    reader = Reader(content, name)
    size = reader.u32()
    check(size % 2 == 0, f"{name}: half a word")
    return Stream(Reader(reader.take(size), name), RawBits(reader.rest(), name))


@dataclass
class Pass:
    """Decodes the symbols of a pass with lanes in rotation."""

    states: list
    done: int = 0

    def integer(self, tables, context, stream):
        lane, self.done = self.done % LANES, self.done + 1
        token = rans_symbol(self.states, lane, tables[context], PRECISION, stream.words)
        magnitude = token >> 1
        if magnitude >= 16:
            bits, leading = ((magnitude - 16) >> 2) + 2, 4 + ((magnitude - 16) & 3)
            magnitude = (leading << bits) + stream.raw.take(bits)
        return -magnitude if token & 1 else magnitude


def fixed_point(value):
    """Check that a value is below 1600 in magnitude."""
    check(abs(value) < 1600 * ONE, "a value of 1600 or more")
    return value


def clamp(value, low, high):
    return min(max(value, low), high)


# Shape pass


def decode_shapes(lattice, states, sections, count):
    """Gaussians with all attributes except positions and colours."""
    streams = {
        section: open_stream(sections[section], f"section {section}")
        for section in (CLASSES, OPACITY, SCALING, ROTATION)
    }
    coder = Pass(states)
    recent = [(0, 0)] * 9
    gaussians = []
    for _ in range(count):
        gaussian = Gaussian()
        for k in range(9):
            value = decode_shape_value(lattice, coder, streams, gaussian, k, sum(recent[k]))
            recent[k] = (value, recent[k][0])
        gaussian.shift = lattice.rules["colour"].shift(gaussian, gaussian.colour)
        gaussians.append(gaussian)
    for stream in streams.values():
        stream.finish()
    return gaussians


def decode_shape_value(lattice, coder, streams, gaussian, k, sum_before):
    """Decode symbol k of a Gaussian; return the class, or the level in fixed point."""
    tables, stream = lattice.tables[k], streams[SHAPE_STREAMS[k]]
    if k < 2:
        context = gaussian.shape if k else sum_before
        number = coder.integer(tables, context, stream)
        check(0 <= number < lattice.classes[k], f"class {number}")
        if k:
            gaussian.colour = number
        else:
            gaussian.shape = number
        return number
    if k >= 6:
        return decode_turn(lattice, coder, stream, gaussian, k)
    shift = lattice.rules[RULES[k - 2]].shift(gaussian, gaussian.shape)
    if k == 2:
        bucket = clamp((sum_before >> 21) + 4, 0, 7)
    else:
        bucket = clamp((sum_before >> 20) + (4 if k == 3 else 0), 0, 7)
    level = coder.integer(tables, 8 * min(shift, 31) + bucket, stream)
    value = level * (lattice.units[0 if k == 2 else 1] << shift)
    store_value(lattice, gaussian, k, value)
    return value


def store_value(lattice, gaussian, k, value):
    if k == 2:
        gaussian.opacity = fixed_point(lattice.centres[0] + value)
        return
    scales = list(gaussian.scales)
    before = lattice.centres[1] + value if k == 3 else scales[k - 4] - value
    scales[k - 3] = fixed_point(before)
    gaussian.scales = tuple(scales)


def turn_shift(lattice, gaussian, axis):
    j, k = (other for other in range(3) if other != axis)
    difference = abs(gaussian.scales[j] - gaussian.scales[k])
    extra = max(20 - difference.bit_length(), 0)
    return lattice.rules[f"turn_{axis}"].shift(gaussian, gaussian.shape, extra)


def decode_turn(lattice, coder, stream, gaussian, k):
    if k == 6:
        higher = turn_shift(lattice, gaussian, 2) > turn_shift(lattice, gaussian, 0)
        gaussian.pole = 2 if higher else 0
    axis = (gaussian.pole, 1, 2 - gaussian.pole)[k - 6]
    shift = turn_shift(lattice, gaussian, axis)
    level = coder.integer(lattice.tables[k], min(shift, 31), stream)
    value = fixed_point(level * (lattice.units[2] << shift))
    gaussian.turns = (*gaussian.turns, value)
    return value


def quaternion(gaussian):
    """w, x, y, z (section "Shapes")."""
    r, t_0, t_1 = (value / ONE for value in gaussian.turns)
    r = clamp(r, -1.0, 1.0)
    c = math.sqrt(1 - r * r)
    squares = t_0 * t_0 + t_1 * t_1
    n, h = math.sqrt(max(squares, 1)), math.sqrt(max(1 - squares, 0))
    a, b = t_0 / n, t_1 / n
    if gaussian.pole == 0:
        return c * h, r * h, c * a - r * b, c * b + r * a
    return c * h, c * b - r * a, c * a + r * b, r * h


# Positions


def decode_places(lattice, sections, gaussians):
    """Positions on the axes, and missing bits of each Gaussian's leaf (section "Positions")."""
    axes = axes_of(lattice.bits)
    raw = RawBits(sections[LOW_BITS], "low-bits")
    places, missing = [], []
    far = len(far_centres(sections, len(gaussians)))
    for leaf in read_tree(sections[GEOMETRY], len(gaussians) - far, len(axes)):
        dropped = dropped_bits(lattice, gaussians[len(places)], leaf.missing)
        sent = raw.take(leaf.missing - dropped)
        cells = cells_of(((leaf.prefix << (leaf.missing - dropped)) + sent) << dropped, axes)
        halves = half_cells(axes, dropped)
        place = tuple(2 * cell + half for cell, half in zip(cells, halves, strict=True))
        places += [place] * leaf.count
        missing += [leaf.missing] * leaf.count
    raw.finish()
    return places + [tuple(2 ** (b + 1) - 1 for b in lattice.bits)] * far, missing + [0] * far


def dropped_bits(lattice, gaussian, missing):
    """Number of the lowest bits of a code that are not sent."""
    return min(lattice.rules["positions"].shift(gaussian, gaussian.shape), missing)


def half_cells(axes, dropped):
    """Half the size, on each axis, of the cell of a code without its lowest bits."""
    lowest = axes[len(axes) - dropped :]
    return [1 << lowest.count(axis) for axis in range(3)]


def far_centres(sections, count):
    """Centres of the last Gaussians of a block, which are far (section "Far Gaussians")."""
    if FAR_CENTRES not in sections:
        return []
    reader = Reader(sections[FAR_CENTRES], "far")
    centres = []
    while not centres or reader.at < len(sections[FAR_CENTRES]):
        centres.append(reader.numbers("3f"))
    check(len(centres) <= count, "far: more than the block has")
    check(all(finite(*centre) for centre in centres), "far: a centre is not finite")
    return centres


# Colours


def decode_dc(lattice, states, content, gaussians, near):
    """Y, Co, Cg of each Gaussian, in fixed point."""
    stream, coder = open_stream(content, "sh-dc"), Pass(states)
    planes = [[], [], []]
    for gaussian, neighbours in zip(gaussians, near, strict=False):
        step = lattice.units[3] << gaussian.shift
        for channel, plane in enumerate(planes):
            guess, spread = neighbours.predict(plane)
            activity = min(5, (4 * spread // (max(neighbours.total, 1) * step)).bit_length())
            context = 96 * channel + 6 * min(gaussian.shift, 15) + activity
            level = coder.integer(lattice.tables[9], context, stream)
            plane.append(fixed_point(guess + level * step))
    stream.finish()
    return planes


def bucket(n):
    if n < 2:
        return n
    k = n.bit_length() - 1
    return min(2 * k + ((n >> (k - 1)) & 1), 15)


def decode_ac(lattice, states, sections, gaussians, near, sh_degree):
    """Levels of Y, Co, Cg of each coefficient or component of f_rest: planes by colour."""
    lists = iter(lattice.tables[10:])
    left = None
    colours = [[], [], []]
    for band in range(sh_degree):
        stream = open_stream(sections[BANDS[band]], f"sh{band + 1}")
        coder = Pass(states)
        if band == 0:
            left = decode_sums(coder, next(lists), stream, gaussians)
        sums = left
        if band + 1 < sh_degree:
            sums = decode_band_sums(coder, next(lists), stream, left)
            left = [whole - part for whole, part in zip(left, sums, strict=False)]
        levels = decode_levels(coder, lists, stream, sums, near, 2 * band + 3)
        stream.finish()
        for colour, planes in enumerate(levels):
            colours[colour] += planes
    return colours


def values_of(lattice, basis, colours, gaussians):
    """Y, Co, Cg of each coefficient of f_rest, in fixed point: planes by colour."""
    if basis is not None:
        return [turned(lattice, basis, planes, gaussians) for planes in colours]
    return [
        [
            [
                fixed_point(level * (lattice.units[4 + band_of(k)] << gaussian.shift))
                for level, gaussian in zip(plane, gaussians, strict=False)
            ]
            for k, plane in enumerate(planes)
        ]
        for planes in colours
    ]


def band_of(k):
    """The band of a coefficient, from 0."""
    return 0 if k < 3 else 1 if k < 8 else 2


FACTORS = (4, 5, 6, 7, 8, 10, 12, 14, 16, 20, 24, 28, 32)


def turned(lattice, content, planes, gaussians):
    """Values of coefficients, in fixed point, from levels of components (section "Local basis")."""
    size, count = len(planes), len(gaussians)
    check(len(content) > 0 and 1 <= content[0] <= count, "basis: runs")
    runs, raw = content[0], RawBits(content[1:], "basis")
    entries = [[[raw.take(5) - 15 for _ in range(size)] for _ in range(size)] for _ in range(runs)]
    numbers = [[raw.take(4) for _ in range(size)] for _ in range(runs)]
    raw.finish()
    check(all(e <= 15 for run in entries for row in run for e in row), "basis: an entry")
    check(all(q < len(FACTORS) for run in numbers for q in run), "basis: a factor")
    found = [[] for _ in range(size)]
    for run in range(runs):
        for i in range(run * count // runs, (run + 1) * count // runs):
            step = float(lattice.units[4] << gaussians[i].shift)
            for k, values in enumerate(found):
                total = sum(
                    entries[run][k][j] * FACTORS[numbers[run][j]] * planes[j][i]
                    for j in range(size)
                )
                values.append(fixed_point(float(total) * step / 64))
    return found


def decode_sums(coder, tables, stream, gaussians):
    """S of every Gaussian."""
    sums = []
    for gaussian in gaussians:
        context = 16 * min(gaussian.shift, 15) + bucket(sum(sums[-2:]))
        sums.append(coder.integer(tables, context, stream))
        check(sums[-1] >= 0, "sh1: a sum below 0")
    return sums


def decode_band_sums(coder, tables, stream, left):
    """Sums of a band that is not the last."""
    sums = []
    for most in left:
        found = coder.integer(tables, bucket(most), stream) if most > 0 else 0
        check(0 <= found <= most, "sh: a sum below 0 or above what is left")
        sums.append(found)
    return sums


def decode_levels(coder, lists, stream, sums, near, size):
    """Levels of the `size` coefficients of a band, by colour and coefficient."""
    left = list(sums)
    colours = []
    for colour in range(3):
        tables = next(lists)
        planes = []
        for j in range(size):
            last = colour == 2 and j == size - 1
            planes.append(decode_plane(coder, tables, stream, left, near, j, last))
        colours.append(planes)
    return colours


def sign(value):
    return (value > 0) - (value < 0)


def decode_plane(coder, tables, stream, left, near, j, last):
    """Levels of one coefficient; subtracts their magnitudes from `left`."""
    plane = []
    for i, neighbours in enumerate(near):
        if left[i] == 0:
            plane.append(0)
            continue
        trend = sum(sign(plane[place]) for place in neighbours.places[:2])
        context = 8 * (3 * bucket(left[i]) + abs(trend)) + j
        level = coder.integer(tables, context, stream)
        if last:
            check(abs(level) == 1, "sh: the last level is not a sign")
            level *= left[i]
        check(abs(level) <= left[i], "sh: a level above what is left")
        left[i] -= abs(level)
        plane.append(-level if trend < 0 else level)
    return plane


ROOTS = tuple(1 / math.sqrt(number) for number in (3, 2, 6))


def colours_of(planes):
    """R, G, B in binary32, from Y, Co, Cg in fixed point."""
    result = [[], [], []]
    for numbers in zip(*planes, strict=False):
        a, b, c = (number / ONE * root for number, root in zip(numbers, ROOTS, strict=False))
        for plane, value in zip(result, ((a - c) + b, a + 2 * c, (a - c) - b), strict=False):
            plane.append(value)
    return [rounded(plane) for plane in result]


# Blocks


def expected_sections(sh_degree):
    """Ids of the sections that each block has (table of sections)."""
    ids = {GEOMETRY, SH_DC, STATES, OPACITY, SCALING, ROTATION, CLASSES, LOW_BITS}
    return ids | set(BANDS[:sh_degree])


def decode_block(lattice, sections, count, sh_degree):
    """The block of these sections."""
    states = first_states(Reader(sections[STATES], "states"), LANES)
    gaussians = decode_shapes(lattice, states, sections, count)
    places, missing = decode_places(lattice, sections, gaussians)
    near = [neighbours_of(places, i) for i in range(count)]
    colours = decode_dc(lattice, states, sections[SH_DC], gaussians, near)
    levels = decode_ac(lattice, states, sections, gaussians, near, sh_degree)
    check_last_states(states)
    return Block(
        gaussians=gaussians,
        quaternions=[tuple(rounded(quaternion(one)).tolist()) for one in gaussians],
        places=places,
        missing=missing,
        centres=far_centres(sections, count),
        colours=colours,
        levels=levels,
        basis=sections.get(BASIS),
    )


def floats_of(lattice, block):
    """Floats of a block, by name."""
    found = shape_floats(lattice, block)
    for k, centre in enumerate(reversed(block.centres), 1):
        for name, number in zip("xyz", centre, strict=True):
            found[name][-k] = number
    found.update((f"f_dc_{c}", plane) for c, plane in enumerate(colours_of(block.colours)))
    rest = values_of(lattice, block.basis, block.levels, block.gaussians)
    for i, planes in enumerate(zip(*rest, strict=False)):
        for c, plane in enumerate(colours_of(planes)):
            found[f"f_rest_{c * len(rest[0]) + i}"] = plane
    return found


def shape_floats(lattice, block):
    found = {}
    half = lattice.step / 2
    for axis, name in enumerate("xyz"):
        found[name] = rounded([lattice.origin[axis] + place[axis] * half for place in block.places])
    found["opacity"] = rounded([gaussian.opacity / ONE for gaussian in block.gaussians])
    for k in range(3):
        found[f"scale_{k}"] = rounded([one.scales[k] / ONE for one in block.gaussians])
    for k, column in enumerate(zip(*block.quaternions, strict=False)):
        found[f"rot_{k}"] = rounded(column)
    return found

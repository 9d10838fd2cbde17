"""Sequences of the reference decoder (section "Sequences").

Written only from FORMAT.md; shares no code with the codec, and favours clarity over speed.
"""

import math
import unicodedata
from dataclasses import dataclass, field

import numpy
from reference_decoder import (
    EXTRA,
    KEY_FRAME,
    KNOWN,
    LEVEL,
    MOTION,
    SEQUENCE,
    TIMELINE,
    decode_file,
    joined,
    lattice_blocks,
    read_file,
)
from reference_lattice import (
    ONE,
    RULES,
    dropped_bits,
    fixed_point,
    floats_of,
    half_cells,
    turn_shift,
)
from reference_tools import BinaryCoder, Reader, axes_of, check, finite

SHAPE, ROTATION, PLACE, COLOUR, SH_AC = range(5)
RUN = 16
BASES = {SHAPE: 44, ROTATION: 3119, PLACE: 5426, COLOUR: 7733, SH_AC: 10040}
CONTEXTS = 10040 + 128 * 90
SAME = ("has_normals", "kept_order", "antialiased", "coordinates", "profile", "sh_degree")


@dataclass
class Moving:
    """A block of a key frame, and what its changes need of the frame before."""

    lattice: object
    block: object
    flags: list = field(default_factory=list)
    changes: dict = field(default_factory=dict)
    contexts: BinaryCoder = None

    def __post_init__(self):
        count = len(self.block.gaussians)
        self.flags = [[0] * 5 for _ in range(count)]
        self.changes = {part: [(0,) * 4] * count for part in range(4)}
        self.contexts = BinaryCoder(b"", CONTEXTS)


def decode_sequence(data):
    """Decode a sequence; raises ValueError if it is invalid.

    `frames` has what `decode_file` returns of each frame.
    """
    header, sections = read_file(data)
    check(header.features & SEQUENCE, "one scene, expected a sequence")
    check((TIMELINE, 0) in sections, "section timeline is missing")
    count, rate, names = read_timeline(sections[TIMELINE, 0])
    kinds = [key for key in sections if key[0] in KNOWN]
    check([block for _, block in kinds[1:]] == list(range(count)), "frames: out of order")
    check({kind for kind, _ in kinds[1:]} <= {KEY_FRAME, MOTION}, "frames: other sections")
    check(kinds[1][0] == KEY_FRAME, "frame 0: no key frame")
    frames, moving = [], []
    for kind, number in kinds[1:]:
        content = sections[kind, number]
        if kind == KEY_FRAME:
            own, frame = decode_key(header, content, number)
            check(not own.features & ~header.features, f"key frame {number}: features")
            moving = moving_blocks(content)
        else:
            move(moving, content)
            floats = [floats_of(one.lattice, one.block) for one in moving]
            frame = frames[-1] | {"values": joined(floats, header.sh_degree)}
        frames.append(frame)
    return {"count": count, "rate": rate, "names": names, "frames": frames}


def read_timeline(content):
    """Number of frames, frames per second as a quotient, names."""
    reader = Reader(content, "timeline")
    count, *rate = reader.numbers("3I")
    check(1 <= count <= 1 << 24, f"timeline: {count} frames")
    check(min(rate) > 0, "timeline: frames per second")
    text = reader.rest()
    if not text:
        return count, tuple(rate), ()
    check(len(text) <= 1 << 26, "timeline: names above 2^26 bytes")
    names = tuple(text.decode("utf-8").split("\n"))
    check(len(names) == count, f"timeline: {len(names)} names of {count} frames")
    control = any(unicodedata.category(letter) == "Cc" for name in names for letter in name)
    check(not control, "timeline: a control character")
    return count, tuple(rate), names


def decode_key(header, content, number):
    """Header and values of a key frame."""
    own, sections = read_file(content)
    check(not {LEVEL, EXTRA} & {kind for kind, _ in sections}, f"key frame {number}: sections")
    for name in SAME:
        check(getattr(own, name) == getattr(header, name), f"key frame {number}: {name}")
    first = number == 0
    same = (own.count, own.block_size) == (header.count, header.block_size) and own.count > 0
    check(same or not first, "key frame 0: number of Gaussians, or block size")
    return own, decode_file(content)


def moving_blocks(content):
    lattice, blocks = lattice_blocks(*read_file(content))
    return [Moving(lattice, block) for block in blocks]


def move(moving, content):
    """Change the blocks to the next frame."""
    reader = Reader(content, "motion")
    sizes = reader.numbers(f"{len(moving)}I")
    for one, size in zip(moving, sizes, strict=True):
        coder = BinaryCoder(reader.take(size), CONTEXTS, "motion")
        coder.chances, coder.seen = one.contexts.chances, one.contexts.seen
        move_block(one, coder)
        coder.finish()
        one.contexts = coder
    reader.finish()


def move_block(one, coder):
    one.flags = read_flags(coder, one.flags)
    one.changes = {
        part: read_part(one, coder, part, members_of(one, coder, part)) for part in range(4)
    }
    if one.block.levels[0]:
        for i in members(one.flags, SH_AC):
            change_levels(one, coder, i)


# Flags


def read_flags(coder, before):
    """The flags of each Gaussian, by part."""
    flags, last, followed = [], [0] * 5, 0
    for first in range(0, len(before), RUN):
        run = before[first : first + RUN]
        followed = coder.bit(2 * any(map(any, run)) + followed)
        for old in run:
            own = [0] * 5
            for part in range(5 * followed):
                context = 4 + 8 * part + 4 * old[part] + 2 * last[part] + any(own)
                own[part] = last[part] = coder.bit(context)
            flags.append(own)
    return flags


def members(flags, part):
    return [i for i, own in enumerate(flags) if own[part]]


def members_of(one, coder, part):
    """Members of a part, after far ones of part 2 have moved."""
    near = len(one.block.gaussians) - len(one.block.centres)
    found = members(one.flags, part)
    if part == PLACE:
        for i in found:
            if i >= near:
                one.block.centres[i - near] = tuple(read_float(coder) for _ in range(3))
        found = [i for i in found if i < near]
    return found


def read_float(coder):
    number = 0
    for _ in range(32):
        coder.chances[0], coder.seen[0], kept = 32768, 0, (coder.chances[0], coder.seen[0])
        number = 2 * number + coder.bit(0)
        coder.chances[0], coder.seen[0] = kept
    value = float(numpy.uint32(number).view("<f4"))
    check(finite(value), "motion: a centre is not finite")
    return value


# Parts


def read_integer(coder, base):
    n = 0
    while n < 31 and coder.bit(base + n):
        n += 1
    if n == 0:
        return 0
    negative = coder.bit(base + 32)
    magnitude = 1
    for j in range(n - 1):
        magnitude = 2 * magnitude + coder.bit(base + 32 * (1 + min(j, 2)) + n)
    return -magnitude if negative else magnitude


def read_part(one, coder, part, found):
    """Change the members of part 0 to 3; the changes of all Gaussians."""
    changes = [(0,) * 4] * len(one.flags)
    if not found:
        return changes
    base, old = BASES[part], one.changes[part]
    high = coder.bit(base)
    mode = 2 * high + coder.bit(base + 1 + high)
    size = 4 if part == SHAPE else 3
    last, before = [0] * size, None
    for i in found:
        steps, own = steps_of(one, i, part), []
        for v in range(size):
            context = base + 3 + 128 * (6 * v + min(abs(last[v]).bit_length(), 5))
            last[v] = read_integer(coder, context)
            a = old[i][v]
            b, c = (0, 0) if before is None else (changes[before][v], old[before][v])
            guess = (0, a, b, a + b - c)[mode]
            level = last[v] + (2 * guess + steps[v]) // (2 * steps[v])
            own.append(level * steps[v])
        changes[i], before = tuple(own), i
        limit = 1 << 31 if part == PLACE else 3200 * ONE
        check(all(abs(change) < limit for change in own), "motion: a change is too large")
        CHANGES[part](one, i, own)
    return changes


def steps_of(one, i, part):
    """Step sizes of a Gaussian's values."""
    lattice, gaussian = one.lattice, one.block.gaussians[i]
    if part == SHAPE:
        opacity, scaling = lattice.units[:2]
        return [
            (scaling if k else opacity) << lattice.rules[RULES[k]].shift(known, gaussian.shape)
            for k, known in enumerate((type(gaussian)(), *[gaussian] * 3))
        ]
    if part == ROTATION:
        return [lattice.units[2] << turn_shift(lattice, gaussian, axis) for axis in range(3)]
    if part == PLACE:
        dropped = dropped_bits(lattice, gaussian, one.block.missing[i])
        return [2 * half for half in half_cells(axes_of(lattice.bits), dropped)]
    return [lattice.units[3] << colour_shift(one, i)] * 3


def colour_shift(one, i):
    gaussian = one.block.gaussians[i]
    return one.lattice.rules["colour"].shift(gaussian, gaussian.colour)


def change_shape(one, i, changes):
    gaussian = one.block.gaussians[i]
    gaussian.opacity = fixed_point(gaussian.opacity + changes[0])
    pairs = zip(gaussian.scales, changes[1:], strict=True)
    gaussian.scales = tuple(fixed_point(scale + change) for scale, change in pairs)


def change_rotation(one, i, changes):
    a, b, c, d = one.block.quaternions[i]
    x, y, z = (change / ONE for change in changes)
    squares = (x * x + y * y) + z * z
    n, w = math.sqrt(max(squares, 1)), math.sqrt(max(1 - squares, 0))
    x, y, z = x / n, y / n, z / n
    turned = (
        ((a * w - b * x) - c * y) - d * z,
        ((a * x + b * w) + c * z) - d * y,
        ((a * y - b * z) + c * w) + d * x,
        ((a * z + b * y) - c * x) + d * w,
    )
    a, b, c, d = turned
    length = math.sqrt(((a * a + b * b) + c * c) + d * d)
    one.block.quaternions[i] = tuple(value / (-length if a < 0 else length) for value in turned)


def change_place(one, i, changes):
    place = tuple(p + change for p, change in zip(one.block.places[i], changes, strict=True))
    check(all(abs(p) < 1 << 30 for p in place), "motion: a place of 2^30 or more")
    one.block.places[i] = place


def change_colour(one, i, changes):
    for plane, change in zip(one.block.colours, changes, strict=True):
        plane[i] = fixed_point(plane[i] + change)


CHANGES = {
    SHAPE: change_shape,
    ROTATION: change_rotation,
    PLACE: change_place,
    COLOUR: change_colour,
}


def change_levels(one, coder, i):
    """Change the levels of SH-AC of a Gaussian."""
    gaussian, shift = one.block.gaussians[i], colour_shift(one, i)
    size, before = len(one.block.levels[0]), 0
    for c, planes in enumerate(one.block.levels):
        for k, plane in enumerate(planes):
            base = BASES[SH_AC] + 128 * (2 * (size * c + k) + (before != 0))
            before = read_integer(coder, base)
            plane[i] = adapted(plane[i], shift - gaussian.shift) + before
            check(abs(plane[i]) < 1 << 30, "motion: a level of 2^30 or more")
    gaussian.shift = shift


def adapted(level, coarser):
    """A level with step sizes 2^coarser times those before."""
    if coarser >= 0:
        return (level + ((1 << coarser) // 2)) // (1 << coarser)
    level <<= -coarser
    return level if abs(level) < 1 << 30 else 0

"""Reference decoder of `.egs` files.

Written only from FORMAT.md; shares no code with the codec, and favours clarity over speed.
"""

import math
import re
import struct
import zlib
from dataclasses import dataclass

import numpy
import reference_channels
import reference_lattice
import reference_lossless
from reference_tools import Reader, check, crc32c, finite

MAGIC = bytes.fromhex("894547530D0A1A0A")
CHANNELS, COMMENTS, EXTRA, LATTICE, INDEX, GPCC, TOOL, CODER = 1, 11, 12, 13, 16, 17, 18, 19
LEVEL, ERRORS, FAR_CENTRES, BASIS, TIMELINE, KEY_FRAME, MOTION = range(20, 27)
SCENE = {CHANNELS, COMMENTS, EXTRA, LATTICE, INDEX, TOOL, CODER, ERRORS, TIMELINE}
KNOWN = range(1, 27)
FIRST = (INDEX, ERRORS, CHANNELS, LATTICE, TOOL, CODER, TIMELINE)
G_PCC, TORCHAC, FAR, LOCAL_BASIS, SEQUENCE = 1, 2, 4, 8, 16
LOSSLESS = 6
TYPES = ("<i1", "<u1", "<i2", "<u2", "<i4", "<u4", "<f4", "<f8")
LAYOUT = re.compile(r"[xyz]|f_dc_[0-2]|f_rest_\d+|opacity|scale_[0-2]|rot_[0-3]", re.ASCII)


@dataclass(frozen=True)
class Header:
    """Fields of the header, without derived ones."""

    minor: int
    count: int
    features: int
    has_normals: bool
    kept_order: bool
    antialiased: bool
    coordinates: str | None
    profile: int
    sh_degree: int
    block_size: int
    sections: tuple

    @property
    def blocks(self):
        return -(-self.count // self.block_size)

    def block_count(self, block):
        """Number of Gaussians of a block."""
        return min(self.block_size, self.count - block * self.block_size)


@dataclass(frozen=True)
class Entry:
    """Entry of the section table."""

    id: int
    flags: int
    block: int
    size: int
    checksum: int


# Section "File"


def read_file(data):
    """Header, and the sections' bytes by (id, block), including unknown ids."""
    data = bytes(data)
    header, at = read_header(data)
    check_table(header)
    sections = {}
    for entry in header.sections:
        name = f"section {entry.id} of block {entry.block}"
        end = at + entry.size
        check(end <= len(data), f"{name}: truncated")
        content, at = data[at:end], end + -end % 4
        check(crc32c(content) == entry.checksum, f"{name}: checksum")
        check(data[end:at] == b"\0" * (at - end), f"{name}: padding")
        sections[entry.id, entry.block] = content
    check(at == len(data), "file: bytes after the last section")
    return header, sections


def read_header(data):
    reader = Reader(data, "header")
    check(reader.take(8) == MAGIC, "header: not an .egs file")
    version, minor, size = reader.numbers("HHI")
    check(version in (1, 2), f"header: version {version}")
    count, features, flags, axes, profile, degree = reader.numbers("QIHBBB")
    reserved, block_size, sections = reader.take(3), reader.u32(), reader.u32()
    check(size == 48 + 20 * sections, f"header: {size} bytes, expected {48 + 20 * sections}")
    check(size <= len(data), "header: truncated")
    table = tuple(Entry(*reader.numbers("HHIQI")) for _ in range(sections))
    check(crc32c(data[: reader.at]) == reader.u32(), "header: checksum")
    check(count < 1 << 53, "header: count")
    check(features < 32, f"header: features {features:#x} are not known")
    check(version == (2 if features >= 4 else 1), f"header: version {version}")
    check(flags < 8, f"header: flags {flags:#x}")
    check(not flags & 2 or profile == LOSSLESS, "header: order of the input, but not lossless")
    check(profile <= 6, f"header: profile {profile}")
    of_lattices = FAR | LOCAL_BASIS | SEQUENCE
    of_profile = G_PCC | TORCHAC if profile <= 2 else 0 if profile == LOSSLESS else of_lattices
    check(not features & ~of_profile, f"header: features with profile {profile}")
    check(degree <= 3, f"header: SH degree {degree}")
    check(degree or not features & LOCAL_BASIS, "header: a local basis of SH degree 0")
    check(reserved == b"\0\0\0", "header: reserved bytes are not 0")
    check(1 <= block_size <= 65536, f"header: block size {block_size}")
    marks = [bool(flags & bit) for bit in (1, 2, 4)]
    system = coordinates_of(axes)
    header = Header(minor, count, features, *marks, system, profile, degree, block_size, table)
    return header, reader.at


def coordinates_of(number):
    if number == 0:
        return None
    axes = ((number - 1) // 36, (number - 1) // 6 % 6, (number - 1) % 6)
    check(axes[0] < 6, f"header: coordinates {number}")
    system = "".join("RLUDBF"[axis] for axis in axes)
    check(is_system(system), f"header: coordinates {system}")
    return system


def is_system(text):
    """Whether each axis of space occurs once, and x points right or left."""
    return (
        len(text) == 3
        and set(text) <= set("RLUDBF")
        and text[0] in "RL"
        and len({"RLUDBF".index(letter) // 2 for letter in text}) == 3
    )


# Section "Section table entry"


def check_table(header):
    seen = set()
    for entry in header.sections:
        name = f"section {entry.id} of block {entry.block}"
        check(entry.flags < 2, f"{name}: flags {entry.flags:#x}")
        check(entry.id in KNOWN or entry.flags == 1, f"{name}: unknown, and not optional")
        check((entry.id, entry.block) not in seen, f"{name}: occurs twice")
        check(entry.size < 1 << 53, f"{name}: size")
        blocks = header.blocks
        if entry.id in SCENE or entry.id not in KNOWN:
            blocks = 1 if entry.id in SCENE else max(blocks, 1)
        if entry.id == LEVEL:
            check(1 <= entry.block <= len(level_counts(header)), f"{name}: there is no such level")
            blocks = entry.block + 1
        if entry.id in (KEY_FRAME, MOTION):
            blocks = 1 << 24
        check(entry.block < blocks, f"{name}: there is no such block")
        seen.add((entry.id, entry.block))
    ids = [entry.id for entry in header.sections]
    first = [number for number in FIRST if number in ids]
    check(ids[: len(first)] == first, "sections: out of order")


def check_presence(header, sections, of_scene, of_blocks):
    """Check that exactly these sections are present, besides comments and extra."""
    if header.count:
        check((INDEX, 0) in sections, "section index is missing")
        size, expected = len(sections[INDEX, 0]), 48 * header.blocks
        check(size == expected, f"index: {size} bytes, expected {expected}")
        of_scene = of_scene | {INDEX}
    expected = {(number, 0) for number in of_scene}
    expected |= {(number, block) for number in of_blocks for block in range(header.blocks)}
    free = (COMMENTS, EXTRA, LEVEL, FAR_CENTRES, BASIS)
    for name, section, feature in (("far", FAR_CENTRES, FAR), ("basis", BASIS, LOCAL_BASIS)):
        found = any(number == section for number, _ in sections)
        check(found == bool(header.features & feature), f"{name}: feature or sections are missing")
    found = {key for key in sections if key[0] in KNOWN and key[0] not in free}
    check(found == expected, f"sections: (id, block) {sorted(found ^ expected)[:3]}")


def check_size(header, size, extra):
    """Reject files that a decoder may reject according to section "Limits"."""
    floats = 4 * header.count * (11 + 3 * (header.sh_degree + 1) ** 2)
    large = floats + extra > 1 << 30 and floats + extra > 1000 * size
    check(not large, "limits: the scene is too large for the file's size")


# Section "Index"


def check_index(content, values, header):
    reader = Reader(content, "index")
    for block in range(header.blocks):
        box = reader.numbers("12f")
        check(finite(*box), f"index: block {block}: not finite")
        inner, outer = (box[:3], box[3:6]), (box[6:9], box[9:])
        for lows, highs in ((outer[0], inner[0]), inner, (inner[1], outer[1])):
            inside = all(low <= high for low, high in zip(lows, highs, strict=False))
            check(inside, f"index: block {block}: boxes")
        first = block * header.block_size
        rows = [values[name][first : first + header.block_size].tolist() for name in "xyz"]
        spans = [span_of(row) for row in rows]
        exact = struct.pack("<6f", *(span[0] for span in spans), *(span[1] for span in spans))
        check(struct.pack("<6f", *box[:6]) == exact, f"index: block {block}: box of centres")
    reader.finish()


def span_of(row):
    """Minimum and maximum of the finite numbers; a zero is 0, not -0."""
    numbers = [number for number in row if math.isfinite(number)] or [0.0]
    return min(numbers) + 0.0, max(numbers) + 0.0


# Section "Comments and extra"


def read_comments(content):
    check(len(content) <= 1 << 20, "comments: above 2^20 bytes")
    printable = all(32 <= byte <= 126 or byte in b"\t\n" for byte in content)
    check(printable, "comments: other than printable ASCII and tabs")
    lines = content.decode("ascii").split("\n")
    for line in lines:
        check(not of_header(line), f"comments: belongs in the header: {line!r}")
    return lines


def of_header(line):
    """Whether a line states the coordinate system or antialiasing."""
    text = line.strip(" \t").upper()
    found = re.fullmatch(r"COORDINATESYSTEM:[ \t]*([RLUDBF]{3})", text)
    if found:
        return is_system(found[1])
    mode = r"SPLATRENDERMODE:[ \t]*[A-Z0-9_]+|ANTIALIASED[ \t]+[A-Z0-9_]+"
    return re.fullmatch(mode, text) is not None


def read_extra(content, header, file_size):
    """Properties beyond the layout, by name."""
    reader = Reader(content, "extra")
    number = reader.u16()
    check(number > 0, "extra: no properties")
    found, entries = {}, []
    for _ in range(number):
        name = reader.take(reader.u8())
        check(name and all(33 <= byte <= 126 for byte in name), f"extra: name {name!r}")
        name = name.decode("ascii")
        check(not LAYOUT.fullmatch(name), f"extra: {name!r} is a name of the layout")
        check(name not in found, f"extra: {name!r} occurs twice")
        kind = reader.u8()
        check(kind < len(TYPES), f"extra: {name!r}: type {kind}")
        size = reader.u64()
        entries.append((name, numpy.dtype(TYPES[kind]), reader.take(size)))
        found[name] = None
    reader.finish()
    check_size(header, file_size, sum(kind.itemsize for _, kind, _ in entries) * header.count)
    for name, kind, coded in entries:
        found[name] = read_property(coded, kind, header.count, name)
    return found


def read_property(coded, kind, count, name):
    size = count * kind.itemsize
    inflater = zlib.decompressobj()
    try:
        planes = inflater.decompress(coded, size + 1)
    except zlib.error as error:
        raise ValueError(f"extra: {name!r}: {error}") from error
    check(len(planes) == size, f"extra: {name!r}: {len(planes)} bytes, expected {size}")
    check(inflater.eof, f"extra: {name!r}: the zlib stream is not complete")
    check(not inflater.unused_data, f"extra: {name!r}: bytes after the zlib stream")
    rows = numpy.frombuffer(planes, "u1").reshape(kind.itemsize, count).T
    return numpy.ascontiguousarray(rows).view(kind).reshape(count)


# Whole files


def decode(data):
    """Decode a file; raises ValueError if it is invalid.

    `values` has the floats of each property in stream order, `symbols` (profiles 0-2 only) the
    symbols of each varying channel, `extra` the properties beyond the layout.
    """
    return decode_file(data) | {"levels": decode_levels(data)}


def decode_file(data, level=False):
    """Decode a file without its levels, or a level."""
    header, sections = read_file(data)
    check(((ERRORS, 0) in sections) == level, "section errors: there, or missing")
    if level:
        check(not {(COMMENTS, 0), (EXTRA, 0)} & set(sections), "level: comments or extra")
    check(not header.features & G_PCC, "G-PCC: this decoder does not read it")
    check(not header.features & SEQUENCE, "a sequence, expected a scene")
    check_size(header, len(data), 0)
    extra = {}
    if (EXTRA, 0) in sections:
        extra = read_extra(sections[EXTRA, 0], header, len(data))
    comments = read_comments(sections[COMMENTS, 0]) if (COMMENTS, 0) in sections else []
    symbols, values = decode_scene(header, sections)
    if header.count:
        check_index(sections[INDEX, 0], values, header)
    return {
        "count": header.count,
        "sh_degree": header.sh_degree,
        "has_normals": header.has_normals,
        "antialiased": header.antialiased,
        "coordinates": header.coordinates,
        "comments": comments,
        "extra": extra,
        "symbols": symbols,
        "values": values,
    }


# Section "Levels"


def level_counts(header):
    """Number of Gaussians of level 1, 2, ..."""
    counts, count = [], header.count
    while count > header.block_size:
        count = -(-count // 4)
        counts.append(count)
    return counts


def decode_levels(data):
    """The decoded levels, each with `errors` and `boxes`, the second box of each block."""
    header, sections = read_file(data)
    numbers = sorted(block for section, block in sections if section == LEVEL)
    check(not numbers or 3 <= header.profile <= 5, "level: of another profile")
    counts = level_counts(header)
    check(numbers in ([], list(range(1, len(counts) + 1))), "level: not all are there")
    found, before = [], [0.0] * header.blocks
    for number in numbers:
        content = sections[LEVEL, number]
        own, parts = read_file(content)
        check(not any(section == LEVEL for section, _ in parts), "level: has levels")
        same = ("antialiased", "coordinates", "profile", "sh_degree", "block_size")
        for name in same:
            check(getattr(own, name) == getattr(header, name), f"level {number}: {name}")
        check(not own.features & ~header.features, f"level {number}: features")
        check(own.count == counts[number - 1], f"level {number}: {own.count} Gaussians")
        check(not own.has_normals and not own.kept_order, f"level {number}: flags")
        decoded = decode_file(content, level=True)
        reader = Reader(parts[ERRORS, 0], "errors")
        errors = list(reader.numbers(f"{own.blocks}f"))
        reader.finish()
        for block, error in enumerate(errors):
            least = max(before[4 * block : 4 * block + 4])
            check(finite(error) and error >= least >= 0, f"errors of level {number}")
        before = errors
        found.append(decoded | {"errors": errors, "boxes": boxes_of(parts[INDEX, 0])})
    return found


def boxes_of(index):
    """The second box of each block."""
    return [row[6:] for row in struct.iter_unpack("<12f", index)]


# Section "Selection"


def select(data, view, tolerance, budget=None):
    """Blocks (level, number) that a view needs; `view` has the fields of a camera."""
    header, sections = read_file(data)
    levels = decode_levels(data)
    boxes = [boxes_of(sections[INDEX, 0]), *(level["boxes"] for level in levels)]
    errors = [[0.0] * header.blocks, *(level["errors"] for level in levels)]
    counts = [header.count, *(level["count"] for level in levels)]

    def gaussians(chosen):
        size = header.block_size
        return sum(min(size, counts[k] - j * size) for k, j in chosen)

    def distance(k, j):
        box = boxes[k][j]
        a, b, c = (
            max(low - p, p - high, 0.0)
            for low, high, p in zip(box[:3], box[3:], view.position, strict=True)
        )
        return math.sqrt((a * a + b * b) + c * c)

    def screen_error(k, j):
        if errors[k][j] == 0:
            return 0.0
        d = distance(k, j)
        return errors[k][j] * max(view.fx, view.fy) / d if d else math.inf

    def seen(k, j):
        return in_view(boxes[k][j], view)

    top = len(levels)
    chosen = [(top, j) for j in range(len(boxes[top])) if seen(top, j)]
    if budget is not None and gaussians(chosen) > budget:
        ordered, chosen = sorted(chosen, key=lambda block: (distance(*block), block[1])), []
        for block in ordered:
            if gaussians([*chosen, block]) > budget:
                break
            chosen.append(block)
        return sorted(chosen)
    while chosen:
        worst = max(chosen, key=lambda block: (screen_error(*block), block[0], -block[1]))
        if screen_error(*worst) <= tolerance:
            break
        k, j = worst
        below = range(4 * j, min(4 * j + 4, len(boxes[k - 1])))
        changed = [block for block in chosen if block != worst]
        changed += [(k - 1, child) for child in below if seen(k - 1, child)]
        if budget is not None and gaussians(changed) > budget:
            break
        chosen = changed
    return sorted(chosen)


def in_view(box, view):
    """Whether no edge of a view has all eight corners of a box on its outer side."""
    beyond = [True] * 5
    for number in range(8):
        q = [box[3 * (number >> axis & 1) + axis] - view.position[axis] for axis in range(3)]
        x, y, z = ((r[0] * q[0] + r[1] * q[1]) + r[2] * q[2] for r in view.rotation.tolist())
        outside = (
            z <= 0,
            view.fx * x + view.cx * z < 0,
            view.fx * x + (view.cx - view.width) * z > 0,
            view.fy * y + view.cy * z < 0,
            view.fy * y + (view.cy - view.height) * z > 0,
        )
        beyond = [a and b for a, b in zip(beyond, outside, strict=True)]
    return not any(beyond)


def decode_scene(header, sections):
    """Symbols and values of all Gaussians, by name."""
    if header.profile <= 2:
        return decode_channels(header, sections)
    if header.profile != LOSSLESS:
        lattice, found = lattice_blocks(header, sections)
        floats = [reference_lattice.floats_of(lattice, block) for block in found]
        return {}, joined(floats, header.sh_degree)
    expected = reference_lossless.expected_sections(header.sh_degree)
    check_presence(header, sections, set(), expected)
    blocks = [
        reference_lossless.decode_block(
            sections_of(sections, b), header.block_count(b), header.sh_degree
        )
        for b in range(header.blocks)
    ]
    return {}, joined(blocks, header.sh_degree)


def lattice_blocks(header, sections):
    """Lattice and blocks of a file of profiles 3-5."""
    expected = reference_lattice.expected_sections(header.sh_degree)
    own = {ERRORS} if (ERRORS, 0) in sections else set()
    check_presence(header, sections, {LATTICE} | own, expected)
    lattice = reference_lattice.read_lattice(sections[LATTICE, 0], header.sh_degree)
    far = header.features & FAR
    check(not far or sum(lattice.bits) <= 62, "lattice: too many bits with far Gaussians")
    in_basis = header.features & LOCAL_BASIS
    check(not in_basis or len(set(lattice.units[4:])) == 1, "lattice: units with a local basis")
    return lattice, [
        reference_lattice.decode_block(
            lattice, sections_of(sections, b), header.block_count(b), header.sh_degree
        )
        for b in range(header.blocks)
    ]


def sections_of(sections, block):
    """Sections of a block, by id."""
    return {
        number: data for (number, b), data in sections.items() if b == block and number not in SCENE
    }


def names_of(sh_degree):
    return [channel.name for channel in reference_channels.channels_of(sh_degree)]


def joined(blocks, sh_degree):
    empty = [numpy.zeros(0, "<f4")]
    return {
        name: numpy.concatenate([block[name] for block in blocks] or empty)
        for name in names_of(sh_degree)
    }


def decode_channels(header, sections):
    """Symbols and values of a file of profiles 0-2."""
    check((CHANNELS, 0) in sections, "section channels is missing")
    channels = reference_channels.read_channels(sections[CHANNELS, 0], header.sh_degree)
    torchac = bool(header.features & TORCHAC)
    expected = reference_channels.expected_sections(channels, torchac)
    check_presence(header, sections, {CHANNELS, CODER} if torchac else {CHANNELS}, expected)
    if torchac:
        check(expected & set(reference_channels.CODED), "coder: all channels are constant")
        check_line(sections[CODER, 0], "coder")
    symbols = {channel.name: [] for channel in channels if channel.varies}
    for b in range(header.blocks):
        found = reference_channels.decode_block(
            channels, sections_of(sections, b), header.block_count(b), torchac
        )
        for name, plane in found.items():
            symbols[name] += plane
    values = {channel.name: channel_values(channel, symbols, header) for channel in channels}
    return symbols, values


def channel_values(channel, symbols, header):
    if channel.varies:
        return channel.values(symbols[channel.name])
    return numpy.full(header.count, channel.first, "<f4")


def check_line(content, name):
    inside = all(32 <= byte <= 126 for byte in content)
    check(1 <= len(content) <= 200 and inside, f"{name}: not a line of 1-200 bytes")

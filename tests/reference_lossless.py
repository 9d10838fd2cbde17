"""Profile 6 of the reference decoder (section "Lossless").

Written only from FORMAT.md; shares no code with the codec, and favours clarity over speed.
"""

import math
import struct

import numpy
from pcodec.wrapped import FileDecompressor
from reference_tools import Reader, check

GEOMETRY, SH_DC, OPACITY, SCALING, ROTATION, SH_1, SH_2, SH_3 = 2, 3, 5, 6, 7, 8, 9, 10
BANDS = ((SH_1, range(3)), (SH_2, range(3, 8)), (SH_3, range(8, 15)))
MIDDLE = 1 << 31
WHOLE = 1 << 32


def pattern_of(ordered):
    """Bit pattern of an ordered integer."""
    return ordered - MIDDLE if ordered >= MIDDLE else WHOLE - 1 - ordered


def ordered_of(pattern):
    return WHOLE - 1 - pattern if pattern >= MIDDLE else pattern + MIDDLE


def floats_of(patterns):
    return numpy.array(patterns, "<u4").view("<f4")


# Section "Columns"


def read_column(data, count):
    """The `count` integers of a pcodec stream."""
    if count == 0:
        check(data == b"", "column: bytes of a column of no integers")
        return []
    check(len(data) >= 3 and data[0] == 4, "column: not of pcodec's version 4")
    result = numpy.zeros(count, numpy.uint32)
    try:
        size = read_pcodec(data, result)
    except ValueError:
        raise
    except BaseException as error:  # pcodec's panics are not Exceptions
        if isinstance(error, (KeyboardInterrupt, SystemExit)):
            raise
        raise ValueError(f"column: {error}") from error
    check(size == len(data), "column: bytes after the page")
    return result.tolist()


def read_pcodec(data, result):
    """Fill an array from a pcodec stream; return the bytes read."""
    file, at = FileDecompressor.new(data)
    check(at < len(data), "column: truncated")
    check(data[at] & 15 == 0, "column: mode is not classic")
    check(data[at] >> 4 in (0, 1), "column: delta encoding is neither none nor consecutive")
    chunk, size = file.chunk_decompressor(data[at:], "u32")
    at += size
    progress, size = chunk.read_page_into(data[at:], len(result), result)
    check(progress.finished and progress.n_processed == len(result), "column: page too short")
    return at + size


def read_columns(reader, counts):
    """Columns with these numbers of integers, stored together."""
    sizes = [reader.u32() for _ in counts]
    return [
        read_column(reader.take(size), count) for size, count in zip(sizes, counts, strict=False)
    ]


def read_stack(reader, columns, count):
    """Bit patterns of `columns` properties."""
    found = read_columns(reader, [count] * columns)
    return [[pattern_of(ordered) for ordered in column] for column in found]


def class_of(guide):
    exponent = (guide >> 23) % 256
    return min(max(exponent, 116), 131) - 116 + 16 * (guide >> 31)


def read_guided_stack(reader, guides):
    """Bit patterns of as many properties as guides."""
    classes = [[class_of(guide) for guide in column] for column in guides]
    counts = [sum(column.count(k) for column in classes) for k in range(32)]
    parts = [iter(column) for column in read_columns(reader, counts)]
    return [[pattern_of(next(parts[k])) for k in column] for column in classes]


def read_quaternions(reader, count):
    kind = reader.u8()
    check(kind <= 1, f"rotation: kind {kind}")
    first, *others = read_columns(reader, [count] * 4)
    others = [[pattern_of(ordered) for ordered in column] for column in others]
    if kind == 1:
        guesses = [guess_w(*floats) for floats in zip(*map(binary64, others), strict=False)]
        first = [
            (value + guess - MIDDLE) % WHOLE for value, guess in zip(first, guesses, strict=False)
        ]
    return [[pattern_of(ordered) for ordered in first], *others]


def binary64(patterns):
    size = len(patterns)
    return struct.unpack(f"<{size}f", struct.pack(f"<{size}I", *patterns))


def guess_w(x, y, z):
    """Ordered integer of the w that makes a unit quaternion."""
    rest = ((1 - x * x) - y * y) - z * z
    root = math.sqrt(rest) if rest > 0 else 0.0
    return ordered_of(int(numpy.float32(root).view(numpy.uint32)))


# Section "Sections of a block"


def read_triple(reader, coefficients, present):
    """Bit patterns of R, G, B; `present` marks by colour which Gaussians have it."""
    red, green, blue = present
    greens = spread(read_stack(reader, coefficients, sum(green)), green)
    found = [None, greens, None]
    for colour, having in ((0, red), (2, blue)):
        guides = [[g for g, here in zip(column, having, strict=False) if here] for column in greens]
        found[colour] = spread(read_guided_stack(reader, guides), having)
    return found


def spread(columns, present):
    """Columns of the present Gaussians, with 0 for the others."""
    result = []
    for column in columns:
        values = iter(column)
        result.append([next(values) if here else 0 for here in present])
    return result


def read_mask(reader, count):
    """Mask, by colour, of the Gaussians with SH-AC."""
    (masks,) = read_columns(reader, [count])
    check(all(mask <= 7 for mask in masks), "sh1: a mask above 7")
    return [[bool(mask >> colour & 1) for mask in masks] for colour in range(3)]


def expected_sections(sh_degree):
    """Ids of the sections that each block has (table of sections)."""
    return {GEOMETRY, SH_DC, OPACITY, SCALING, ROTATION, *(SH_1, SH_2, SH_3)[:sh_degree]}


def decode_block(sections, count, sh_degree):
    """Floats of a block, by name."""
    found = read_plain(sections[GEOMETRY], "xyz", count)
    found.update(read_plain(sections[OPACITY], ["opacity"], count))
    found.update(read_plain(sections[SCALING], [f"scale_{k}" for k in range(3)], count))
    reader = Reader(sections[ROTATION], "rotation")
    for k, column in enumerate(read_quaternions(reader, count)):
        found[f"rot_{k}"] = column
    reader.finish()
    reader = Reader(sections[SH_DC], "sh-dc")
    for c, (column,) in enumerate(read_triple(reader, 1, [[True] * count] * 3)):
        found[f"f_dc_{c}"] = column
    reader.finish()
    found.update(read_bands(sections, count, sh_degree))
    return {name: floats_of(patterns) for name, patterns in found.items()}


def read_plain(content, names, count):
    """Bit patterns of a section that is a stack, by name."""
    reader = Reader(content, names[0])
    found = dict(zip(names, read_stack(reader, len(names), count), strict=False))
    reader.finish()
    return found


def read_bands(sections, count, sh_degree):
    """Bit patterns of f_rest, by name."""
    found, present = {}, None
    coefficients = (sh_degree + 1) ** 2 - 1
    for section, band in BANDS[:sh_degree]:
        reader = Reader(sections[section], f"section {section}")
        present = present or read_mask(reader, count)
        for colour, columns in enumerate(read_triple(reader, len(band), present)):
            for i, column in zip(band, columns, strict=False):
                found[f"f_rest_{colour * coefficients + i}"] = column
        reader.finish()
    return found

"""Passes: symbols with their own tables, contexts from earlier symbols, and damaged passes."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import made_up_guide, random_scene

from gs_codec.codecs.adaptive.arrange import arrange_scene
from gs_codec.codecs.adaptive.blocks import PassData
from gs_codec.codecs.adaptive.colour import code_colours, read_colours
from gs_codec.codecs.adaptive.contexts import (
    COLOUR_SHIFTS,
    MEMBERS,
    SHAPE_OFFSETS,
    SHAPE_PASS,
    SIGNS,
    SUMS,
    before_bucket,
    passes,
    sum_bucket,
)
from gs_codec.codecs.adaptive.lattice import FRACTION_BITS
from gs_codec.codecs.adaptive.sh_ac import code_bands, read_bands, two_nearest
from gs_codec.codecs.adaptive.shape import ShapeQuantiser, read_shapes, shape_pass, walk_shape
from gs_codec.codecs.adaptive.tokens import ALPHABET, MAX_BITS, read_token
from gs_codec.coding.axes import sort_axes
from gs_codec.coding.context_rans import (
    MORE_BITS,
    OUT_OF_WORDS,
    PRECISION,
    RUN_BITS,
    SPAN_BITS,
    CodedPass,
    PassReader,
    PassTables,
    encode_passes,
)
from gs_codec.coding.frequency_table import normalise
from gs_codec.coding.nearest import find_all_nearest
from gs_codec.coding.rans import LANES
from gs_codec.config import Config
from gs_codec.errors import CorruptStream, TruncatedStream
from gs_codec.runtime.kernels import kernel
from gs_codec.scene import sh_bands

ONE = 1 << FRACTION_BITS

EDGES = sorted(
    {0, 1, 15, 16, 17, 2**MAX_BITS - 1}
    | {2**k + d for k in range(1, MAX_BITS) for d in (-1, 0, 1)}
    | {(4 + j << k) + d for k in range(2, MAX_BITS - 2) for j in range(4) for d in (-1, 0)}
)
SIGNED = np.array([sign * size for size in EDGES for sign in (1, -1)], np.int64)


NAMES = ("a", "b", "c")


@kernel
def _read_listed(
    words, ends, states, spans, slots, rows, bits, reached, contexts, cycle, rarely, values
):  # fmt: skip
    """A pass whose contexts are known in advance."""
    for i in range(len(values)):
        stream = cycle[i % len(cycle)]
        if reached[0, stream] > ends[stream] or reached[1, stream] > 8 * (len(bits) - MORE_BITS):
            return OUT_OF_WORDS
        values[i], reached[0, stream], reached[1, stream] = read_token(
            words, reached[0, stream], states, i, spans, slots, rows[contexts[i]],
            bits, reached[1, stream], rarely,
        )  # fmt: skip
    return 0


def tables_of(*weights: np.ndarray) -> PassTables:
    return PassTables.pack([normalise(row.astype(np.int64), PRECISION) for row in weights])


#: Tables of all tokens: uniform, and favouring small or large ones.
ANY = tables_of(np.ones(ALPHABET), np.arange(ALPHABET)[::-1] + 1, np.arange(ALPHABET) + 1)


def made_pass(values, contexts=None, rows=None, streams=1) -> CodedPass:
    """A pass whose symbols alternate between streams; uses the first table by default."""
    contexts = np.zeros(len(values), np.uint16) if contexts is None else contexts
    rows = np.zeros(1, np.int64) if rows is None else rows
    data = PassData.of(values, contexts)
    return CodedPass(NAMES[:streams], np.arange(streams), rows, *vars(data).values())


def read_pass(reader: PassReader, sections, made: CodedPass, rarely: bool = False) -> np.ndarray:
    values = np.empty(len(made.tokens), np.int64)
    arguments = (made.contexts, made.cycle, rarely, values)
    data = [memoryview(sections[name]) for name in made.streams]
    reader.decode(data, _read_listed, made.rows, *arguments)
    return values


def reader_of(states: bytes, tables: PassTables = ANY) -> PassReader:
    return PassReader(memoryview(states), tables, "test")


def round_trip(values: np.ndarray, streams: int = 1, rarely: bool = False) -> np.ndarray:
    made = made_pass(values, streams=streams)
    states, sections = encode_passes([made], ANY)
    assert len(states) == 4 * LANES
    assert list(sections) == list(made.streams)
    reader = reader_of(states)
    decoded = read_pass(reader, sections, made, rarely)
    reader.finish()
    return decoded


@pytest.mark.parametrize("rarely", [False, True])
@pytest.mark.parametrize("streams", [1, 2, 3])
def test_tokens_round_trip_at_every_border(streams, rarely):
    np.testing.assert_array_equal(round_trip(SIGNED, streams, rarely), SIGNED)


@pytest.mark.parametrize("seed", range(3))
def test_tokens_round_trip_seed(seed):
    rng = np.random.default_rng(seed)
    values = (2 ** rng.uniform(0, MAX_BITS, 5000)).astype(np.int64) * rng.choice([-1, 1], 5000)
    np.testing.assert_array_equal(round_trip(values, 1 + seed), values)


def test_token_1_is_also_zero():
    made = made_pass(np.zeros(3, np.int64))
    made.tokens[:] = 1
    states, sections = encode_passes([made], ANY)
    assert read_pass(reader_of(states), sections, made).tolist() == [0, 0, 0]


def random_passes(seed: int, sizes: list[int]) -> tuple[PassTables, list[CodedPass]]:
    """Passes of tokens without raw bits; each symbol has its own table."""
    rng = np.random.default_rng(seed)
    weights = []
    for _ in range(50):
        row = rng.integers(0, 1000, rng.integers(1, 33))
        row *= rng.integers(0, 2, row.size)
        row[rng.integers(row.size)] = 1 + rng.integers(1000)
        weights.append(row)
    tables, made = tables_of(*weights), []
    none = np.zeros(0, np.int64)
    for i, size in enumerate(sizes):
        rows = rng.integers(0, 50, size).astype(np.uint16)
        runs = rng.integers(0, 1 << (PRECISION - RUN_BITS), size)
        tokens = tables.slots.reshape(-1, 1 << (PRECISION - RUN_BITS))[rows, runs]
        made.append(
            CodedPass(
                (f"s{i}",), np.zeros(1, np.int64), np.arange(50), tokens, rows, none, none, none
            )
        )
    return tables, made


def decode_all(tables, made, states, sections) -> list[np.ndarray]:
    reader = reader_of(states, tables)
    decoded = [read_pass(reader, sections, one) for one in made]
    reader.finish()
    return decoded


@pytest.mark.parametrize(
    "sizes", [[0], [1], [31], [33, 0, 5], [1000] * 9, [0, 0, 700, 1, 0, 0]], ids=str
)
def test_passes_round_trip_seed5(sizes):
    tables, made = random_passes(5, sizes)
    states, sections = encode_passes(made, tables)
    for one, decoded in zip(made, decode_all(tables, made, states, sections), strict=True):
        size = one.tokens.astype(np.int64) >> 1
        np.testing.assert_array_equal(decoded, np.where(one.tokens & 1, -size, size))


def test_passes_cost_about_their_entropy_seed6():
    tables, [made] = random_passes(6, [20_000])
    places = (made.contexts.astype(np.int64) << SPAN_BITS) + made.tokens
    bits = np.sum(PRECISION - np.log2((tables.spans[places] & 0xFFFF).astype(float)))
    states, sections = encode_passes([made], tables)
    assert 8 * (len(sections["s0"]) + len(states)) < 1.001 * bits + 32 * LANES


DAMAGE = {
    "word": lambda data: data[:50] + bytes([data[50] ^ 4]) + data[51:],
    "words that are not there": lambda data: bytes([data[0] + 2]) + data[1:],
    "too few words": lambda data: bytes([data[0] - 2]) + data[1:],
    "an odd number": lambda data: bytes([data[0] - 1]) + data[1:],
    "cut": lambda data: data[:-1],
    "raw bits": lambda data: data + b"\0",
    "no size": lambda data: data[:3],
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_sections_are_refused_seed7(damage):
    tables, made = random_passes(7, [500, 300, 200])
    states, sections = encode_passes(made, tables)
    sections["s1"] = DAMAGE[damage](sections["s1"])
    with pytest.raises((CorruptStream, TruncatedStream), match="test"):
        decode_all(tables, made, states, sections)


@pytest.mark.parametrize("damage", ["state", "low state", "states"])
def test_damaged_states_are_refused_seed7(damage):
    tables, made = random_passes(7, [500, 300, 200])
    states, sections = encode_passes(made, tables)
    states = {
        "state": bytes([states[0] ^ 1]) + states[1:],
        "low state": b"\xff\xff\0\0" + states[4:],
        "states": states[:-4],
    }[damage]
    with pytest.raises(CorruptStream, match="test: "):
        decode_all(tables, made, states, sections)


def test_raw_bits_too_few_too_many_or_not_padded_are_refused():
    made = made_pass(np.array([1000, -77, 5, 123456]))
    assert made.raw_widths.sum() % 8 != 0
    states, sections = encode_passes([made], ANY)
    data = sections["a"]
    for bad in (data[:-1], data[:-4], data + b"\0", data[:-1] + bytes([data[-1] | 1])):
        with pytest.raises(CorruptStream, match="test: "):
            read_pass(reader_of(states), {"a": bad}, made)


# Passes of a scene


@pytest.mark.parametrize(("coefficients", "lists"), [(0, 0), (3, 4), (8, 8), (15, 12)])
def test_lists_of_passes(coefficients, lists):
    listed = passes(coefficients)
    names = [item.name for one in listed for item in one.lists]
    assert len(set(names)) == len(names) == 10 + lists
    streams = [stream for one in listed for stream in one.streams]
    assert len(set(streams)) == len(streams), "a stream is read by one pass"
    assert sum(name.startswith("SH sum") for name in names) == len(sh_bands(coefficients))


def test_symbols_of_the_shape_pass_alternate():
    assert SHAPE_PASS.streams == ["classes", "opacity", "scaling", "rotation"]
    assert SHAPE_PASS.cycle.tolist() == [0, 0, 1, 2, 2, 2, 3, 3, 3]
    assert SHAPE_OFFSETS[-1] == sum(item.contexts for item in SHAPE_PASS.lists)


def test_sums_have_a_context_for_each_half_octave():
    expected = [0, 1, 2, 3, 4, 4, 5, 5, 6, 6, 6, 6, 7, 7, 7, 7, 8]
    assert [sum_bucket(n) for n in range(17)] == expected
    assert [sum_bucket(n) for n in (95, 96, 127, 128, 191, 192, 1 << 30)] == [
        12, 13, 13, 14, 14, 15, 15,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("attribute", "total", "bucket"),
    [
        (0, 0, 4), (0, -1, 3), (0, 2 * ONE - 1, 4), (0, 2 * ONE, 5), (0, 99 * ONE, 7),
        (0, -99 * ONE, 0), (1, ONE, 5), (1, -ONE, 3), (2, -1, 0), (2, 3 * ONE, 3), (3, 9 * ONE, 7),
    ],
)  # fmt: skip
def test_contexts_depend_on_earlier_symbols(attribute, total, bucket):
    assert before_bucket(attribute, total) == bucket


@pytest.mark.parametrize("count", [0, 1, 2, 3, 1000])
def test_shapes_round_trip_seed15(count):
    scene = random_scene(count, 0, seed=15)
    config = Config("m", {})
    arranged = arrange_scene(scene, config, made_up_guide()(scene, config) if count else None)
    ordered, lattice = arranged.source.take(arranged.order), arranged.lattice
    _, scales, vectors = sort_axes(ordered.log_scale, ordered.rot)
    quantiser = ShapeQuantiser(lattice, ordered.opacity[0], scales, vectors)
    shape = walk_shape(lattice, arranged.classes[0], quantiser)
    coded, contexts = shape_pass(
        arranged.classes, quantiser.levels, quantiser.shifts, lattice.units
    )
    rng = np.random.default_rng(15)
    rows = rng.integers(0, 3, SHAPE_OFFSETS[-1], np.uint16)
    data = PassData.of(coded, contexts)
    made = CodedPass(SHAPE_PASS.streams, SHAPE_PASS.cycle, rows, *vars(data).values())
    states, sections = encode_passes([made], ANY)
    reader = reader_of(states)
    data = [memoryview(sections[name]) for name in made.streams]
    classes, decoded = read_shapes(reader, data, rows, lattice, count)
    reader.finish()
    np.testing.assert_array_equal(classes, arranged.classes)
    for name, plane in vars(shape).items():
        np.testing.assert_array_equal(getattr(decoded, name), plane, err_msg=name)


def ac_levels(rng: np.random.Generator, coefficients: int, count: int) -> np.ndarray:
    """Levels of SH-AC, mostly small, and all 0 for some Gaussians."""
    levels = rng.laplace(0, 1.5, (3, coefficients, count)) * rng.integers(0, 3, count)
    levels[:, :, ::17] *= 100
    return levels.astype(np.int32)


@pytest.mark.parametrize("coefficients", [0, 3, 8, 15])
@pytest.mark.parametrize("count", [0, 1, 2, 3, 1000])
def test_sh_round_trip_seed16(coefficients, count):
    rng = np.random.default_rng(16)
    levels, shifts = ac_levels(rng, coefficients, count), rng.integers(0, 20, count)
    near = two_nearest(find_all_nearest(rng.integers(0, 50, (3, count))))
    listed, made, rows = passes(coefficients)[2:], [], []
    for one, (values, contexts, owners) in zip(
        listed, code_bands(levels, near, shifts), strict=True
    ):
        assert not len(owners)
        rows.append(rng.integers(0, 3, sum(item.contexts for item in one.lists), np.uint16))
        data = PassData.of(values, contexts)
        made.append(CodedPass(one.streams, one.cycle, rows[-1], *vars(data).values()))
    states, sections = encode_passes(made, ANY)
    data = [memoryview(section) for section in sections.values()]
    for bands in range(len(made) + 1):
        kept = [0, 3, 8, 15][bands]
        decoded, reader = np.zeros((3, kept, count), np.int32), reader_of(states)
        read_bands(reader, data, rows, decoded, near, shifts)
        np.testing.assert_array_equal(decoded, levels[:, :kept])
    reader.finish()


def test_sh_has_symbols_until_the_sum_is_used_up():
    levels = np.zeros((3, 15, 4), np.int32)
    levels[0, 1, 1], levels[2, 2, 1] = -3, 2
    levels[1, 5, 2] = 7
    near = two_nearest(find_all_nearest(np.zeros((3, 4), np.int64)))
    first, second, third = code_bands(levels, near, np.zeros(4, np.int64), owned=True)
    # Sums, the first band's share of two, and its coefficients up to the last, which is a sign.
    assert first[0].tolist() == [0, 5, 7, 0, 5, 0, 0, -3, 0, 0, 0, 0, 0, 0, 1]
    assert np.bincount(first[2]).tolist() == [1, 11, 2, 1]
    assert second[0].tolist() == [7, *[0] * 7, 7]
    assert second[2].tolist() == [2] * 9
    assert third[0].size == 0


def test_levels_are_mirrored_where_neighbours_are_negative():
    near = two_nearest(find_all_nearest(np.zeros((3, 3), np.int64)))
    assert near.tolist() == [[0, 0], [1, 0], [1, 2]]
    for sign in (1, -1):
        levels = np.zeros((3, 3, 3), np.int32)
        levels[0, 0] = sign * np.array([1, 2, 5])
        [(values, contexts, _)] = code_bands(levels, near, np.zeros(3, np.int64))
        assert values.tolist() == [1, 2, 5, sign, 2, 5]
        of_luma = contexts[3:] - COLOUR_SHIFTS * SUMS
        assert of_luma.tolist() == [
            SIGNS * MEMBERS * 1,
            MEMBERS * (3 * 2 + 1),
            MEMBERS * (3 * 4 + 2),
        ]


@pytest.mark.parametrize(
    "values", [[-1], [3, 4, 1], [2, 3], [1, *[0] * 8], [5, *[0] * 8, 2], [5, *[0] * 8, 0]], ids=str
)
def test_levels_beyond_their_sum_are_refused(values):
    # Degree 1: the sum, then Y, Co, Cg of three coefficients; the last is a sign.
    made = made_pass(np.array(values + [0] * (10 - len(values))))
    states, sections = encode_passes([made], ANY)
    near = two_nearest(find_all_nearest(np.zeros((3, 1), np.int64)))
    rows, levels = [np.zeros(2000, np.int64)], np.zeros((3, 3, 1), np.int32)
    with pytest.raises(CorruptStream, match=r"a level of SH-AC beyond its sum|words are left"):
        read_bands(
            reader_of(states),
            [memoryview(sections["a"])],
            rows,
            levels,
            near,
            np.zeros(1, np.int64),
        )


@pytest.mark.parametrize("count", [0, 1, 5, 700])
def test_colours_round_trip_seed11(count):
    rng = np.random.default_rng(11)
    places = np.sort(rng.integers(0, 2**12, (3, count)), axis=1)
    colours = rng.integers(-2 * ONE, 2 * ONE, (3, count))
    shifts = rng.integers(0, 18, count)
    levels, contexts, values = code_colours(find_all_nearest(places), colours, 300, shifts)
    assert np.all(2 * np.abs(values - colours) <= 300 << shifts)
    assert contexts.size == 0 or 0 <= contexts.min() <= contexts.max() < 288
    rows = rng.integers(0, 3, 288, np.uint16)
    states, sections = encode_passes([made_pass(levels.ravel(), contexts.ravel(), rows)], ANY)
    reader = reader_of(states)
    data = [memoryview(sections["a"])]
    found = read_colours(reader, data, rows, find_all_nearest(places), 300, shifts)
    np.testing.assert_array_equal(found, values)
    reader.finish()


@pytest.mark.parametrize("sign", [1, -1])
def test_colours_out_of_range_are_refused(sign):
    made = made_pass(np.full(300, sign * (2**MAX_BITS - 1)))
    states, sections = encode_passes([made], ANY)
    nearest, shifts = find_all_nearest(np.ones((3, 100), np.int64)), np.full(100, 31)
    with pytest.raises(CorruptStream, match="a value out of range"):
        read_colours(
            reader_of(states), [memoryview(sections["a"])], np.zeros(288, np.uint16),
            nearest, 1, shifts,
        )  # fmt: skip


@pytest.mark.parametrize("weights", ["no raw bits", "raw bits"])
def test_symbols_are_not_read_beyond_their_words(weights):
    # The first slot has token 2, or one with 2 raw bits; all words are missing.
    first = 2 if weights == "no raw bits" else 32
    tables = tables_of(np.where(np.arange(ALPHABET) < first, 0, 1))
    nearest, none = find_all_nearest(np.ones((3, 700), np.int64)), np.zeros(700, np.int64)
    states = encode_passes([], tables)[0]
    levels = np.zeros((3, 3, 700), np.int32)
    near, rows = two_nearest(nearest), np.zeros(2000, np.uint16)
    scene = random_scene(700, 0, seed=1)
    lattice = arrange_scene(scene, Config("m"), None).lattice
    empty = memoryview(bytes(4))
    for read in (
        lambda reader: read_colours(reader, [empty], rows, nearest, 1, none),
        lambda reader: read_pass(reader, {"a": empty}, made_pass(none)),
        lambda reader: read_bands(reader, [empty], [rows], levels, near, none),
        lambda reader: read_shapes(reader, [empty] * 4, rows, lattice, 700),
    ):
        with pytest.raises(CorruptStream, match=r"more symbols than words|out of range|beyond"):
            read(reader_of(states, tables))

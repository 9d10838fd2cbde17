"""Morton order, count tree and colour coder: lossless on any points."""

from __future__ import annotations

from math import log2

import numpy as np
import pytest

from gs_codec.coding.count_tree import decode_geometry, encode_geometry
from gs_codec.coding.morton import bit_layout, canonical_order, decode_morton, encode_morton
from gs_codec.coding.predicted_colour import decode_colour, encode_colour
from gs_codec.errors import CorruptStream, TruncatedStream


def slow_morton(cell, depths):
    code = 0
    for level in range(max(depths) - 1, -1, -1):
        for axis in range(3):
            if depths[axis] > level:
                code = 2 * code + (int(cell[axis]) >> level & 1)
    return code


@pytest.mark.parametrize("depths", [(16, 16, 16), (21, 21, 21), (5, 0, 9), (0, 0, 1), (1, 12, 3)])
def test_morton_codes_follow_their_definition_and_invert(depths):
    rng = np.random.default_rng(depths)
    cells = np.stack([rng.integers(0, 1 << d, 200) for d in depths]).astype(np.uint32)
    codes = encode_morton(cells, depths)
    assert codes.tolist() == [slow_morton(cell, depths) for cell in cells.T]
    np.testing.assert_array_equal(decode_morton(codes, depths), cells)
    assert bit_layout(depths).size == sum(depths)


def test_no_axis_has_the_code_zero():
    cells = np.zeros((3, 4), np.uint32)
    assert encode_morton(cells, (0, 0, 0)).tolist() == [0] * 4


@pytest.mark.parametrize("seed", range(5))
def test_canonical_order_is_by_code_colour_and_index(seed):
    rng = np.random.default_rng(seed)
    codes = rng.integers(0, 40, 500)
    colours = rng.integers(0, 3, (3, 500)).astype(np.uint16)
    keys = list(zip(codes, *colours, range(500), strict=True))
    expected = sorted(range(500), key=keys.__getitem__)
    np.testing.assert_array_equal(canonical_order(codes, *colours), expected)


def test_count_tree_refuses_padding_that_is_not_zero():
    codes = np.array([1, 5, 9], np.int64)  # 3 splits leave a few unused bits in the last byte
    data = bytearray(encode_geometry(codes, 4))
    decode_geometry(memoryview(data), 3, 4, "x")
    data[-1] |= 1
    with pytest.raises(CorruptStream, match="padding"):
        decode_geometry(memoryview(data), 3, 4, "x")


POINTS = {
    "none": ([], 48),
    "one": ([123456789], 48),
    "one of no bits": ([0], 0),
    "duplicates of no bits": ([0] * 50, 0),
    "first and last": ([0, (1 << 48) - 1], 48),
    "duplicates": ([7] * 1000 + [8] * 3 + [(1 << 63) - 1] * 2, 63),
    "dense": (list(range(512)), 9),
    "powers": ([1 << i for i in range(62)], 63),
}


@pytest.mark.parametrize("name", POINTS)
def test_count_tree_returns_the_codes(name):
    codes, total_bits = POINTS[name]
    codes = np.array(codes, np.int64)
    data = encode_geometry(codes, total_bits)
    decoded = decode_geometry(memoryview(data), codes.size, total_bits, "x")
    np.testing.assert_array_equal(decoded, codes)


@pytest.mark.parametrize("bits", [1, 10, 30, 63])
@pytest.mark.parametrize("count", [2, 33, 5000])
def test_count_tree_returns_random_codes_near_their_entropy(count, bits):
    rng = np.random.default_rng([count, bits])
    codes = np.sort(rng.integers(0, 1 << bits, count))
    data = encode_geometry(codes, bits)
    decoded = decode_geometry(memoryview(data), count, bits, "x")
    np.testing.assert_array_equal(decoded, codes)
    cells = 1 << bits  # number of multisets of `count` cells: count + cells - 1 over count
    bits_needed = sum(log2((cells + i) / (i + 1)) for i in range(count))
    assert 8 * len(data) <= 1.05 * bits_needed + 400


def test_constant_cost_of_a_million_duplicates():
    assert len(encode_geometry(np.full(1_000_000, 12345, np.int64), 48)) < 40


@pytest.mark.parametrize("seed", range(20))
def test_count_tree_rejects_data_or_returns_all_codes(seed):
    rng = np.random.default_rng(seed)
    data = bytearray(encode_geometry(np.sort(rng.integers(0, 1 << 30, 300)), 30))
    data[rng.integers(len(data))] ^= 1 << rng.integers(8)
    try:
        codes = decode_geometry(memoryview(data), 300, 30, "x")
    except (CorruptStream, TruncatedStream):
        return
    assert np.all(np.diff(codes) >= 0)
    assert codes[0] >= 0
    assert codes[-1] < 1 << 30


@pytest.mark.parametrize("keep", [0, 3, 4, 50, -1])
def test_count_tree_refuses_truncation(keep):
    data = encode_geometry(np.sort(np.random.default_rng(40).integers(0, 1 << 30, 300)), 30)
    with pytest.raises((CorruptStream, TruncatedStream)):
        decode_geometry(memoryview(data[:keep]), 300, 30, "x")


def coloured_points(count, depths, seed):
    rng = np.random.default_rng(seed)
    cells = np.sort(rng.integers(0, 1000, (3, count)), axis=1).astype(np.uint32)
    smooth = 0.5 + 0.4 * np.sin(cells.sum(axis=0) / 300) + rng.normal(0, 0.02, (3, count))
    tops = np.array([[(1 << d) - 1] for d in depths])
    return cells, np.rint(np.clip(smooth, 0, 1) * tops).astype(np.uint16)


@pytest.mark.parametrize(
    "depths", [(8, 8, 8), (1, 1, 1), (12, 12, 12), (0, 8, 8), (8, 0, 8), (0, 0, 8)]
)
@pytest.mark.parametrize("count", [0, 1, 2, 40, 3000])
def test_colour_coder_returns_the_colours(count, depths):
    cells, colours = coloured_points(count, depths, [count, *depths])
    data = encode_colour(cells, colours, depths)
    decoded = decode_colour(memoryview(data), cells, depths, "x")
    np.testing.assert_array_equal(decoded, colours)


def test_colour_coder_predicts():
    cells, colours = coloured_points(3000, (8, 8, 8), 41)
    alone = np.random.default_rng(41).permutation(3000)
    assert len(encode_colour(cells, colours, (8, 8, 8))) < 0.8 * len(
        encode_colour(cells, colours[:, alone], (8, 8, 8))
    )


def test_colour_coder_handles_random_extremes():
    rng = np.random.default_rng(42)
    cells = rng.integers(0, 1 << 21, (3, 500)).astype(np.uint32)
    colours = rng.choice(np.array([0, 4095], np.uint16), (3, 500))
    data = encode_colour(cells, colours, (12, 12, 12))
    np.testing.assert_array_equal(
        decode_colour(memoryview(data), cells, (12, 12, 12), "x"), colours
    )


@pytest.mark.parametrize("seed", range(20))
def test_colour_decoder_rejects_data_or_stays_in_range(seed):
    rng = np.random.default_rng(seed)
    cells, colours = coloured_points(300, (8, 8, 8), seed)
    data = bytearray(encode_colour(cells, colours, (8, 8, 8)))
    data[rng.integers(len(data))] ^= 1 << rng.integers(8)
    try:
        decoded = decode_colour(memoryview(data), cells, (8, 8, 8), "x")
    except CorruptStream:
        return
    assert decoded.max() < 256

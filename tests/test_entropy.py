"""Entropy coders: lossless with any table, close to the entropy, clean errors on damage."""

from __future__ import annotations

import numpy as np
import pytest

from gs_codec.coding.binary import code_bit, decode_binary, encode_binary, new_contexts
from gs_codec.coding.frequency_table import (
    FrequencyTable,
    SentModel,
    decode_tables,
    encode_tables,
    normalise,
    shannon_bits,
)
from gs_codec.coding.rans import LANES, TableSet, decode_symbols, encode_symbols
from gs_codec.errors import CorruptStream
from gs_codec.runtime.kernels import kernel


def table_of(rng, alphabet: int, precision: int) -> FrequencyTable:
    weights = np.ceil(1000 * rng.random(alphabet) ** 4).astype(np.int64)
    weights[rng.random(alphabet) < 0.2] = 0
    weights[0] += 1
    return normalise(weights, precision)


def draw(rng, table: FrequencyTable, count: int) -> np.ndarray:
    chances = table.frequencies / table.frequencies.sum()
    return rng.choice(table.frequencies.size, count, p=chances).astype(np.uint16)


def rans_round_trip(symbols, tables, split=()):
    packed = TableSet.pack(tables)
    states, words = encode_symbols(symbols, 0, symbols.shape[1], packed)
    bounds = [0, *split, len(tables)]
    groups = [
        (b - a, memoryview(b"".join(words[a:b])))
        for a, b in zip(bounds[:-1], bounds[1:], strict=True)
    ]
    decoded = decode_symbols(memoryview(states), groups, symbols.shape[1], packed, "test")
    return decoded, states, groups, packed


@pytest.mark.parametrize("count", [1, 2, LANES - 1, LANES, LANES + 1, 1000])
@pytest.mark.parametrize("precision", [8, 12, 14, 15])
@pytest.mark.parametrize("alphabet", [1, 2, 5, 256])
def test_rans_returns_the_symbols(alphabet, precision, count):
    rng = np.random.default_rng([alphabet, precision, count])
    tables = [table_of(rng, alphabet, precision) for _ in range(3)]
    symbols = np.stack([draw(rng, table, count) for table in tables])
    np.testing.assert_array_equal(rans_round_trip(symbols, tables, (1,))[0], symbols)


def test_rans_codes_the_rarest_symbol_next_to_the_commonest():
    table = normalise(np.array([1, 1 << 40], np.int64), 15)
    assert table.frequencies.tolist() == [1, 32767]
    symbols = np.zeros((1, 500), np.uint16)
    symbols[0, ::2] = 1
    np.testing.assert_array_equal(rans_round_trip(symbols, [table])[0], symbols)


def test_rans_is_within_a_thousandth_of_the_entropy():
    rng = np.random.default_rng(20)
    tables = [table_of(rng, 200, 15) for _ in range(4)]
    symbols = np.stack([draw(rng, table, 50_000) for table in tables])
    histograms = [np.bincount(row, minlength=200) for row in symbols]
    ideal = sum(t.code_length(h) for t, h in zip(tables, histograms, strict=True))
    _, states, groups, _ = rans_round_trip(symbols, tables)
    assert 8 * (len(states) + len(groups[0][1])) <= 1.001 * ideal


@pytest.mark.parametrize("seed", range(8))
def test_rans_refuses_every_changed_byte_or_stays_in_its_alphabet(seed):
    rng = np.random.default_rng(seed)
    tables = [table_of(rng, 40, 12)]
    symbols = draw(rng, tables[0], 300)[None]
    _, states, groups, packed = rans_round_trip(symbols, tables)
    words = bytearray(groups[0][1])
    words[rng.integers(len(words))] ^= 1 << rng.integers(8)
    try:
        damaged = decode_symbols(memoryview(states), [(1, memoryview(words))], 300, packed, "x")
    except CorruptStream:
        return
    assert damaged.max() < 40


@pytest.mark.parametrize("change", ["cut", "grow", "odd", "states"])
def test_rans_refuses_wrong_lengths(change):
    rng = np.random.default_rng(21)
    tables = [table_of(rng, 40, 12)]
    _, states, groups, packed = rans_round_trip(draw(rng, tables[0], 300)[None], tables)
    words = bytes(groups[0][1])
    words = {"cut": words[:-2], "grow": words + b"\0\0", "odd": words[:-1]}.get(change, words)
    states = states[:-4] if change == "states" else states
    with pytest.raises(CorruptStream):
        decode_symbols(memoryview(states), [(1, memoryview(words))], 300, packed, "x")


def test_rans_refuses_a_border_between_streams_in_the_wrong_place():
    rng = np.random.default_rng(22)
    tables = [table_of(rng, 40, 12) for _ in range(2)]
    symbols = np.stack([draw(rng, table, 300) for table in tables])
    _, states, groups, packed = rans_round_trip(symbols, tables, (1,))
    words = b"".join(bytes(data) for _, data in groups)
    middle = len(groups[0][1]) + 2
    wrong = [(1, memoryview(words[:middle])), (1, memoryview(words[middle:]))]
    with pytest.raises(CorruptStream, match="does not end where its words do"):
        decode_symbols(memoryview(states), wrong, 300, packed, "x")


@kernel
def _walk(bits, contexts_of, state, data, contexts):
    for i in range(bits.size):
        bits[i] = code_bit(state, data, contexts, contexts_of[i], bits[i] != 0)


def binary_streams(rng, count, chance):
    bits = (rng.random(count) < chance).astype(np.int64)
    contexts_of = rng.integers(0, 4, count)

    def encode(state, data):
        _walk(bits.copy(), contexts_of, state, data, new_contexts(4))

    return bits, contexts_of, encode


@pytest.mark.parametrize("chance", [0.0, 1e-3, 0.3, 0.5, 0.99, 1.0])
@pytest.mark.parametrize("count", [0, 1, 7, 4000])
def test_binary_coder_returns_the_decisions_near_their_entropy(count, chance):
    rng = np.random.default_rng([23, count, int(1000 * chance)])
    bits, contexts_of, encode = binary_streams(rng, count, chance)
    data = encode_binary(encode, 0)
    decoded = np.zeros(count, np.int64)
    decode_binary(lambda s, d: _walk(decoded, contexts_of, s, d, new_contexts(4)), data, "x")
    np.testing.assert_array_equal(decoded, bits)
    entropy = shannon_bits(np.bincount(bits, minlength=2)) if count else 0.0
    assert 8 * len(data) <= 1.02 * entropy + 4 * 12 + 8 + count * 1.0e-3


@pytest.mark.parametrize("surplus", [1, 2, 50])
def test_binary_coder_refuses_surplus_and_never_takes_less_for_the_same(surplus):
    bits, contexts_of, encode = binary_streams(np.random.default_rng(24), 4000, 0.4)
    data = encode_binary(encode, 0)

    def decode(stream):
        decoded = np.zeros(bits.size, np.int64)
        decode_binary(lambda s, d: _walk(decoded, contexts_of, s, d, new_contexts(4)), stream, "x")
        return decoded

    with pytest.raises(CorruptStream):
        decode(data + b"\1" * surplus)
    try:
        assert np.any(decode(data[:-surplus]) != bits)
    except CorruptStream as error:
        assert "coded bytes" in str(error)  # noqa: PT017


@pytest.mark.parametrize("mantissa", [0, 2, 6, 15])
def test_sent_tables_return_their_weights(mantissa):
    rng = np.random.default_rng([25, mantissa])
    histograms = [np.floor(10 ** rng.uniform(0, 9, a)).astype(np.int64) for a in (1, 2, 16, 300)]
    histograms[2][::3] = 0
    weights = [SentModel.fit(h, mantissa, 15).weights for h in histograms]
    data = encode_tables(weights, [mantissa] * 4)
    decoded = decode_tables(memoryview(data), [1, 2, 16, 300], [mantissa] * 4, "x")
    for before, after in zip(weights, decoded, strict=True):
        np.testing.assert_array_equal(before, after)


def test_sent_tables_support_32_bit_weights_and_refuse_longer_ones():
    weights = np.array([1, 0xFFFF << 16, 1 << 31, 0], np.int64)
    (decoded,) = decode_tables(memoryview(encode_tables([weights], [15])), [4], [15], "x")
    np.testing.assert_array_equal(decoded, weights)
    data = encode_tables([np.array([1, 1 << 32], np.int64)], [15])
    with pytest.raises(CorruptStream, match="more than 32 bits"):
        decode_tables(memoryview(data), [2], [15], "x")


def test_sent_tables_refuse_an_empty_table():
    data = encode_tables([np.zeros(5, np.int64)], [2])
    with pytest.raises(CorruptStream, match="without symbols"):
        decode_tables(memoryview(data), [5], [2], "x")


@pytest.mark.parametrize("seed", range(5))
def test_noisy_sent_tables_do_not_crash(seed):
    data = np.random.default_rng(seed).integers(0, 256, 100, np.uint8).tobytes()
    with pytest.raises(CorruptStream):
        decode_tables(memoryview(data), [256, 256], [15, 15], "x")

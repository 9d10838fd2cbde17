"""Lanes: each operation equals numpy's on 16 values, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest

from gs_codec.runtime.kernels import kernel
from gs_codec.runtime.simd import (
    LANES,
    between,
    bits_of,
    columns,
    cut_off,
    first_of,
    largest,
    last_of,
    load,
    mask_of,
    prefetch,
    repeated,
    store,
    total,
    where,
    wide,
)


@kernel
def _calculate(values, out):
    a, b = load(values, np.int64(0)), load(values, np.int64(LANES))
    two = np.float32(2)
    results = a + b, a - b, a * b, a / b, two - a, a * two, where((a < b) & (a > two), a, b)
    for row in range(len(results)):
        store(out, row * LANES, results[row])


@kernel
def _total(values):
    lanes = load(values, np.int64(0))
    return total(lanes), total(cut_off(lanes)), largest(lanes)


@kernel
def _total_wide(values):
    lanes = load(values, np.int64(0))
    return total(wide(lanes) * wide(columns()) - 1.5)


@kernel
def _ends(values):
    mask = load(values, np.int64(0)) >= np.float32(1)
    return first_of(mask), last_of(mask), bits_of(mask)


@kernel
def _select(values, first, last, bits, out):
    lanes, zero = load(values, np.int64(0)), repeated(np.float32(0))
    store(out, np.int64(0), where(between(first, last), lanes, zero))
    store(out, np.int64(LANES), where(mask_of(bits), lanes, zero))


@pytest.fixture
def values() -> np.ndarray:
    return np.random.default_rng(0).normal(scale=3, size=2 * LANES).astype(np.float32)


def test_lanes_calculate_as_numpy(values):
    a, b, out = values[:LANES], values[LANES:], np.empty(7 * LANES, np.float32)
    _calculate(values, out)
    expected = a + b, a - b, a * b, a / b, 2 - a, a * 2, np.where((a < b) & (a > 2), a, b)
    np.testing.assert_array_equal(out, np.concatenate(expected))


def test_a_total_has_a_fixed_order(values):
    four = values[:4] + values[4:8] + values[8:12] + values[12:16]
    added, cut, most = _total(values)
    assert added == (four[0] + four[1]) + (four[2] + four[3])
    assert (cut, most) == (np.trunc(values[:LANES]).sum(), values[:LANES].max())
    expected = values[:LANES].astype(np.float64) * np.arange(LANES) - 1.5
    assert _total_wide(values) == pytest.approx(expected.sum(), rel=1e-12)


@pytest.mark.parametrize(("first", "last"), [(0, 15), (3, 3), (2, 9), (16, -1)])
def test_masks_have_ends_and_bits(values, first, last):
    given, out = np.zeros(LANES, np.float32), np.empty(2 * LANES, np.float32)
    given[first : last + 1] = 1
    bits = sum(1 << k for k in range(first, last + 1))
    assert _ends(given) == (first, last, bits)
    _select(values, first, last, bits, out)
    np.testing.assert_array_equal(out, np.tile(given * values[:LANES], 2))


def test_whole_numbers_are_loaded_and_cut_off():
    @kernel
    def double(values, out):
        prefetch(values, np.int64(16))
        store(out, np.int64(0), load(values, np.int64(1)) * np.float32(2.5))

    values, out = np.arange(17, dtype=np.uint16) * 1000, np.empty(LANES, np.uint16)
    double(values, out)
    np.testing.assert_array_equal(out, (values[1:] * 2.5).astype(np.uint16))

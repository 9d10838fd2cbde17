"""Unit tests of the lattice modules: tokens, rules, axes, colours, positions, step sizes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scenes import random_scene

from gs_codec.codecs.adaptive.colour import round_diffusing
from gs_codec.codecs.adaptive.contexts import (
    MAX_TABLES,
    share_tables,
)
from gs_codec.codecs.adaptive.lattice import (
    FRACTION_BITS,
    LARGEST,
    PositionGrid,
    StepRule,
    centres,
    from_grid,
    from_lattice,
    grid_codes,
    to_fixed,
    to_float,
    to_lattice,
)
from gs_codec.codecs.adaptive.rotation import likeness
from gs_codec.codecs.adaptive.section import decode_marks, encode_marks
from gs_codec.codecs.adaptive.step_sizes import (
    MAX_SLOPE,
    Sensitivity,
    features,
    fit_step_sizes,
    make_rule,
)
from gs_codec.codecs.adaptive.tokens import ALPHABET, tokenise
from gs_codec.coding.axes import nearest_quaternions, sort_axes
from gs_codec.coding.count_tree import decode_tree, encode_tree
from gs_codec.coding.fields import BitReader, BitWriter
from gs_codec.coding.frequency_table import shannon_bits
from gs_codec.coding.morton import decode_morton
from gs_codec.coding.nearest import NEIGHBOURS, WINDOW, find_all_nearest
from gs_codec.coding.ycocg import fill_colours, from_ycocg, take_colours, to_ycocg
from gs_codec.config import ADAPTIVE_PROFILES
from gs_codec.errors import CorruptStream

ONE = 1 << FRACTION_BITS

# Tokens


@pytest.mark.parametrize(
    ("value", "token", "width"),
    [
        (0, 0, 0), (1, 2, 0), (-1, 3, 0), (15, 30, 0), (-15, 31, 0), (16, 32, 2), (17, 32, 2),
        (19, 32, 2), (20, 34, 2), (31, 38, 2), (32, 40, 3), (-33, 41, 3),
        (2**30 - 1, ALPHABET - 2, 27), (1 - 2**30, ALPHABET - 1, 27),
    ],
)  # fmt: skip
def test_token(value, token, width):
    tokens, *raw = tokenise(np.array([value]))
    assert tokens.tolist() == [token]
    assert [row.tolist() for row in raw] == ([[0], [value], [width]] if width else [[], [], []])


def test_fields_of_any_width_round_trip_seed4():
    rng = np.random.default_rng(4)
    widths = np.concatenate([[0, 63, 1], rng.integers(0, 64, 500)])
    values = np.array([int(rng.integers(0, 2**62)) & ((1 << int(w)) - 1) for w in widths])
    writer = BitWriter()
    writer.add(values, widths.astype(np.uint8))
    reader = BitReader(memoryview(writer.finish()), "test")
    np.testing.assert_array_equal(reader.fields(widths), values)
    reader.close()


# Tables of contexts


def test_similar_contexts_share_a_table_and_different_ones_do_not():
    histograms = np.zeros((8, 10), np.int64)
    histograms[1] = histograms[2] = 1000
    histograms[4, 0], histograms[6, 9] = 5000, 5000
    table_of, shared = share_tables(histograms)
    assert table_of.tolist() == [0, 0, 0, 0, 1, 1, 2, 2]
    np.testing.assert_array_equal(shared.sum(axis=0), histograms.sum(axis=0))


def test_unused_tokens_are_omitted():
    histograms = np.zeros((3, 10), np.int64)
    histograms[:, 4] = 7
    assert share_tables(histograms)[1].tolist() == [[0, 0, 0, 0, 21]]


@pytest.mark.parametrize("seed", range(5))
def test_shared_tables_contain_all_symbols_of_their_contexts_seed(seed):
    rng = np.random.default_rng(seed)
    histograms = rng.integers(0, 2 ** rng.integers(1, 12), (32, 20)) * rng.integers(0, 2, (32, 1))
    table_of, shared = share_tables(histograms)
    assert set(np.diff(table_of)) <= {0, 1}
    assert table_of[0] == 0
    assert table_of[-1] + 1 == len(shared)
    for table, histogram in enumerate(shared):
        expected = histograms[table_of == table].sum(axis=0)
        np.testing.assert_array_equal(histogram, expected[: len(histogram)])
        assert not expected[len(histogram) :].any()
    together = shannon_bits(histograms.sum(axis=0))
    assert sum(map(shannon_bits, shared)) <= together + 1e-6


def test_unused_contexts_have_one_table():
    table_of, shared = share_tables(np.zeros((9, 10), np.int64))
    assert table_of.tolist() == [0] * 9
    assert shared.shape == (1, 10)


# Rules and fixed-point values


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("weight", [1, 3])
def test_rule_is_the_integer_sum_of_the_specification_seed(seed, weight):
    rng = np.random.default_rng(seed)
    a, b, *c = (int(x) for x in rng.integers(-(2**19), 2**19, 5))
    limit = int(rng.integers(0, 94))
    classes, opacity = rng.integers(0, 16, 300), rng.integers(-400 * ONE, 400 * ONE, 300)
    scales = rng.integers(-20 * ONE, 5 * ONE, (3, 300))
    rule = StepRule(a, b, (c[0], c[1], c[2]), limit)
    found = rule.shifts(classes, weight, opacity, scales)
    for i, shift in enumerate(found.tolist()):
        total = a + 2**16 * weight * int(classes[i]) + b * min(int(opacity[i]), 0) // 2**20
        total += sum(c[k] * int(scales[k, i]) // 2**20 for k in range(3))
        assert shift == max(0, min(limit, total // 2**16))
    assert len(set(found.tolist())) > 1 or limit == 0


@pytest.mark.parametrize(("logit", "shift"), [(5, 2), (0, 2), (-1, 3), (-3, 5), (-1.5, 3)])
def test_rule_uses_only_negative_logits_and_rounds_down(logit, shift):
    rule = StepRule(2 << 16, -(1 << 16), (0, 0, 0), 31)
    opacity = np.array([int(logit * ONE)])
    none = np.zeros(1, np.int64)
    assert rule.shifts(none, 1, opacity, np.zeros((3, 1), np.int64)).tolist() == [shift]


def test_rule_with_numbers_out_of_range_is_clipped():
    rule = make_rule(np.array([1e9, -1e9, 1e9, 0, np.float64(0.5)]), -10.0, 2.0)
    assert rule.limit == 12
    assert (rule.intercept, rule.opacity) == (2**31 - 1, -MAX_SLOPE)
    assert rule.scales[0] == MAX_SLOPE


@pytest.mark.parametrize("seed", range(3))
def test_lattice_is_within_half_a_step_seed(seed):
    rng = np.random.default_rng(seed)
    values = rng.normal(0, 100, 4000)
    shifts = rng.integers(0, 24, 4000)
    fixed, clamped = to_fixed(values, LARGEST)
    levels = to_lattice(fixed, -7 * ONE, 5, shifts)
    back = to_float(from_lattice(levels, -7 * ONE, 5, shifts))
    steps = 5 * 2.0**shifts / ONE
    error = np.abs(np.clip(values, -LARGEST, LARGEST) - back)
    assert np.all(error <= 0.5 * steps + 0.5 / ONE)
    assert np.max(error / steps) > 0.45
    assert clamped == np.count_nonzero(np.abs(values) > LARGEST)


def test_values_beyond_the_largest_are_clamped():
    values = np.array([1e38, -1e38, LARGEST, 400.0001], np.float32)
    fixed, clamped = to_fixed(values, LARGEST)
    levels = to_lattice(fixed, 0, 1, np.zeros(4, np.int64))
    assert clamped == 3
    assert levels.tolist() == [400 * ONE, -400 * ONE, 400 * ONE, 400 * ONE]


# Axes


def covariance(log_scale: np.ndarray, rot: np.ndarray) -> np.ndarray:
    """R S^2 R^T ``(N, 3, 3)`` in float64."""
    w, x, y, z = rot.astype(np.float64) / np.linalg.norm(rot.astype(np.float64), axis=0)
    r = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    squares = np.exp(2 * log_scale.astype(np.float64)).T
    return np.einsum("nik,nk,njk->nij", r, squares, r)


def whole(vectors: np.ndarray) -> np.ndarray:
    """Quaternions from their vector parts, in float64."""
    real = np.sqrt(np.maximum(1 - np.sum(vectors**2, axis=0), 0))
    return np.concatenate([real[None], vectors])


def test_sorting_axes_keeps_the_gaussian_seed8():
    scene = random_scene(2000, 0, seed=8)
    order, scales, vectors = sort_axes(scene.log_scale, scene.rot)
    assert np.all(np.diff(scales, axis=0) <= 0)
    np.testing.assert_array_equal(scales, np.take_along_axis(scene.log_scale, order, 0))
    rot = whole(vectors)
    assert np.all(np.abs(vectors) <= rot[0] + 1e-12)
    before = covariance(scene.log_scale, scene.rot)
    size = np.abs(before).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(covariance(scales, rot) / size, before / size, atol=1e-12)


def test_all_24_parameterisations_of_a_gaussian_are_one_seed9():
    """Axes in any order, with any half turns, and any sign and norm of the quaternion."""
    rng = np.random.default_rng(9)
    rot = rng.normal(size=4)
    log_scale = np.array([-1.0, -2.5, -4.0])
    a, b, c, d = (rot / np.linalg.norm(rot)).tolist()
    unit = [
        np.array(q, float) / np.linalg.norm(q)
        for q in itertools.product((0, 1, -1), repeat=4)
        if sum(map(abs, q)) in (1, 2, 4)
    ]
    ways = []
    for p, q, r, s in unit:
        turned = [
            a * p - b * q - c * r - d * s,
            a * q + b * p + c * s - d * r,
            a * r - b * s + c * p + d * q,
            a * s + b * r - c * q + d * p,
        ]
        matrix = covariance(np.log([[2.0], [3.0], [5.0]]), np.array([[p], [q], [r], [s]]))[0]
        axes = [(4, 9, 25).index(round(value)) for value in np.diag(matrix)]
        scales = np.empty(3)
        scales[axes] = log_scale
        ways.append((scales, 3.0 * np.array(turned)))
    assert len(ways) == 48
    written = sort_axes(
        np.array([w[0] for w in ways], np.float32).T, np.array([w[1] for w in ways], np.float32).T
    )
    np.testing.assert_array_equal(written[1], np.repeat(log_scale[:, None], 48, axis=1))
    matrices = covariance(written[1], whole(written[2]))
    expected = covariance(log_scale[:, None], rot[:, None])
    np.testing.assert_allclose(matrices, np.repeat(expected, 48, axis=0), atol=1e-6)
    # Up to float32 rounding, all give the same quaternion.
    np.testing.assert_allclose(written[2], np.repeat(written[2][:, :1], 48, axis=1), atol=1e-6)


def test_equal_scales_keep_their_order():
    rot = np.array([[0.1], [0.9], [0.3], [-0.2]], np.float32)
    for scales in itertools.product((-3.0, -2.0), repeat=3):
        given = np.array(scales, np.float32)[:, None]
        order, coded, vectors = sort_axes(given, rot)
        assert order[:, 0].tolist() == sorted(range(3), key=lambda k: -scales[k])
        np.testing.assert_allclose(
            covariance(coded, whole(vectors)), covariance(given, rot), atol=1e-9
        )


def test_nearest_of_the_half_turns_is_the_quaternion_itself_seed11():
    scene = random_scene(500, 0, seed=11)
    _, scales, vectors = sort_axes(scene.log_scale, scene.rot)
    x, y, z = vectors
    w = whole(vectors)[0]
    for way in ((w, x, y, z), (-x, w, z, -y), (y, z, -w, -x), (-z, y, -x, w)):
        turned = np.float32(way)
        found, expected = (covariance(scales, q) for q in (turned, whole(vectors)))
        np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
        near = nearest_quaternions(vectors, turned)
        assert near.dtype == np.float32
        np.testing.assert_allclose(near, turned, atol=1e-7)


# Colours


def test_ycocg_round_trip_and_length_seed10():
    rgb = np.random.default_rng(10).normal(size=(3, 1000)).astype(np.float32)
    values = to_ycocg(rgb)
    np.testing.assert_allclose(from_ycocg(values), rgb, atol=1e-6)
    np.testing.assert_allclose(
        np.sum(values**2, axis=0), np.sum(rgb.astype(np.float64) ** 2, axis=0), rtol=1e-12
    )


def test_grey_has_only_luma():
    values = to_ycocg(np.full((3, 1), 2.0, np.float32))
    np.testing.assert_allclose(values[:, 0], [2 * np.sqrt(3), 0, 0], atol=1e-12)


def test_diffused_rounding_errors_are_small_and_cancel_seed12():
    rng = np.random.default_rng(12)
    places = np.sort(rng.integers(0, 2**10, (3, 4000)), axis=1)
    values = np.full((2, 4000), 0.3, np.float32)
    nearest = find_all_nearest(places)
    levels = round_diffusing(nearest, values)
    assert np.all(np.abs(levels - values) <= 1.5)
    assert abs(levels.mean() - 0.3) < 0.15
    for count in (1, 0):
        few = find_all_nearest(places[:, :count])
        assert round_diffusing(few, values[:, :count]).tolist() == [[0] * count] * 2


@pytest.mark.parametrize("largest", [3, 2**12, 2**22])
def test_nearest_are_from_the_window_with_ties_to_the_later_seed13(largest):
    places = np.random.default_rng(13).integers(0, largest, (3, 300))
    places[:, -1] = largest
    near, distances = find_all_nearest(places)
    for i in range(300):
        earlier = range(max(i - WINDOW, 0), i)
        squares = {j: int(np.sum((places[:, j] - places[:, i]) ** 2)) for j in earlier}
        expected = sorted(earlier, key=lambda j: (squares[j], -j))[:NEIGHBOURS]
        assert near[i, : len(expected)].tolist() == expected
        cut = [min(squares[j], 2**44 - 1) for j in expected]
        assert distances[i, : len(expected)].tolist() == cut


def test_colours_quantised_in_steps_round_trip_seed14():
    rng = np.random.default_rng(14)
    planes = rng.normal(size=(3, 8, 100)).astype(np.float32)
    planes[0, 2, 7] = 1e9
    members = rng.permutation(100)[:60].astype(np.uint32)
    members[0] = 7
    units, shifts = rng.integers(1, 50, 8), rng.integers(0, 10, 60)
    taken, clamped = take_colours(planes, members, units, shifts, 400.0)
    assert clamped == 3
    steps = (units[:, None] << shifts) / ONE
    expected = np.clip(to_ycocg(planes[:, :, members]), -400, 400) / steps
    np.testing.assert_array_equal(taken, expected.reshape(24, 60).astype(np.float32))
    levels, out = np.rint(taken).astype(np.int32).reshape(3, 8, 60), np.zeros((3, 8, 60))
    assert fill_colours(levels, units, shifts, 1e9, out)
    np.testing.assert_array_equal(out.astype(np.float32), from_ycocg(levels * steps))
    for channel in range(3):
        alone = np.zeros_like(levels)
        alone[channel] = levels[channel]
        largest = np.abs(alone * steps).max()
        assert not fill_colours(alone, units, shifts, largest, out)
        assert fill_colours(alone, units, shifts, np.nextafter(largest, np.inf), out)


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 1.0])
def test_marks_round_trip_seed17(share):
    rng = np.random.default_rng(17)
    lists = [(rng.random(size) < share).astype(np.int64) for size in (0, 1, 30, 255)]
    data = encode_marks(lists)
    decoded = decode_marks(memoryview(data), [0, 1, 30, 255], "test")
    for marks, found in zip(lists, decoded, strict=True):
        np.testing.assert_array_equal(found, marks)
    with pytest.raises(CorruptStream):
        decode_marks(memoryview(data + b"\0"), [0, 1, 30, 255], "test")


def test_there_are_never_more_tables_than_allowed_seed18():
    histograms = np.zeros((200, 60), np.int64)
    histograms[np.arange(200), np.random.default_rng(18).integers(0, 60, 200)] = 10**6
    table_of, shared = share_tables(histograms)
    assert len(shared) == MAX_TABLES == table_of[-1] + 1
    assert shared.sum() == histograms.sum()


# Places


@pytest.mark.parametrize("bits", [(0, 0, 0), (5, 0, 7), (1, 2, 3), (21, 21, 21), (0, 0, 9)])
def test_cell_contains_the_original_for_any_dropped_bits_seed13(bits):
    rng = np.random.default_rng(13)
    origin, step = np.array([-3.0, 1.0, 0.5]), 2.0**-10
    size = step * (2.0 ** np.array(bits))[:, None]
    positions = (origin[:, None] + rng.uniform(0, 1, (3, 500)) * size * 0.999).astype(np.float32)
    positions[:, 0] = origin + size[:, 0]
    grid = PositionGrid(tuple(origin), step, bits)
    codes = grid_codes(positions, grid)
    cells = decode_morton(codes, bits)
    assert cells[:, 0].tolist() == [(1 << depth) - 1 for depth in bits]
    dropped = rng.integers(0, sum(bits) + 1, 500)
    found = centres(codes >> dropped << dropped, dropped, grid)
    axes = [axis for level in range(20, -1, -1) for axis in range(3) if bits[axis] > level][::-1]
    for i in range(500):
        widths = [axes[: dropped[i]].count(axis) for axis in range(3)]
        reach = step * 2.0 ** np.array(widths) / 2
        middle = origin + found[:, i] * step / 2
        assert np.all(np.abs(positions[:, i] - middle) <= reach * (1 + 1e-9) + 1e-6)
        lowest = (cells[:, i].astype(np.int64) >> widths) << widths
        assert found[:, i].tolist() == (2 * lowest + (1 << np.array(widths))).tolist()


def test_positions_beyond_float32_are_clamped():
    grid = PositionGrid((1e38, 0.0, -1e38), 2.0**120, (21, 1, 1))
    far = from_grid(np.array([[2**22], [1], [0]]), grid)
    assert far[0, 0] == np.finfo(np.float32).max
    assert np.isfinite(far).all()


@pytest.mark.parametrize("count", [0, 1, 2, 700])
def test_tree_codes_each_point_until_it_is_unique_seed14(count):
    rng = np.random.default_rng(14)
    codes = np.sort(np.repeat(rng.integers(0, 2**40, count), rng.integers(1, 3, count)))
    data, lefts = encode_tree(codes, 40)
    decoded, known = decode_tree(memoryview(data), codes.size, 40, "test")
    np.testing.assert_array_equal(known, lefts)
    np.testing.assert_array_equal(decoded, codes >> lefts << lefts)
    for i, left in enumerate(lefts.tolist()):
        alone = np.count_nonzero(codes >> left == codes[i] >> left) == 1
        parent = left < 40 and np.count_nonzero(codes >> left + 1 == codes[i] >> left + 1) > 1
        assert (alone and (parent or count == 1)) or (left == 0 and parent)
    with pytest.raises(CorruptStream):
        decode_tree(memoryview(data + b"\0"), codes.size, 40, "test")


# Steps


def made_up(seed: int, count: int = 3000) -> tuple[Sensitivity, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    level = rng.normal(0, 3, count)
    draw = lambda *shape: np.exp(level + rng.normal(0, 1, (*shape, count)))  # noqa: E731
    scales = np.sort(rng.normal(-5, 1, (3, count)), axis=0)[::-1]
    turns = draw(3) * 4.0 ** -likeness(to_fixed(scales, LARGEST)[0])
    found = Sensitivity(100 * draw(), draw(3), turns, draw(), draw())
    return found, rng.normal(0, 3, count), scales


def octaves(steps, known) -> dict[str, np.ndarray]:
    return {
        name: (steps.colour_class if name == "colour" else steps.shape_class) + row @ known
        for name, row in steps.coefficients.items()
    }


def test_four_times_the_sensitivity_makes_steps_an_octave_finer():
    sensitivity, opacity, scales = made_up(15)
    known = features(opacity, scales)
    before = octaves(fit_step_sizes(sensitivity, opacity, scales)(1e-3), known)
    higher = Sensitivity(*(4 * values for values in sensitivity))
    after = octaves(fit_step_sizes(higher, opacity, scales)(1e-3), known)
    for name, values in before.items():
        np.testing.assert_allclose(after[name], values - 1, atol=1e-6, err_msg=name)
    coarser = octaves(fit_step_sizes(sensitivity, opacity, scales)(4e-3), known)
    for name, values in before.items():
        np.testing.assert_allclose(coarser[name], values + 1, atol=1e-9, err_msg=name)


def test_steps_add_about_the_target_error():
    sensitivity, opacity, scales = made_up(16)
    steps = octaves(fit_step_sizes(sensitivity, opacity, scales)(1e-3), features(opacity, scales))
    added = {
        "opacity": sensitivity.opacity,
        "turn_1": 4 * sensitivity.rot[1] * 4.0 ** likeness(to_fixed(scales, LARGEST)[0])[1],
        "position": sensitivity.positions,
        "scale_1": sensitivity.log_scale[1],
    }
    for name, values in added.items():
        error = values * 4.0 ** steps[name] / 12
        assert 0.2e-3 < np.median(error) < 3e-3, name


def test_more_visible_gaussians_have_finer_classes():
    sensitivity, opacity, scales = made_up(17)
    steps = fit_step_sizes(sensitivity, opacity, scales)(1e-3)
    assert 4 < steps.shape_class.max() < 16
    seen = np.log(sensitivity.opacity)
    assert np.corrcoef(seen, steps.shape_class)[0, 1] < -0.7
    colours = np.log(sensitivity.colour)
    assert np.corrcoef(colours, steps.colour_class)[0, 1] < -0.7


@pytest.mark.parametrize("zeros", [0.5, 0.999, 1.0])
def test_steps_of_invisible_gaussians_are_finite(zeros):
    sensitivity, opacity, scales = made_up(18, 500)
    hidden = np.random.default_rng(18).random(500) < zeros
    sensitivity = Sensitivity(*(np.where(hidden, 0.0, values) for values in sensitivity))
    steps = fit_step_sizes(sensitivity, opacity, scales)(1e-3)
    for name, row in steps.coefficients.items():
        assert np.isfinite(row).all(), name
    assert 0 <= steps.shape_class.min() <= steps.shape_class.max() < 16
    assert 0 <= steps.colour_class.min() <= steps.colour_class.max() < 16


@pytest.mark.parametrize("count", [1, 2, 3])
def test_steps_of_few_gaussians_are_finite(count):
    sensitivity, opacity, scales = made_up(19, count)
    steps = fit_step_sizes(sensitivity, opacity, scales)(1e-3)
    assert all(np.isfinite(row).all() for row in steps.coefficients.values())


@pytest.mark.parametrize("factor", [0.5, 1.0, 3.0])
def test_scaled_profile_has_scaled_steps(factor):
    base = ADAPTIVE_PROFILES["m"]
    scaled = base.scaled(factor)
    assert scaled.fineness == base.fineness * factor
    assert scaled.error == base.error * factor**2

"""Rotation as roll and tilts: Gaussians of any shape and orientation are recovered."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scenes import random_scene

from gs_codec.codecs.adaptive.lattice import (
    FRACTION_BITS,
    LARGEST,
    Lattice,
    PositionGrid,
    StepRule,
    to_fixed,
    to_float,
)
from gs_codec.codecs.adaptive.rotation import (
    LARGEST_STEP,
    TURN_RULES,
    TURNS,
    likeness,
    split_roll,
    tilts_of,
    turn_shifts,
    turned_quaternions,
)
from gs_codec.codecs.adaptive.shape import Shape, ShapeQuantiser, walk_shape
from gs_codec.coding.axes import sort_axes
from gs_codec.coding.clean import identity_for_zero

ONE = 1 << FRACTION_BITS
HALF = math.sqrt(0.5)

#: Log-scales, in any order.
SHAPES = {
    "round": (-3.0, -3.0, -3.0),
    "needle": (-6.0, -1.0, -6.0),
    "disc": (-1.0, -6.0, -1.0),
    "two equal, long": (-2.0, -2.0, -2.5),
    "two equal, short": (-2.0, -2.5, -2.5),
    "nearly equal": (-3.0, -3.0 + 2.0**-19, -3.0 + 2.0**-18),
    "all apart": (-1.0, -3.0, -5.0),
    "extreme": (LARGEST, 0.0, -LARGEST),
}

#: Shapes with a visible rotation.
TURNED = [name for name in SHAPES if name != "round"]

#: Quaternions wxyz of any norm: identity, half and quarter turns, and turns about diagonals.
POSES = np.array(
    [
        *(v for v in itertools.product((0.0, 1.0, -1.0), repeat=4) if any(v)),
        *np.random.default_rng(70).normal(size=(60, 4)),
        (1.0, 1e-8, 0.0, 0.0), (1e-8, 0.0, 1.0, 0.0), (3e-20, 4e-20, 0.0, 0.0),
        (7e5, 1.0, 2.0, 3.0), (1.0, 1.0, 1e-7, -1e-7), (0.0, 0.0, 0.0, 0.0),
    ],
    np.float32,
).T  # fmt: skip


def matrices(rot: np.ndarray) -> np.ndarray:
    """Rotations ``(N, 3, 3)``; columns are the Gaussian's axes."""
    w, x, y, z = rot.astype(np.float64) / np.linalg.norm(rot.astype(np.float64), axis=0)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)


def angles(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Angles ``(3, N)`` between axes and their images, in radians; axes have no direction."""
    along = np.einsum("nik,nik->kn", matrices(first), matrices(second))
    across = np.linalg.norm(np.cross(matrices(first), matrices(second), axis=1), axis=1).T
    return np.arctan2(across, np.abs(along))


def lattice_of(unit: int, **rules: StepRule) -> Lattice:
    """A lattice that rounds hardly anything except turns; these with `unit`, or by rules."""
    fine = StepRule(0)
    known = dict.fromkeys(("opacity", "scale_0", "scale_1", "scale_2"), fine)
    turns = {name: StepRule(0, limit=0) for name in TURN_RULES}
    units = {"opacity": 1, "scaling": 1, "rotation": unit}
    return Lattice(
        PositionGrid((0.0, 0.0, 0.0), 1.0, (0, 0, 0)), (1, 1), (0, 0), units,
        {**known, **turns, **rules},
    )  # fmt: skip


def walked(
    lattice: Lattice, log_scale: np.ndarray, rot: np.ndarray
) -> tuple[Shape, ShapeQuantiser, np.ndarray, np.ndarray]:
    """Shape and quantiser of Gaussians; quaternions after sorting, and after decoding."""
    _, scales, vectors = sort_axes(log_scale, rot)
    count = rot.shape[1]
    quantiser = ShapeQuantiser(lattice, np.zeros(count), scales, vectors)
    shape = walk_shape(lattice, np.zeros(count, np.int64), quantiser)
    real = np.sqrt(np.maximum(1 - np.sum(vectors**2, axis=0), 0))
    decoded = turned_quaternions(to_float(shape.turns), shape.poles)
    return shape, quantiser, np.concatenate([real[None], vectors]), decoded


def posed(name: str) -> tuple[np.ndarray, np.ndarray]:
    """All poses of a shape, with its axes in every order."""
    orders = list(itertools.permutations(SHAPES[name]))
    log_scale = np.repeat(np.array(orders, np.float32).T, POSES.shape[1], axis=1)
    scene = random_scene(log_scale.shape[1], 0, seed=71)
    scene.rot[:] = np.tile(POSES, len(orders))
    return log_scale, identity_for_zero(scene)[0].rot


@pytest.mark.parametrize("pole", [0, 2])
@pytest.mark.parametrize("name", TURNED)
def test_fine_steps_recover_every_pose(name, pole):
    coarser = {f"turn_{pole}": StepRule(1 << 16, limit=1)}
    shape, _, before, decoded = walked(lattice_of(4, **coarser), *posed(name))
    assert (shape.poles == pole).all()
    assert decoded.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(decoded, axis=0), 1, atol=1e-6)
    assert decoded[0].min() > 0.49
    assert angles(before, decoded).max() < 5e-5


@pytest.mark.parametrize("step", [0.01, 0.1, 0.3, 0.5, 0.74])
@pytest.mark.parametrize("name", TURNED)
def test_turns_are_within_half_a_step(name, step):
    shape, quantiser, _, decoded = walked(lattice_of(round(step * ONE)), *posed(name))
    for target, turn in zip(quantiser.targets.values(), to_float(shape.turns), strict=True):
        assert np.abs(target - turn).max() <= 0.5 * step + 2.0**-20
        # Within 45 degrees; for tilts, whatever the rounding of the roll.
        assert np.abs(target).max() <= HALF + 1e-12
    assert list(quantiser.targets) == list(TURNS)
    np.testing.assert_allclose(np.linalg.norm(decoded, axis=0), 1, atol=1e-6)


def test_spherical_gaussians_are_not_rotated():
    shape, _, _, decoded = walked(lattice_of(4), *posed("round"))
    assert not shape.turns.any()
    np.testing.assert_array_equal(decoded, np.eye(4)[:1].T.repeat(decoded.shape[1], axis=1))


def test_steps_above_the_largest_are_not_coded():
    for step, coded in ((LARGEST_STEP, True), (LARGEST_STEP + 0.01, False), (1.9, False)):
        shape, _, _, decoded = walked(lattice_of(round(step * ONE)), *posed("all apart"))
        assert shape.turns.any() == coded
        assert np.array_equal(decoded[1:], np.zeros_like(decoded[1:])) != coded


@pytest.mark.parametrize(("name", "pole"), [("needle", 0), ("disc", 2)])
def test_the_pole_keeps_its_direction_for_any_roll(name, pole):
    """The invisible roll is not coded; the visible axis keeps its direction."""
    log_scale, rot = posed(name)
    uncoded = {f"turn_{pole}": StepRule(20 << 16, limit=20)}
    shape, _, before, decoded = walked(lattice_of(64, **uncoded), log_scale, rot)
    assert (shape.poles == pole).all()
    assert not shape.turns[0].any()
    found = angles(before, decoded)
    assert found[pole].max() < 5e-4
    assert found[1].max() > 0.5


def turned_by(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Small turns ``(3, N)`` between two rotations about the Gaussian's own axes, in radians."""
    between = np.einsum("nki,nkj->nij", matrices(before), matrices(after))
    # After a half turn, an axis points the other way.
    between *= np.sign(np.einsum("nii->ni", between))[:, None]
    return 0.5 * np.array([between[:, (k + 2) % 3, (k + 1) % 3] for k in range(3)]) - 0.5 * (
        np.array([between[:, (k + 1) % 3, (k + 2) % 3] for k in range(3)])
    )


@pytest.mark.parametrize("pole", [0, 2])
def test_turns_are_about_the_axes_of_the_gaussian_itself_seed72(pole):
    """In any pose, the axis with the coarsest steps gets the roll, the next one a tilt."""
    rng = np.random.default_rng(72)
    log_scale = np.repeat(np.array([[-1.0], [-3.0], [-5.0]], np.float32), 3000, axis=1)
    rot = rng.normal(size=(4, 3000)).astype(np.float32)
    for tilt, fine in ((1, 2 - pole), (2 - pole, 1)):
        rules = {
            f"turn_{pole}": StepRule(8 << 16, limit=8),
            f"turn_{tilt}": StepRule(5 << 16, limit=5),
        }
        shape, _, before, decoded = walked(lattice_of(200, **rules), log_scale, rot)
        assert (shape.poles == pole).all()
        found = np.sqrt(np.mean(turned_by(before, decoded) ** 2, axis=1))
        step = 200 / ONE
        assert found[pole] == pytest.approx(2 * 256 * step / math.sqrt(12), rel=0.2)
        assert found[tilt] == pytest.approx(2 * 32 * step / math.sqrt(12), rel=0.2)
        assert found[fine] < 0.25 * found[tilt]


@pytest.mark.parametrize(
    ("apart", "octaves"),
    [
        (0, 20), (1, 19), (2, 18), (3, 18), (ONE // 8 - 1, 3), (ONE // 8, 2), (ONE // 2 - 1, 1),
        (ONE // 2, 0), (ONE, 0), (3200 * ONE, 0),
    ],
)  # fmt: skip
def test_likeness_of_two_axes(apart, octaves):
    """It applies to the turn about the third axis; either axis may be longer."""
    for axis in range(3):
        scales = np.zeros((3, 2), np.int64)
        scales[(axis + 1) % 3] = 1600 * ONE - apart, apart - 1600 * ONE
        scales[(axis + 2) % 3] = 1600 * ONE, -1600 * ONE
        assert likeness(scales)[axis].tolist() == [octaves] * 2


def test_shifts_follow_rules_and_likeness_and_the_coarser_end_is_the_pole():
    rules = {
        "turn_0": StepRule(3 << 16, scales=(0, 1 << 16, 0), limit=9),
        "turn_1": StepRule(1 << 16),
        "turn_2": StepRule(4 << 16, limit=31),
    }
    log_scales = np.array([[0.0, 0.0, 0.0, 0.0], [-1.0, 3.0, 0.0, 0.0], [-9.0, -9.0, -9.0, 0.0]])
    scales = to_fixed(log_scales, LARGEST)[0]
    none = np.zeros(4, np.int64)
    shifts, poles = turn_shifts(rules, np.array([0, 1, 2, 0]), none, scales)
    # About the longest: 3 - 1, 3 + 3 + 1, 3 + 2, clamped to 9; about the shortest: 4, 5, 26, 24.
    assert poles.tolist() == [2, 0, 2, 2]
    assert shifts.tolist() == [[4, 7, 26, 24], [1, 2, 3, 21], [2, 5, 5, 9]]


def test_turns_beyond_the_range_still_give_unit_quaternions():
    """A hostile stream may contain them."""
    rng = np.random.default_rng(73)
    turns = rng.normal(size=(3, 400)) * 10.0 ** rng.uniform(-3, 3, 400)
    turns[:, :4] = [[1, -1, 5, 0], [0, 1, 3, 1], [0, 0, 4, 0]]
    for pole in (0, 2):
        rot = turned_quaternions(turns, np.full(400, pole, np.int8))
        np.testing.assert_allclose(np.linalg.norm(rot, axis=0), 1, atol=1e-6)
        assert rot[0].min() >= 0
    assert rot[:, 3].tolist() == [0.0, 0.0, 1.0, 0.0]


def test_a_swing_is_the_same_in_any_frame():
    """Tilts after a roll, rotated back, equal the swing."""
    rng = np.random.default_rng(74)
    rot = rng.normal(size=(4, 500)).astype(np.float32)
    _, _, vectors = sort_axes(np.zeros((3, 500), np.float32), rot)
    poles = rng.choice([0, 2], 500).astype(np.int8)
    rolls, swings = split_roll(vectors, poles)
    assert np.abs(rolls).max() <= HALF + 1e-12
    np.testing.assert_array_less(np.sum(swings**2, axis=0), 0.5 + 1e-12)
    for decoded in (np.zeros(500), rolls, np.full(500, 2.0)):
        tilts = tilts_of(swings, decoded, poles)
        np.testing.assert_allclose(np.sum(tilts**2, axis=0), np.sum(swings**2, axis=0))
    unrolled = tilts_of(swings, np.zeros(500), poles)
    np.testing.assert_array_equal(unrolled[:, poles == 0], swings[:, poles == 0])
    np.testing.assert_array_equal(unrolled[::-1][:, poles == 2], swings[:, poles == 2])

"""Rotated, mirrored, scaled and translated scenes: appearance, and unchanged bits."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product

import numpy as np
import pytest
from appearance import assert_seen_alike, matrix_of, some_turn
from scenes import assert_same_bits, edge_scenes, random_scene

from gs_codec.cameras.camera import Camera
from gs_codec.errors import InvalidInput
from gs_codec.formats.similarity import move_scene, rotation_of
from gs_codec.rendering.renderer import render
from gs_codec.scene import GROUPS

EDGES = edge_scenes()


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_moved_scenes_look_the_same_from_moved_directions(seed, mirrored, degree):
    scene = random_scene(30, degree, seed)
    turn, factor, shift = some_turn(seed, mirrored), 0.5 + seed, np.array([1.0, -2.0, 3.0])
    moved = move_scene(scene, matrix_of(turn, factor, shift))
    expected = factor * turn @ scene.positions + shift[:, None]
    np.testing.assert_allclose(moved.positions, expected, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(moved.log_scale, scene.log_scale + np.log(factor), atol=1e-6)
    assert_seen_alike(scene, replace(moved, log_scale=scene.log_scale), turn)
    for group in ("f_dc", "opacity"):
        np.testing.assert_array_equal(getattr(moved, group), getattr(scene, group))


@pytest.mark.parametrize("mirrored", [False, True])
def test_views_of_a_moved_scene_from_moved_cameras_are_the_same(mirrored):
    scene = random_scene(400, 3, seed=2)
    turn, factor, shift = some_turn(5, mirrored), 2.0, np.array([3.0, 1.0, -2.0])
    here = Camera("here", 60, 40, 50.0, 50.0, 28.0, 20.0, np.eye(3), np.array([0.2, 0.1, -5.0]))
    # An image is mirrored about its vertical axis.
    flip = np.diag([-1.0 if mirrored else 1.0, 1, 1])
    there = replace(
        here,
        cx=60 - here.cx if mirrored else here.cx,
        rotation=flip @ here.rotation @ turn.T,
        position=factor * turn @ here.position + shift,
    )
    before = render(scene, here).colour
    after = render(move_scene(scene, matrix_of(turn, factor, shift)), there).colour
    assert before.std() > 0.05
    np.testing.assert_allclose(after[:, ::-1] if mirrored else after, before, atol=2e-3)
    assert np.abs(render(scene, there).colour - before).max() > 0.1


@pytest.mark.parametrize("order", list(permutations(range(3))))
@pytest.mark.parametrize("signs", list(product((1, -1), repeat=3)))
def test_swapped_and_negated_axes_keep_bits(order, signs):
    scene = random_scene(20, 1, seed=7)
    scene.positions[:, 0] = np.array([0x7FA00001, 0xFFC00002, 0x7F800000], np.uint32).view("<f4")
    turn = np.eye(3)[list(order)] * np.array(signs)[:, None]
    moved = move_scene(scene, matrix_of(turn))
    sound = replace(scene, positions=scene.positions.copy())
    sound.positions[:, 0] = 0
    assert_seen_alike(sound, move_scene(sound, matrix_of(turn)), turn)
    signed = np.array(signs, np.float32)[:, None]
    rows = scene.positions[list(order)].copy()
    np.negative(rows, out=rows, where=signed < 0)
    np.testing.assert_array_equal(moved.positions.view("<u4"), rows.view("<u4"))
    np.testing.assert_array_equal(moved.log_scale, scene.log_scale[list(order)])
    assert_same_bits(scene, move_scene(moved, matrix_of(turn.T)))


@pytest.mark.parametrize("name", EDGES)
def test_edge_scenes_are_moved(name):
    scene = EDGES[name]
    with np.errstate(all="raise", under="ignore"):
        moved = move_scene(scene, matrix_of(some_turn(1)))
    back = move_scene(moved, np.linalg.inv(matrix_of(some_turn(1))))
    # A quaternion and its negative are the same rotation.
    sign = np.float32(np.sign((back.rot.astype(np.float64) * scene.rot).sum()))
    back = replace(back, rot=sign * back.rot)
    for group in GROUPS:
        values = getattr(scene, group)
        largest = np.abs(values, where=np.isfinite(values), out=np.zeros_like(values)).max(
            initial=0
        )
        np.testing.assert_allclose(getattr(back, group), values, atol=1e-6 * largest)


def test_the_identity_changes_nothing():
    scene = random_scene(5)
    assert move_scene(scene, np.eye(4)) is scene


def test_quaternions_of_norm_0_turn_as_the_identity():
    scene = random_scene(5)
    scene.rot[:] = 0
    expected = replace(scene, rot=np.float32([[1], [0], [0], [0]]) + scene.rot)
    turned = [move_scene(each, matrix_of(some_turn(3))).rot for each in (scene, expected)]
    np.testing.assert_array_equal(*turned)


def test_quaternions_of_any_norm_are_rotations():
    half = np.radians(15)
    turn = rotation_of([7 * np.cos(half), 0, 0, 7 * np.sin(half)])
    expected = [[np.cos(2 * half), -0.5, 0], [0.5, np.cos(2 * half), 0], [0, 0, 1]]
    np.testing.assert_allclose(turn, expected, atol=1e-15)
    assert np.isnan(rotation_of([0, 0, 0, 0])).all()


@pytest.mark.parametrize(
    "matrix",
    [
        np.diag([1.0, 1, 1.001, 1]),
        np.diag([0.0, 0, 0, 1]),
        np.diag([1.0, 1, 0, 1]),
        np.diag([1e200, 1e200, 1e200, 1]),
        np.diag([1.0, 1, 1, 2]),
        matrix_of(np.full((3, 3), np.nan)),
        matrix_of(np.array([[1, 0.1, 0], [0, 1, 0], [0, 0, 1]])),
        np.eye(3),
    ],
)
def test_stretching_and_shearing_are_refused(matrix):
    with pytest.raises(InvalidInput, match="stretches or shears, expected one that turns"):
        move_scene(random_scene(3), matrix)

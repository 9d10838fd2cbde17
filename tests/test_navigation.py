"""Mouse navigation of a pose, without a window."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gs_codec.cameras.up import up_of
from viewer.scenes.pose import Pose, distance_ahead, look_at
from viewer.window.keys import KEYS
from viewer.window.navigation import (
    Navigator,
    field_of_view,
    focused,
    framing,
    with_field_of_view,
)

TARGET = np.array([0.5, -0.2, 1.0])
POSE = look_at(np.array([2.0, -3.0, -5.0]), TARGET)
SIZE = (600, 400)


def navigator(pose: Pose = POSE) -> Navigator:
    navigator = Navigator()
    navigator.aim(float(np.linalg.norm(pose.position - TARGET)))
    return navigator


def dragged(
    way: list[tuple[float, float]], events: int, shifts: bool, pose: Pose = POSE
) -> tuple[Pose, Navigator]:
    """The pose after a drag along corners, with several events for each part."""
    hand, last = navigator(pose), pose
    x, y = 300, 200
    hand.hold(pose, x, y, "shift" if shifts else "turn")
    for right, down in way:
        for k in range(1, events + 1):
            at = x + round(k * right / events), y + round(k * down / events)
            last = hand.drag(*at, *SIZE) or last
        x, y = at
    hand.release()
    return last, hand


def matrix(pose: Pose) -> np.ndarray:
    return np.column_stack([pose.rotation, pose.position])


def pixel(pose: Pose, point: np.ndarray = TARGET) -> np.ndarray:
    return pose.project(point[None], *SIZE)[0][0]


@pytest.mark.parametrize("shifts", [False, True], ids=["turn", "shift"])
@pytest.mark.parametrize("events", [1, 5, 20, 50])
def test_a_drag_ends_where_it_would_in_one_event(events, shifts):
    once, _ = dragged([(100, 40)], 1, shifts)
    several, _ = dragged([(100, 40)], events, shifts)
    np.testing.assert_allclose(matrix(several), matrix(once), atol=1e-12)
    assert np.abs(matrix(once) - matrix(POSE)).max() > 0.2


@pytest.mark.parametrize("shifts", [False, True], ids=["turn", "shift"])
@pytest.mark.parametrize("way", [[(120, 50), (-120, -50)], [(90, 0), (0, 300), (-90, -300)]])
def test_a_drag_there_and_back_restores_the_pose(way, shifts):
    back, _ = dragged(way, 7, shifts)
    np.testing.assert_allclose(matrix(back), matrix(POSE), atol=1e-12)


def test_a_drag_over_half_the_height_is_a_quarter_turn():
    turned, _ = dragged([(200, 0)], 3, False)
    before, after = POSE.position - TARGET, turned.position - TARGET
    assert after[1] == pytest.approx(before[1])
    assert np.linalg.norm(after) == pytest.approx(np.linalg.norm(before))
    assert before[[0, 2]] @ after[[0, 2]] == pytest.approx(0, abs=1e-9)
    np.testing.assert_allclose(pixel(turned), [300, 200], atol=1e-9)


@pytest.mark.parametrize("roll", [0, 30, 90, 180])
def test_the_scene_follows_the_mouse(roll):
    turn = np.radians(roll)
    rolled = [[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    pose = replace(POSE, rotation=np.array(rolled) @ POSE.rotation)
    near = TARGET - 2 * pose.rotation[2]
    for right, down in ((3, 0), (0, 3), (-2, 2)):
        moved = pixel(dragged([(right, down)], 1, False, pose)[0], near) - pixel(pose, near)
        drag = np.array([right, down])
        assert moved @ drag > 0.9 * np.linalg.norm(moved) * np.linalg.norm(drag)


def test_the_horizon_stays_level_and_upright():
    pose = POSE
    for right, down in 40 * [(70, 30), (20, -90), (-110, 300)]:
        pose, _ = dragged([(right, down)], 2, False, pose)
        assert pose.rotation[0, 1] == pytest.approx(0, abs=1e-9)  # right is level
        assert pose.rotation[1, 1] > 0  # down is down
        np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-9)


def test_a_look_along_the_axis_can_be_turned():
    rotation = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    above = Pose(rotation, TARGET - [0, 5, 0])
    for way in ((40, 0), (0, -40)):
        turned, _ = dragged([way], 1, False, above)
        assert np.abs(turned.rotation - rotation).max() > 0.2
        np.testing.assert_allclose(pixel(turned), [300, 200], atol=1e-6)


def test_shifts_move_the_point_ahead_with_the_mouse():
    shifted, hand = dragged([(100, 40)], 4, True)
    np.testing.assert_allclose(pixel(shifted), [400, 240], atol=1e-9)
    np.testing.assert_array_equal(shifted.rotation, POSE.rotation)
    centre = shifted.position + hand.distance * shifted.rotation[2]
    turned = hand.turned(shifted, 0.2, 0.1, hand.distance)
    np.testing.assert_allclose(pixel(turned, centre), [300, 200], atol=1e-9)


def test_the_wheel_moves_nearer_and_away_and_never_sticks():
    hand = navigator()
    first = hand.distance
    near = hand.nearer(POSE, 3)
    assert np.linalg.norm(near.position - TARGET) == pytest.approx(0.9**3 * first)
    assert hand.distance == pytest.approx(0.9**3 * first)
    back = hand.nearer(near, -3)
    np.testing.assert_allclose(back.position, POSE.position)
    pose = back
    for _ in range(200):
        before, pose = pose, hand.nearer(pose, 1)
        assert (pose.position - before.position) @ POSE.rotation[2] > 1e-3 * first


def test_other_camera_moves_end_a_drag():
    for other in (lambda hand: hand.nearer(POSE, 1), lambda hand: hand.aim(1.0)):
        hand = navigator()
        hand.hold(POSE, 0, 0)
        other(hand)
        assert hand.drag(50, 50, *SIZE) is None


def test_the_point_ahead_is_where_the_scene_is():
    rng = np.random.default_rng(5)
    ahead = TARGET + rng.normal(0, 0.1, (500, 3))
    aside = POSE.position - 3 * POSE.rotation[2] + rng.normal(0, 0.5, (5000, 3))
    distance = np.linalg.norm(TARGET - POSE.position)
    some = np.concatenate([ahead, aside, np.full((9, 3), np.nan)]).astype(np.float32)
    assert distance_ahead(POSE, some) == pytest.approx(distance, rel=0.01)
    assert distance_ahead(POSE, aside.astype(np.float32)) == pytest.approx(3, rel=0.05)
    assert distance_ahead(POSE, np.zeros((0, 3), np.float32)) == 1
    assert distance_ahead(POSE, POSE.position[None].astype(np.float32)) > 0


def test_up_is_what_most_cameras_have_up():
    rotations = [
        look_at(np.array(p), TARGET).rotation for p in ((3, -1, 0), (-3, -1, 1), (0, -1, 5))
    ]
    np.testing.assert_allclose(up_of(rotations), [0, -1, 0], atol=0.2)


@pytest.mark.parametrize("pitch", [-0.6, 0.0, 0.6])
def test_up_of_cameras_that_look_one_way_is_their_own(pitch):
    rng = np.random.default_rng(6)
    rotations = [
        look_at(np.zeros(3), np.append(rng.normal([0, pitch], 0.02), 1.0)).rotation
        for _ in range(20)
    ]
    down = np.mean([rotation[1] for rotation in rotations], axis=0)
    assert up_of(rotations) @ down < -0.7
    assert abs(up_of(rotations)[0]) < 0.1


def test_up_of_cameras_that_are_upside_down_as_often_is_across_their_right_axes():
    rotations = [np.eye(3), np.diag([-1.0, -1.0, 1.0]), np.eye(3)[[2, 1, 0]] * [[1], [1], [-1]]]
    rotations.append(rotations[2] * [[-1], [-1], [1]])
    np.testing.assert_allclose(np.abs(up_of(rotations)), [0, 1, 0], atol=1e-9)


def test_looking_around_turns_in_place_and_follows_the_mouse():
    hand = navigator()
    hand.hold(POSE, 300, 200, "look")
    looked = hand.drag(330, 180, *SIZE)
    np.testing.assert_allclose(looked.position, POSE.position)
    np.testing.assert_allclose(pixel(looked), [330, 180], atol=3)
    np.testing.assert_allclose(matrix(hand.drag(300, 200, *SIZE)), matrix(POSE), atol=1e-12)


def test_a_flight_moves_along_the_axes_relative_to_the_distance_ahead():
    hand = navigator()
    flown = hand.flown(POSE, np.array([1.0, 0, 2.0]), 0.5)
    axes = POSE.rotation @ (flown.position - POSE.position)
    np.testing.assert_allclose(axes, [0.5 * hand.distance, 0, hand.distance], atol=1e-12)


@pytest.mark.parametrize("at", [(300, 200), (410.5, 33.5)])
def test_focusing_moves_a_point_to_the_middle_at_its_depth(at):
    shifted = replace(POSE, shift=(0.1, -0.05))
    point = focused(shifted, at, 4.0, SIZE)
    depth = 4.0 * POSE.rotation[2]
    moved = shifted.project((point.position + depth)[None], *SIZE)[0][0]
    np.testing.assert_allclose(moved - shifted.lens(*SIZE)[2:], np.subtract(at, [300, 200]))
    np.testing.assert_array_equal(point.rotation, POSE.rotation)


@pytest.mark.parametrize("frame", [(600, 400), (300, 700)])
def test_framing_shows_all_but_far_and_faint_centres(frame):
    rng = np.random.default_rng(5)
    centres = rng.normal(size=(2000, 3)).astype(np.float32) * [3, 1, 2] + 40
    centres[:5], centres[5] = 1e6, np.nan
    opacities = np.full(2000, 0.5)
    centres[6:200], opacities[6:200] = -500, 0.01
    framed, distance = framing(replace(POSE, frame=frame), centres, opacities, np.full(2000, 0.01))
    left, top, right, bottom = framed.framed(*SIZE)
    pixels, depth = framed.project(centres[200:], *SIZE)
    assert (depth > 0).all()
    inside = (pixels > (left, top)) & (pixels < (right, bottom))
    assert inside.all(axis=1).mean() > 0.97
    middle = framed.position + distance * framed.rotation[2]
    np.testing.assert_allclose(middle, [40, 40, 40], atol=1)


def test_a_scene_without_centres_is_framed_by_the_same_pose():
    assert framing(POSE, np.zeros((0, 3)), np.zeros(0), np.zeros(0)) == (POSE, 1.0)


@pytest.mark.parametrize("length", [1e-4, 0.03, 1e5])
def test_a_single_gaussian_fills_the_frame(length):
    middle = np.array([[1.0, 2.0, 3.0]])
    framed, distance = framing(POSE, middle, np.ones(1), np.array([length]))
    _, top, _, bottom = framed.framed(*SIZE)
    radius = 3 * length * framed.lens(*SIZE)[1] / distance
    assert 0.3 * (bottom - top) < radius < 0.5 * (bottom - top)


def test_the_field_of_view_is_set_and_read():
    wide = with_field_of_view(replace(POSE, focal=(1.0, 1.5)), 90)
    assert field_of_view(wide) == pytest.approx(90)
    assert wide.focal == pytest.approx((1 / 3, 0.5))


def test_no_key_does_two_things():
    codes = [(key.code, key.control) for key in KEYS if key.action is not None]
    assert len(set(codes)) == len(codes)

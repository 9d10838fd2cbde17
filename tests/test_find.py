"""Tests of cameras found for a command."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from splats import crowd, render, turned

from gs_codec.cameras.camera import NEAR
from gs_codec.cameras.camera_files import read_cameras, write_cameras
from gs_codec.errors import InvalidInput
from gs_codec.views.find import find_cameras


@pytest.mark.parametrize("halvings", [0, 3, 12], ids="halvings={}".format)
def test_given_cameras_draw_what_is_near_in_any_unit(halvings):
    """In nerfstudio's units a room was cut off at 2 metres: step sizes ignored what was nearer."""
    camera, unit = turned(0), 0.5**halvings
    scene = crowd(camera, 2000, 3, seed=0)
    depth = camera.rotation[2] @ (scene.positions - camera.position[:, None])
    scene = scene.take(np.flatnonzero(depth > NEAR))
    small = replace(
        scene,
        positions=scene.positions * np.float32(unit),
        log_scale=scene.log_scale + np.float32(np.log(unit)),
    )
    [found] = find_cameras([replace(camera, position=unit * camera.position)], small)
    assert found.near == NEAR if halvings == 0 else NEAR * unit <= found.near < NEAR / 2
    drawn, expected = render(small, found), render(scene, camera)
    np.testing.assert_allclose(drawn.colour, expected.colour, atol=0.02)
    np.testing.assert_allclose(drawn.depth, unit * expected.depth, atol=0.05 * unit)


def test_few_floaters_in_front_of_a_camera_stay_hidden():
    camera = turned(1)
    scene = crowd(camera, 30_000, 0, seed=1)
    depth = camera.rotation[2] @ (scene.positions - camera.position[:, None])
    scene = scene.take(np.concatenate([np.flatnonzero(depth > NEAR), [np.argmax(depth > 0)]]))
    assert find_cameras([camera], scene)[0].near == NEAR


@pytest.mark.parametrize("near", [0.0, -1.0, np.nan, np.inf])
def test_a_camera_needs_a_minimum_depth_above_0(near):
    with pytest.raises(InvalidInput, match="expected a depth above 0"):
        replace(turned(2), near=near)


def test_a_camera_file_keeps_the_minimum_depth(tmp_path):
    cameras = [turned(3), replace(turned(4), near=0.01)]
    write_cameras(tmp_path / "cameras.json", cameras)
    assert [camera.near for camera in read_cameras(tmp_path / "cameras.json")] == [NEAR, 0.01]

"""Cameras between those of a capture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation
from splats import straight

from gs_codec.cameras.camera import Camera
from gs_codec.preparation.likely_views import cameras_between


def ring(angles) -> list[Camera]:
    """Cameras on a circle, looking at its centre; angles in degrees."""
    cameras = []
    for angle in angles:
        turn = Rotation.from_euler("y", angle, degrees=True).as_matrix().T
        cameras.append(
            replace(straight(40, 30), name=str(angle), rotation=turn, position=-3 * turn[2])
        )
    return cameras


def test_a_view_is_halfway_between_two():
    first, second = ring((10, 50))
    (found,) = cameras_between([first, replace(second, split="train")])
    (expected,) = ring((30,))
    np.testing.assert_allclose(found.rotation, expected.rotation, atol=1e-12)
    np.testing.assert_allclose(found.position, expected.position * np.cos(np.pi / 9))
    assert (found.name, found.split, found.fx) == ("10 to 50", None, first.fx)


def test_neighbours_are_near_and_look_the_same_way():
    names = {camera.name for camera in cameras_between(ring(range(0, 360, 10)))}
    assert {"0 to 10", "0 to 350", "170 to 180"} <= names
    assert 36 <= len(names) <= 3 * 36
    apart = [abs(int(a) - int(b)) for a, b in (name.split(" to ") for name in names)]
    assert max(min(turn, 360 - turn) for turn in apart) <= 20
    back = Rotation.from_euler("y", 180, degrees=True).as_matrix()
    first = ring((0,))[0]
    assert cameras_between([first, replace(first, rotation=back @ first.rotation)]) == []
    rolled = Rotation.from_euler("z", 170, degrees=True).as_matrix()
    assert cameras_between([first, replace(first, rotation=rolled @ first.rotation)]) == []


def test_few_cameras_and_equal_ones():
    first = ring((0,))[0]
    assert cameras_between([]) == cameras_between([first]) == []
    (found,) = cameras_between([first, first])
    np.testing.assert_allclose(found.rotation, first.rotation, atol=1e-12)
    np.testing.assert_allclose(found.position, first.position)

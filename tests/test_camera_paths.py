"""Camera paths of nerfstudio and poses of SuperSplat: conventions and invalid files."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from camera_files import (
    HUGE,
    MATRIX,
    POINT,
    POSITION,
    assert_refused,
    camera_path,
    damaged,
    pixel,
    pose,
    project,
    read_damaged,
    step,
)

from gs_codec.cameras.camera import Camera
from gs_codec.cameras.camera_files import read_cameras
from gs_codec.cameras.camera_paths import FIELD_OF_VIEW, HEIGHT, WIDTH


def write(path: Path, value: Any) -> Path:
    path.write_text(json.dumps(value))
    return path


# nerfstudio


def test_point_is_at_its_pixel(tmp_path):
    (camera,) = read_cameras(write(tmp_path / "a.json", camera_path()))
    # 200 + 200 * 1 / 4 and 150 - 200 * 2 / 4.
    np.testing.assert_allclose(pixel(camera, POINT), (250, 50), atol=1e-9)
    np.testing.assert_array_equal(camera.position, POSITION)
    assert (camera.name, camera.width, camera.height, camera.split) == ("00000", 400, 300, None)


def test_frames_are_numbered_and_have_their_own_field_of_view(tmp_path):
    steps = [step(fov=fov) for fov in (30.0, 60.0, 90.0)]
    cameras = read_cameras(write(tmp_path / "a.json", camera_path(*steps)))
    assert [camera.name for camera in cameras] == ["00000", "00001", "00002"]
    np.testing.assert_allclose(cameras[2].fx, 150)
    assert cameras[0].fx > cameras[1].fx == cameras[1].fy


BAD_STEPS: dict[str, tuple[Any, str]] = {
    "number": (3, "3, expected a frame"),
    "no pose": ({"fov": 50}, "no 'camera_to_world'"),
    "no field of view": ({"camera_to_world": MATRIX}, "no 'fov'"),
    "rows": (step(camera_to_world=[MATRIX[:4]] * 4), "camera_to_world .*16 numbers"),
    "short": (step(camera_to_world=MATRIX[:12]), "16 numbers"),
    "text": (step(camera_to_world=str(MATRIX)), "16 numbers"),
    "NaN": (step(camera_to_world=[math.nan] * 16), "camera_to_world nan"),
    "scaled": (step(camera_to_world=[1.5 * x for x in MATRIX]), "scaled"),
    "overflow": (step(camera_to_world=[1e307 * x for x in MATRIX]), "rotation contains"),
    "zeros": (step(camera_to_world=[0] * 16), "singular"),
    "field of view 0": (step(fov=0), "fov 0.0, expected above 0 and below 180"),
    "field of view 180": (step(fov=180), "fov 180.0"),
    "field of view of text": (step(fov="50"), "fov '50'"),
    "tiny field of view": (step(fov=1e-318), "fx inf"),
    "least field of view": (step(fov=5e-324), "fov 5e-324"),
}


@pytest.mark.parametrize("name", BAD_STEPS)
def test_bad_step_is_refused_in_one_line(name, tmp_path):
    bad, message = BAD_STEPS[name]
    path = write(tmp_path / "a.json", camera_path(step(), bad))
    assert_refused(path, f"camera_path 1: .*{message}")


BAD_PATHS: dict[str, tuple[dict[str, Any], str]] = {
    "number": (camera_path(camera_path=3), "camera_path 3, expected a list"),
    "empty": (camera_path(camera_path=[]), "no cameras"),
    "panorama": (camera_path(camera_type="equirectangular"), "camera_type 'equirectangular', exp"),
    "type of a list": (camera_path(camera_type=["perspective"]), "camera_type"),
    "width 0": (camera_path(render_width=0), "width 0"),
    "huge width": (camera_path(render_width=HUGE), "render_width inf"),
    "text": (camera_path(render_height="300"), "render_height '300'"),
    "no height": ({"camera_path": [step()], "render_width": 4}, "no 'render_height'"),
}


@pytest.mark.parametrize("name", BAD_PATHS)
def test_bad_path_is_refused_in_one_line(name, tmp_path):
    value, message = BAD_PATHS[name]
    assert_refused(write(tmp_path / "a.json", value), message)


# SuperSplat

#: SuperSplat's world has y up; a scene point (x, y, z) is at (-x, -y, z) in it.
TURN = np.array([-1, -1, 1])


def settings(*keyframes: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """The settings.json of an exported viewer, version 2."""
    values: dict[str, list[float]] = {"position": [], "target": [], "fov": []}
    for each in keyframes:
        values["position"] += each["position"]
        values["target"] += each["target"]
        values["fov"].append(each["fov"])
    times = [30 * i for i in range(len(keyframes))]
    track = {"name": "cameraAnim", "keyframes": {"times": times, "values": values}}
    whole = {"version": 2, "cameras": [], "animTracks": [track], "annotations": []}
    return whole | changes


def only(path: Path) -> Camera:
    (camera,) = read_cameras(path)
    return camera


@pytest.mark.parametrize("value", [project(pose()), settings(pose())], ids=["project", "settings"])
def test_point_is_where_supersplat_shows_it(value, tmp_path):
    camera = only(write(tmp_path / "a.json", value))
    # Its camera looks along -z with y up: the point (1, 2, 0) of its world is 5 away, 1 to the
    # right and 2 above. The field of view is along the longer side: 640 pixels at a distance of
    # 640.
    expected = (WIDTH / 2 + 640 * 1 / 5, HEIGHT / 2 - 640 * 2 / 5)
    np.testing.assert_allclose(pixel(camera, TURN * [1, 2, 0]), expected, atol=1e-9)
    np.testing.assert_array_equal(camera.position, [0, 0, 5])
    assert (camera.name, camera.width, camera.height) == ("00000", WIDTH, HEIGHT)


def test_cameras_that_supersplat_imported_come_back(tmp_path):
    """Its import of cameras.json keeps position and viewing direction (``loadCameraPoses``)."""
    rng = np.random.default_rng(6)
    poses, forwards, positions = [], [], []
    for _ in range(20):
        position, forward = rng.normal(size=(2, 3))
        forward /= np.linalg.norm(forward)
        ahead = position + 10 * forward
        poses.append(pose(position=(TURN * position).tolist(), target=(TURN * ahead).tolist()))
        forwards.append(forward)
        positions.append(position)
    cameras = read_cameras(write(tmp_path / "a.json", project(*poses)))
    for camera, position, forward in zip(cameras, positions, forwards, strict=True):
        np.testing.assert_allclose(camera.position, position, atol=1e-12)
        np.testing.assert_allclose(camera.rotation[2], forward, atol=1e-12)
        # Upright in its world: right is level, and down has a component along y, which is down.
        assert abs(camera.rotation[0, 1]) < 1e-12
        assert camera.rotation[1, 1] > 0


@pytest.mark.parametrize("up", [5.0, -5.0])
def test_straight_up_and_down_have_a_direction(up, tmp_path):
    camera = only(write(tmp_path / "a.json", project(pose(position=[0, up, 0]))))
    np.testing.assert_allclose(camera.rotation[2], [0, np.sign(up), 0], atol=1e-12)
    np.testing.assert_allclose(camera.rotation[0], [-1, 0, 0], atol=1e-12)


def test_first_view_comes_before_keyframes(tmp_path):
    first = {"initial": pose(position=[0, 0, 9])}
    value = settings(pose(), pose(position=[1, 2, 3]), cameras=[first])
    cameras = read_cameras(write(tmp_path / "a.json", value))
    assert [camera.position[2] for camera in cameras] == [9, 5, 3]
    assert [camera.name for camera in cameras] == ["00000", "00001", "00002"]


def test_field_of_view_is_the_poses_or_the_files_or_the_default(tmp_path):
    def degrees(value: Any) -> float:
        camera = only(write(tmp_path / "a.json", value))
        return pytest.approx(math.degrees(2 * math.atan(WIDTH / 2 / camera.fx)))

    bare = {"position": [0, 0, 5], "target": [0, 0, 0]}
    assert degrees(project(bare | {"fov": 40})) == 40
    assert degrees(project(bare)) == 75
    assert degrees(project(bare, camera={})) == FIELD_OF_VIEW
    # Tracks of settings version 1 have no field of view.
    values = {"position": [0, 0, 5], "target": [0, 0, 0]}
    track = {"keyframes": {"times": [0], "values": values}}
    assert degrees({"camera": {"fov": 50}, "animTracks": [track]}) == 50
    assert degrees({"animTracks": [track]}) == FIELD_OF_VIEW


BAD_POSES: dict[str, tuple[Any, str]] = {
    "no position": ({"target": [0, 0, 0]}, "no 'position'"),
    "no target": ({"position": [0, 0, 0]}, "no 'target'"),
    "two numbers": (pose(position=[1, 2]), "position .*3 numbers"),
    "object": (pose(target={"x": 1}), "target .*3 numbers"),
    "NaN": (pose(target=[0, math.nan, 0]), "target nan"),
    "far away": (pose(position=[0, 0, HUGE]), "position inf"),
    "same place": (pose(position=[0, 0, 0]), "are equal"),
    "overflow": (pose(position=[1e308, 0, 0], target=[-1e308, 0, 0]), "are equal"),
    "field of view 180": (pose(fov=180), "fov 180.0"),
    "field of view of null": (pose(fov=None), "fov None"),
}


@pytest.mark.parametrize("name", BAD_POSES)
def test_bad_pose_is_refused_in_one_line(name, tmp_path):
    bad, message = BAD_POSES[name]
    path = write(tmp_path / "a.json", project(pose(), bad))
    assert_refused(path, f"poseSets 0: pose 1: {message}|poseSets 0: pose 1: .*{message}")


def keyframes(**changes: Any) -> dict[str, Any]:
    values = {"position": [0, 0, 5], "target": [0, 0, 0], "fov": [60]} | changes
    return {"animTracks": [{"keyframes": {"times": [0], "values": values}}]}


BAD_SETTINGS: dict[str, tuple[Any, str]] = {
    "sets of a number": ({"poseSets": 3}, "poseSets 3, expected a list"),
    "set of a number": ({"poseSets": [3]}, "poseSets 0: 3, expected an object"),
    "set without poses": ({"poseSets": [{}]}, "poseSets 0: no 'poses'"),
    "pose of a number": ({"poseSets": [{"poses": [3]}]}, "pose 0: 3, expected a pose"),
    "no poses": ({"poseSets": [], "animTracks": []}, "no cameras"),
    "tracks of text": ({"animTracks": "a"}, "animTracks 'a', expected a list"),
    "no keyframes": ({"animTracks": [{}]}, "animTracks 0: no 'keyframes'"),
    "no values": ({"animTracks": [{"keyframes": {"times": []}}]}, "no 'values'"),
    "no times": ({"animTracks": [{"keyframes": {"values": {}}}]}, "no 'times'"),
    "too few positions": (keyframes(position=[0, 0]), "position .*expected 3 numbers"),
    "too many targets": (keyframes(target=[0] * 6), "target .*expected 3 numbers"),
    "too few fields of view": (keyframes(fov=[]), "fov .*expected 1 number"),
    "cameras of a number": ({"animTracks": [], "cameras": 1}, "cameras 1, expected a list"),
    "camera without a pose": ({"animTracks": [], "cameras": [{}]}, "cameras 0: no 'initial'"),
    "camera of a list": (
        {"animTracks": [], "cameras": [{"initial": []}]},
        r"cameras 0: \[\], expected a pose",
    ),
}


@pytest.mark.parametrize("name", BAD_SETTINGS)
def test_bad_settings_are_refused_in_one_line(name, tmp_path):
    value, message = BAD_SETTINGS[name]
    assert_refused(write(tmp_path / "a.json", value), message)


@pytest.mark.parametrize("kind", ["path", "project", "settings"])
def test_damaged_files_are_refused_or_give_valid_cameras_seed6(kind, tmp_path):
    rng = np.random.default_rng(6)
    value = {
        "path": camera_path(step(), step(fov=20)),
        "project": project(pose(), pose(position=[1, 2, 3])),
        "settings": settings(pose(), pose(position=[1, 2, 3])),
    }[kind]
    path = write(tmp_path / "a.json", value)
    good = path.read_bytes()
    read = 0
    for _ in range(300):
        path.write_bytes(damaged(good, rng))
        read += read_damaged(path)
    assert 0 < read < 300

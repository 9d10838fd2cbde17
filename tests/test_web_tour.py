"""Tours of a page: from view to view, or along a camera path."""

from __future__ import annotations

import json
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from web_pages import NODE, ROOT, Job, in_browser, open_pages, small_page

from gs_codec.cameras.camera import Camera, facing
from gs_codec.cameras.camera_files import write_cameras
from gs_codec.cameras.inria import as_entry
from gs_codec.cameras.keyframes import Keyframes, write_keyframes
from gs_codec.errors import InvalidInput
from gs_codec.files.tours import read_tour

in_node = pytest.mark.skipif(NODE is None, reason="needs Node")

#: A tour in steps of a quarter of a second: at each, the eye, the view and the focal length.
TOUR = """
import { Pose } from POSE;
import { Tour } from TOUR;
const { views, path, steps } = GIVEN;
const viewer = {
    views, view: 0, hasMoved: path !== null, middle: [0, 0, 0], passed(view) { this.view = view; },
    poseOf: (view) => Pose.of(views[view], [0, 0, 0]),
};
viewer.pose = viewer.poseOf(0);
const step = new Tour(viewer, path).begin();
const told = [];
for (let k = 0; k < steps; k++) {
    step(0.25);
    told.push([viewer.pose.eye, viewer.pose.turn, viewer.view, viewer.frame.fx]);
}
console.log(JSON.stringify(told));
"""


def toured(**given: object) -> list:
    page = ROOT / "viewer" / "web" / "page"
    script = TOUR.replace("GIVEN", json.dumps(given))
    for name in ("pose", "tour"):
        script = script.replace(name.upper(), json.dumps((page / f"{name}.js").as_uri()))
    done = subprocess.run(
        [str(NODE), "--input-type=module", "-e", script],
        capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    return json.loads(done.stdout)


def around(count: int, first: float = 0.0) -> list[Camera]:
    """Cameras on a circle around the origin, a twentieth of a turn apart."""
    cameras = []
    for k in range(count):
        angle = first + 0.1 * np.pi * k
        place = np.array([5 * np.sin(angle), 0.0, -5 * np.cos(angle)])
        turn = facing(-place / 5, np.array([0.0, -1.0, 0.0]))
        cameras.append(Camera(f"{k}", 60, 40, 50.0 + k, 50.0 + k, 30.0, 20.0, turn, place))
    return cameras


def entries(cameras: list[Camera]) -> list[dict]:
    return [as_entry(k, camera) for k, camera in enumerate(cameras)]


@in_node
def test_a_tour_stops_at_views_one_beside_the_other():
    order = [0, 3, 1, 4, 2]
    views = [around(5)[k] for k in order]
    told = toured(views=entries(views), path=None, steps=4 * (3 + 4 * 5))
    stops = [told[k] for k in range(11, len(told), 16)]
    assert [order[view] for *_, view, _ in stops] == [1, 2, 3, 4, 0, 1]
    for eye, turn, view, lens in stops:
        np.testing.assert_allclose(eye, views[view].position, atol=1e-9)
        np.testing.assert_allclose(turn, views[view].rotation, atol=1e-9)
        assert lens == pytest.approx(views[view].fx)
    # Between views, the camera goes around what it sees, and rests at each for a second.
    distances = [np.linalg.norm(eye) for eye, *_ in told]
    np.testing.assert_allclose(distances, 5, rtol=1e-6)
    for begin in range(11, len(told) - 5, 16):
        moves = [
            np.linalg.norm(np.subtract(told[begin + k + 1][0], told[begin + k][0]))
            for k in range(16)
        ]
        assert max(moves[12:]) < 1e-9
        assert 0 < moves[0] < 0.3 * max(moves)


@in_node
def test_a_tour_follows_a_camera_path_in_its_time(tmp_path):
    """A file with all frames: two seconds at 24 frames per second."""
    frames = around(49, 0.3)
    keyframes = Keyframes([frames[0], frames[-1]], [0.0, 2.0], 24)
    write_keyframes(tmp_path / "path.json", keyframes, frames)
    path = read_tour(tmp_path / "path.json")
    assert len(path) == 25
    assert [path[k]["time"] for k in (0, 1, -1)] == pytest.approx([0, 2 / 24, 2])
    told = toured(views=entries(around(2)), path=path, steps=12 + 8)[11:]
    for k in range(8):
        frame = frames[6 * k]
        np.testing.assert_allclose(told[k][0], frame.position, atol=1e-4)
        np.testing.assert_allclose(told[k][1], frame.rotation, atol=1e-4)
        assert told[k][3] == pytest.approx(frame.fx, rel=1e-4)


def test_keyframes_have_their_times_and_other_cameras_equal_ones(tmp_path):
    cameras = around(3)
    write_cameras(tmp_path / "cameras.json", cameras)
    assert [each["time"] for each in read_tour(tmp_path / "cameras.json")] == [0, 4, 8]
    keyframes = Keyframes(cameras, [0.0, 1.0, 5.0], 30)
    write_keyframes(tmp_path / "path.json", keyframes, cameras)
    told = read_tour(tmp_path / "path.json")
    assert [each["time"] for each in told] == [0, 1, 5]
    for each, camera in zip(told, cameras, strict=True):
        np.testing.assert_allclose(each["position"], camera.position, atol=1e-6)
        np.testing.assert_allclose(each["rotation"], camera.rotation.T, atol=1e-6)


def test_long_paths_have_fewer_poses(tmp_path):
    camera = around(1)[0]
    write_cameras(tmp_path / "cameras.json", [replace(camera, name=f"{k}") for k in range(2500)])
    told = read_tour(tmp_path / "cameras.json")
    assert len(told) <= 1001
    assert told[-1]["time"] == 4 * 2499


@pytest.mark.parametrize("text", ["[]", "{}", '{"camera_path": 3}', "[1]"])
def test_files_without_cameras_are_refused(tmp_path, text):
    (tmp_path / "path.json").write_text(text)
    with pytest.raises(InvalidInput, match=r"path\.json"):
        read_tour(tmp_path / "path.json")


@in_browser
def test_a_tour_goes_on_until_the_scene_is_touched(tmp_path):
    write_cameras(tmp_path / "path.json", around(3))
    url = small_page(tmp_path, tour=tmp_path / "path.json")
    checked = ("value", "document.getElementById('tour').checked")
    copied = "navigator.clipboard.writeText = async (text) => { globalThis.kept = text; }"
    job = Job(f"{url}#tour=1&view=1", [("until", checked[1]), checked, ("key", "c")], before=copied)
    job.steps += [("until", "globalThis.kept"), ("value", "globalThis.kept"), ("press",), checked]
    at_rest = "location.hash.includes('camera') && !location.hash.includes('tour')"
    job.steps += [("until", at_rest), ("value", "location.hash")]
    job.steps += [("key", "t"), checked, ("key", "o"), checked, ("key", "t"), ("key", "n"), checked]
    still = Job(f"{url}#tour=1", [("drawn",), checked, ("key", "t"), checked, ("key", "r")])
    still.before = "globalThis.matchMedia = () => ({ matches: true, addEventListener() {} })"
    told, resting = open_pages(job, still)
    for one in (told, resting):
        assert (one.state, one.errors) == ("ready", [])
    flags = [value for value in told.values if isinstance(value, bool)]
    assert flags == [True, False, True, False, False]
    assert "tour=1" in told.values[4]
    assert "tour" not in told.values[8]
    # Reduced motion: only if asked for.
    assert [value for value in resting.values if isinstance(value, bool)] == [False, True]

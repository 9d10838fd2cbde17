"""Films: their camera paths, content and files."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scenes import SHARED, random_scene

import gs_codec
from gs_codec.cameras.inria import as_camera
from gs_codec.codecs import encode_scene
from gs_codec.config import Config
from gs_codec.formats.cloud import to_cloud
from gs_codec.formats.ply.writer import write_ply
from viewer.pictures import film, reels
from viewer.pictures.screenshot import draw_request
from viewer.scenes.flight import CameraPath, evenly, read_path, write_path
from viewer.scenes.opened import Opened, open_scene
from viewer.scenes.pose import Pose, look_at, of_camera
from viewer.scenes.turntable import turntable
from viewer.scenes.view_request import Request
from viewer.scenes.viewpoints import Views, choose_views, given_views

ROOT = Path(__file__).parent.parent
UP = np.array([0.0, -1.0, 0.0])

#: Centre of the ball of Gaussians.
MIDDLE = np.array([1.0, 2.0, 3.0])


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """A scene, its encoding, and camera positions."""
    folder = tmp_path_factory.mktemp("film")
    scene = random_scene(300, 0, seed=310)
    write_ply(folder / "a.ply", scene)
    (folder / "b.egs").write_bytes(encode_scene(scene, Config("m"))[0])
    poses = [look_at(at(azimuth, 0.5, 6), np.zeros(3)) for azimuth in (0, 80, 170)]
    entries = [pose.camera(90, 60) | {"img_name": f"view{k}"} for k, pose in enumerate(poses)]
    (folder / "cameras.json").write_text(json.dumps(entries))
    return folder


def at(azimuth: float, height: float = 0.0, distance: float = 4.0) -> np.ndarray:
    """A position around the origin; azimuth in degrees, height in units of the distance."""
    angle = np.radians(azimuth)
    return distance * np.array([np.sin(angle), -height, -np.cos(angle)])


def views_of(poses: list[Pose]) -> Views:
    return given_views([as_camera(pose.camera(90, 60)) for pose in poses])


def azimuths(poses: list[Pose], middle: np.ndarray) -> np.ndarray:
    """Azimuths, in degrees, from pose to pose around the middle, unwrapped."""
    away = np.array([pose.position for pose in poses]) - middle
    return np.degrees(np.unwrap(np.arctan2(away[:, 0], -away[:, 2])))


@pytest.fixture(scope="module")
def ball() -> Opened:
    """Gaussians close around (1, 2, 3)."""
    scene = random_scene(400, 0, seed=311)
    rng = np.random.default_rng(311)
    positions = (rng.normal(0, 0.1, (3, 400)) + MIDDLE[:, None]).astype(np.float32)
    return Opened("ball", to_cloud(replace(scene, positions=positions)))


@pytest.fixture(scope="module")
def room() -> Opened:
    """Walls of a box of 8 x 3 x 8 around the origin."""
    scene = random_scene(4000, 0, seed=312)
    rng = np.random.default_rng(312)
    positions = rng.uniform(-1, 1, (3, 4000))
    axes = rng.integers(0, 3, 4000)
    positions[axes, np.arange(4000)] = rng.choice([-1, 1], 4000)
    positions *= [[4], [1.5], [4]]
    solid = np.full((1, 4000), 5, np.float32)
    return Opened(
        "room", to_cloud(replace(scene, positions=positions.astype(np.float32), opacity=solid))
    )


# Camera paths


def test_the_path_circles_the_middle_of_the_cameras_subject(ball):
    rng = np.random.default_rng(313)
    places = [MIDDLE + at(30 * k, 0.4 + 0.1 * rng.random(), 5 + rng.random()) for k in range(12)]
    cameras = [look_at(place, MIDDLE) for place in places]
    poses, told = turntable(ball, views_of(cameras), UP, None, 36)
    assert told == "once around"
    steps = np.diff(azimuths(poses, MIDDLE))
    np.testing.assert_allclose(np.abs(steps), 10, atol=1)
    assert len(set(np.sign(steps))) == 1
    places = np.array([pose.position for pose in poses])
    np.testing.assert_allclose(places[:, 1], places[0, 1], atol=1e-9)
    distances = np.linalg.norm(places - MIDDLE, axis=1)
    assert distances.min() > 4.9
    assert distances.max() < 7.5
    for pose in poses:
        pixels, depth = pose.project(MIDDLE[None], 90, 60)
        np.testing.assert_allclose(pixels[0], (45, 30), atol=2)
        assert depth[0] > 0
        assert pose.rotation[0] @ UP == pytest.approx(0, abs=1e-9)  # level horizon
        assert (pose.focal, pose.frame) == (cameras[0].focal, (90, 60))
    assert np.linalg.norm(places[0] - places[-1]) < 1.5  # the next pose would be the first


def test_the_path_begins_with_the_requested_view(ball):
    cameras = [look_at(MIDDLE + at(30 * k, 0.1 * k, 4 + k), MIDDLE) for k in range(12)]
    poses, _ = turntable(ball, views_of(cameras), UP, cameras[7], 20)
    np.testing.assert_allclose(poses[0].position, cameras[7].position, atol=0.1)
    np.testing.assert_allclose(poses[0].rotation, cameras[7].rotation, atol=0.05)


def test_few_cameras_are_ignored_and_one_is_enough(ball):
    for number in (1, 3):
        cameras = [look_at(MIDDLE + at(20 * k), MIDDLE) for k in range(number)]
        poses, told = turntable(ball, views_of(cameras), UP, None, 12)
        assert told == "once around"
        assert np.ptp(azimuths(poses, MIDDLE)) > 320


def test_a_view_from_straight_above_circles_too(ball):
    above = look_at(MIDDLE + 5 * UP, MIDDLE)
    poses, _ = turntable(ball, views_of([above]), UP, above, 12)
    assert np.ptp(azimuths(poses, MIDDLE)) > 320
    turns = [pose.rotation[0] @ poses[0].rotation[0] for pose in poses]
    assert min(turns) < -0.9


def test_the_path_looks_around_if_cameras_look_outward(room):
    places = [np.array([x, 0, z]) for x in (-3.5, 0, 3) for z in (-3, 0.2, 3.6)]
    cameras = [look_at(place, place + at(40 * k, 0.1)) for k, place in enumerate(places)]
    poses, told = turntable(room, views_of(cameras), UP, None, 24)
    assert told.startswith("a look around from inside")
    for pose in poses:
        np.testing.assert_allclose(pose.position, (0, 0, 0.2), atol=1e-9)  # farthest from walls
        assert abs(pose.rotation[2] @ UP) < 0.35
    level = np.array([pose.rotation[2][[0, 2]] for pose in poses])
    steps = np.degrees(np.diff(np.unwrap(np.arctan2(level[:, 0], level[:, 1]))))
    np.testing.assert_allclose(np.abs(steps), 15, atol=1e-6)


def test_drones_that_look_down_are_not_inside(room):
    places = [np.array([x, -9.0, z]) for x in (-7, 0, 7) for z in (-7, 0, 7)]
    cameras = [look_at(place, place + np.array([0.0, 9, 0.5])) for place in places]
    assert turntable(room, views_of(cameras), UP, None, 8)[1] == "once around"


def test_the_path_sways_within_cameras_on_one_side(ball):
    cameras = [
        look_at(MIDDLE + at(azimuth, height), MIDDLE)
        for azimuth in (200, 220, 240, 260) for height in (0.1, 0.3, 0.5)
    ]  # fmt: skip
    poses, told = turntable(ball, views_of(cameras), UP, None, 40)
    assert told.startswith("a sway")
    turned = azimuths(poses, MIDDLE) % 360
    assert 200 < turned.min() < 215
    assert 245 < turned.max() < 260
    heights = -np.array([pose.position[1] - MIDDLE[1] for pose in poses]) / 4
    assert 0.05 < heights.min() < heights.max() < 0.55
    moves = np.linalg.norm(np.diff([p.position for p in [*poses, poses[0]]], axis=0), axis=1)
    assert moves.max() < 3 * np.median(moves)  # a closed loop


def test_empty_scenes_have_a_path():
    empty = Opened("empty", to_cloud(random_scene(3, 0, seed=1).take(np.arange(0))))
    poses, _ = turntable(empty, Views(), UP, Pose(np.eye(3), np.zeros(3)), 8)
    assert np.isfinite([pose.position for pose in poses]).all()


@pytest.mark.thorough
@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared scenes are absent")
@pytest.mark.parametrize("name", ["bonsai", "mouse"])
def test_paths_of_real_scenes_follow_their_cameras(name):
    """A circle with the distance and height of the cameras, which shows what they see."""
    scene = open_scene(SHARED / name / "point_cloud.ply")
    views = given_views(gs_codec.read_cameras(SHARED / name / "cameras.json"))
    poses, told = turntable(scene, views, views.up_axis("cameras"), None, 6)
    assert told == "once around"
    places = np.array([camera.position for camera in views.cameras])
    near = [np.linalg.norm(places - pose.position, axis=1).min() for pose in poses]
    assert max(near) < 0.5 * np.ptp(places, axis=0).max()
    drawn = gs_codec.render(scene.cloud, [pose.camera(120, 80) for pose in poses])
    assert min(drawing.alpha.mean() for _, drawing in drawn) > 0.95


# Flights from pose to pose


def test_a_flight_passes_all_poses_at_even_speed():
    keys = [look_at(at(azimuth, 0.2), np.zeros(3)) for azimuth in (0, 30, 60, 100, 140)]
    keys = [replace(key, focal=(0.5 + 0.1 * k,) * 2) for k, key in enumerate(keys)]
    poses = evenly(keys).frames(200)
    assert len(poses) == 200
    places = np.array([pose.position for pose in poses])
    np.testing.assert_allclose(poses[0].rotation, keys[0].rotation, atol=1e-9)
    np.testing.assert_allclose(places[-1], keys[-1].position, atol=1e-9)
    for key in keys:
        nearest = poses[int(np.argmin(np.linalg.norm(places - key.position, axis=1)))]
        np.testing.assert_allclose(nearest.position, key.position, atol=0.05)
        np.testing.assert_allclose(nearest.rotation, key.rotation, atol=0.05)
        assert nearest.focal == pytest.approx(key.focal, abs=0.02)
    moves = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert moves.max() < 1.3 * moves.min()
    assert np.linalg.norm(np.diff(places, 2, axis=0), axis=1).max() < 0.1 * moves.max()


def test_a_flight_of_two_poses_is_straight_and_of_equal_poses_still():
    ends = look_at(at(0), np.zeros(3)), look_at(at(0, 0, 8), np.zeros(3))
    poses = evenly(ends).frames(5)
    np.testing.assert_allclose([-pose.position[2] for pose in poses], [4, 5, 6, 7, 8])
    same = evenly([ends[0]] * 3).frames(4)
    for pose in same:
        np.testing.assert_allclose(pose.position, ends[0].position)
        np.testing.assert_allclose(pose.rotation, ends[0].rotation, atol=1e-12)
    again = evenly([ends[0], ends[0], ends[1]]).frames(50)  # a pose saved twice
    assert np.isfinite([pose.position for pose in again]).all()


def test_times_set_the_speed_but_not_the_way_and_equal_poses_are_a_pause():
    keys = [look_at(at(azimuth, 0.2), np.zeros(3)) for azimuth in (0, 40, 40, 100)]
    path = CameraPath(tuple(keys), (0.0, 1.0, 3.0, 4.0))
    for key, when in zip(keys, path.times, strict=True):
        [pose] = path.at([when])
        np.testing.assert_allclose(pose.position, key.position, atol=1e-9)
        np.testing.assert_allclose(pose.rotation, key.rotation, atol=1e-9)
    for pose in path.at(np.linspace(1, 3, 9)):
        np.testing.assert_allclose(pose.position, keys[1].position, atol=1e-9)
    places = np.array([pose.position for pose in path.at(np.linspace(0, 4, 400))])
    moves = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert moves[95:102].max() < 0.2 * moves.max()  # it slows down before the pause
    other = replace(path, times=(0.0, 3.0, 3.5, 9.0))
    way = np.array([pose.position for pose in other.at(np.linspace(0, 9, 4000))])
    assert max(np.linalg.norm(way - place, axis=1).min() for place in places) < 0.01
    assert path.retimed(1, 7.0).times == pytest.approx((0, 3, 3, 4), abs=0.002)
    assert path.retimed(3, 7.0).times == (0, 1, 3, 7)
    assert path.with_keys(dict(zip((3.0, 1.0), keys[:2], strict=True))).times == (0, 2)
    assert path.with_keys({}).times == ()


def test_saved_paths_round_trip_and_their_frames_are_cameras(tmp_path):
    poses = [replace(look_at(at(30 * k, 0.3), np.ones(3)), frame=(90, 60)) for k in range(5)]
    path = CameraPath(tuple(poses), (0.0, 0.5, 1.0, 2.5, 3.0), 10)
    write_path(tmp_path / "path.json", path)
    again = read_path(tmp_path / "path.json")
    assert again.times == pytest.approx(path.times)
    assert again.fps == 10
    for pose, kept in zip(poses, again.poses, strict=True):
        np.testing.assert_allclose(kept.rotation, pose.rotation, atol=1e-12)
        np.testing.assert_allclose(kept.position, pose.position)
        np.testing.assert_allclose(kept.focal, pose.focal)
        assert (kept.frame, kept.shift) == (pose.frame, (0, 0))
    cameras = gs_codec.read_cameras(tmp_path / "path.json")
    assert len(cameras) == 31
    for camera, pose in zip(cameras, path.frames(), strict=True):
        np.testing.assert_allclose(camera.position, pose.position, atol=1e-5)
        np.testing.assert_allclose(camera.rotation, pose.rotation, atol=1e-6)
    with pytest.raises(gs_codec.GsCodecError, match="needs two poses"):
        write_path(tmp_path / "none.json", CameraPath())
    with pytest.raises(gs_codec.GsCodecError, match="10,000,000,001 frames, expected at most 99"):
        write_path(tmp_path / "none.json", replace(path, times=(0.0, 1.0, 2.0, 3.0, 1e9)))
    assert os.listdir(tmp_path) == ["path.json"]


# Frames


def frames(folder: Path) -> list[np.ndarray]:
    return [np.asarray(Image.open(path)).astype(int) for path in sorted(folder.iterdir())]


def test_frames_equal_screenshots_and_are_reproducible(files, tmp_path, run_viewer):
    asked = [files / "a.ply", files / "b.egs", "--cameras", files / "cameras.json", "--mode",
             "wipe", "--width", "97", "--height", "64", "--frames", "3"]  # fmt: skip
    for name in ("first", "again"):
        status, out, err = run_viewer(*asked, "--flythrough", tmp_path / name)
        assert (status, err) == (0, "")
        assert out == f"{tmp_path / name}: 3 frames, past 3 cameras\n"
    first, again = frames(tmp_path / "first"), frames(tmp_path / "again")
    assert sorted(os.listdir(tmp_path / "first")) == ["00000.png", "00001.png", "00002.png"]
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, other)
    assert (first[0] != first[1]).any()
    request = Request(
        files / "a.ply", files / "b.egs", str(files / "cameras.json"), mode="wipe", size=(97, 64)
    )
    for frame, view in ((first[0], 0), (first[2], 2)):
        shot = np.asarray(draw_request(replace(request, view=view))[0]).astype(int)
        assert np.mean(np.abs(frame - shot) > 2) < 0.01


@pytest.mark.thorough
def test_a_turntable_without_cameras_begins_with_the_first_picture(files, tmp_path, run_viewer):
    asked = files / "a.ply", "--width", "90", "--height", "64"
    assert run_viewer(*asked, "--turntable", tmp_path / "frames", "--frames", "4")[0] == 0
    assert run_viewer(*asked, "--screenshot", tmp_path / "shot.png")[0] == 0
    first, *others = frames(tmp_path / "frames")
    shot = np.asarray(Image.open(tmp_path / "shot.png")).astype(int)
    assert np.abs(first - shot).mean() < 3
    assert all(np.abs(other - shot).mean() > 2 * np.abs(first - shot).mean() for other in others)


def test_existing_frames_are_kept_without_overwrite(files, tmp_path, run_viewer):
    folder = tmp_path / "frames"
    folder.mkdir()  # an empty folder is accepted
    asked = files / "a.ply", "--width", "64", "--height", "64", "--turntable", folder
    assert run_viewer(*asked, "--frames", "5")[0] == 0
    inode = folder.stat().st_ino
    status, _, err = run_viewer(*asked, "--frames", "3")
    assert status == 2
    assert "not empty; choose another folder or pass --overwrite" in err
    assert len(os.listdir(folder)) == 5
    assert run_viewer(*asked, "--frames", "3", "--overwrite")[0] == 0
    assert sorted(os.listdir(folder)) == ["00000.png", "00001.png", "00002.png"]
    assert folder.stat().st_ino == inode
    (folder / "notes.txt").write_text("mine")
    status, _, err = run_viewer(*asked, "--frames", "2", "--overwrite")
    assert status == 2
    assert "contains 'notes.txt', expected only frames" in err
    assert len(os.listdir(folder)) == 4


@pytest.mark.parametrize("there", [False, True])
def test_a_failure_leaves_the_folder_as_it_was(files, tmp_path, monkeypatch, there):
    folder = tmp_path / "frames"
    if there:
        folder.mkdir()
        (folder / "00007.png").write_bytes(b"old")
    compose, left = film.compose, iter(range(2))

    def fails(*given, **named):
        if next(left, None) is None:
            raise gs_codec.InvalidInput("broken")
        return compose(*given, **named)

    monkeypatch.setattr(film, "compose", fails)
    request = Request(files / "a.ply", size=(64, 64))
    with pytest.raises(gs_codec.InvalidInput, match="broken"):
        film.write_film(request, film.Film("turntable", folder, 5, overwrite=True))
    assert os.listdir(tmp_path) == (["frames"] if there else [])
    assert not there or os.listdir(folder) == ["00007.png"]


def test_a_full_disk_is_one_line(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Image.Image, "save", full)
    with (
        pytest.raises(gs_codec.InvalidInput, match=r"frames: No space left on device$"),
        reels.open_reel(tmp_path / "frames", (64, 64), 24) as add,
    ):
        add(Image.new("RGB", (64, 64)))
    assert not os.listdir(tmp_path)


# Films


@pytest.fixture
def ffmpeg():
    return pytest.importorskip("imageio_ffmpeg", reason="the extra 'video' is not installed")


def pictures(count: int, size: tuple[int, int]) -> list[Image.Image]:
    """Smooth, colourful pictures, all different."""
    x, y = np.meshgrid(*(np.linspace(0, 1, side) for side in size))
    images = [np.stack([x, y, 0 * x + k / count], axis=-1) for k in range(count)]
    return [Image.fromarray(np.rint(255 * image).astype(np.uint8)) for image in images]


def write(path: Path, size: tuple[int, int], shown: Iterable[Image.Image]) -> None:
    with reels.open_reel(path, size, 12) as add:
        for frame in shown:
            add(frame)


def interrupted(shown: list[Image.Image]) -> Iterator[Image.Image]:
    yield from shown
    raise KeyboardInterrupt


def test_an_mp4_has_all_frames_in_correct_colours(tmp_path, ffmpeg):
    shown, size = pictures(6, (98, 66)), (98, 66)
    for name in ("film.mp4", "again.mp4"):
        write(tmp_path / name, size, shown)
    assert sorted(os.listdir(tmp_path)) == ["again.mp4", "film.mp4"]
    data = (tmp_path / "film.mp4").read_bytes()
    assert data == (tmp_path / "again.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")  # browsers can start playing early
    program = ffmpeg.get_ffmpeg_exe(), "-i", tmp_path / "film.mp4", "-f", "rawvideo"
    read = subprocess.run([*program, "-pix_fmt", "rgb24", "-"], capture_output=True, check=True)
    assert re.search(rb"Video: h264 .*yuv420p\(tv, bt709.* 98x66.* 12 fps", read.stderr)
    found = np.frombuffer(read.stdout, np.uint8).reshape(-1, 66, 98, 3).astype(int)
    assert len(found) == 6
    for frame, expected in zip(found, shown, strict=True):
        assert np.abs(frame - np.asarray(expected)).mean() < 3


def test_the_command_writes_a_film(files, tmp_path, run_viewer, ffmpeg):
    out = tmp_path / "out.mp4"
    asked = files / "a.ply", "--width", "64", "--height", "64", "--turntable", out, "--frames", 5
    status, said, err = run_viewer(*asked, "--fps", 5)
    assert (status, said, err) == (0, f"{out}: 5 frames, once around\n", "")
    assert ffmpeg.count_frames_and_secs(str(out)) == (5, pytest.approx(1, abs=0.01))
    status, _, err = run_viewer(*asked)
    assert status == 2
    assert f"{out}: already exists; choose another name or pass --overwrite" in err
    assert run_viewer(*asked, "--overwrite")[0] == 0


def test_a_failed_film_leaves_nothing_and_reports_the_reason(tmp_path, ffmpeg, monkeypatch):
    out = tmp_path / "out.mp4"
    out.write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt):
        write(out, (64, 64), interrupted(pictures(1, (64, 64))))
    script = tmp_path / "ffmpeg"
    for line, said in (
        ("av_write: No space left on device", r"out.mp4: No space left on device$"),
        ("Unknown encoder 'libx264'", r"ffmpeg ended with status 3: Unknown encoder 'libx264'$"),
    ):
        script.write_text(f'#!/bin/sh\nhead -c 100 >/dev/null\necho "{line}" >&2\nexit 3\n')
        script.chmod(0o755)
        monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(script))
        with pytest.raises(gs_codec.GsCodecError, match=said):
            write(out, (512, 512), pictures(4, (512, 512)))
    assert out.read_bytes() == b"old"
    assert sorted(os.listdir(tmp_path)) == ["ffmpeg", "out.mp4"]


@pytest.mark.thorough
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="signals of POSIX")
@pytest.mark.parametrize("name", ["frames", "out.mp4"])
def test_ctrl_c_leaves_nothing(files, tmp_path, name, request):
    if name.endswith("mp4"):
        request.getfixturevalue("ffmpeg")
    code = "import sys; sys.argv[0] = 'gs-viewer'; from viewer.main import main; main()"
    asked = files / "a.ply", "--turntable", tmp_path / name, "--frames", "9999"
    process = subprocess.Popen(
        [sys.executable, "-c", code, *map(str, asked)],
        stderr=subprocess.PIPE, text=True, cwd=ROOT, env=os.environ | {"DISPLAY": ""},
    )  # fmt: skip
    for _ in range(1200):
        if os.listdir(tmp_path) or process.poll() is not None:
            break
        time.sleep(0.05)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    err = process.communicate(timeout=60)[1]
    assert process.returncode == 130
    assert err.splitlines()[-1] == "gs-viewer: interrupted"
    assert not os.listdir(tmp_path)


# Refusals


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--turntable", "out.gif"], "out.gif: expected .mp4, or a folder"),
        (["--turntable", "out.mp4", "--width", "321"], "size 321x800, expected even sides"),
        (["--turntable", "none/out"], "none/out: no directory 'none'"),
        (["--turntable", "none/out.mp4"], "none/out.mp4: no directory 'none'"),
        (["--turntable", "out", "--fps", "10"], "fps: has no effect on a folder of frames"),
        (["--turntable", "out.mp4", "--fps", "0"], "fps 0: expected 1 to 120"),
        (["--turntable", "out", "--frames", "1"], "frames 1: expected 2 to 99999"),
        (
            ["--turntable", "out", "--flythrough", "o"],
            "turntable and flythrough cannot be combined",
        ),
        (
            ["--turntable", "out", "--screenshot", "o"],
            "screenshot and turntable cannot be combined",
        ),
        (["--flythrough", "out"], "flythrough: needs cameras from a file"),
        (["--flythrough", "out", "--cameras", "auto"], "flythrough: needs cameras from a file"),
        (["--flythrough", "out", "--cameras", "c", "--view", "1"], "view: has no effect on a fly"),
        (["--flythrough", "out", "--cameras", "c", "--up", "z"], "up: has no effect on a fly"),
        (["--turntable", "out", "--cameras", "c", "--gt-images", "."], "gt-images: has no effect"),
        (["--frames", "5"], "frames: needs --turntable or --flythrough"),
        (["--fps", "5", "--screenshot", "x.png"], "fps: needs --turntable or --flythrough"),
        (["--overwrite"], "overwrite: needs --screenshot, --turntable or --flythrough"),
    ],
)
def test_invalid_options_are_one_line(arguments, said, files, tmp_path, run_viewer, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "ffmpeg")
    status, _, err = run_viewer(files / "a.ply", *arguments)
    assert status == 2
    assert err.startswith("gs-viewer: error: ")
    assert said in err
    assert len(err.splitlines()) == 1
    assert not os.listdir(tmp_path)


def test_a_file_in_place_of_a_folder_is_kept(files, tmp_path, run_viewer):
    (tmp_path / "out").write_text("mine")
    status, _, err = run_viewer(files / "a.ply", "--turntable", tmp_path / "out", "--overwrite")
    assert (status, err.count("\n")) == (2, 1)
    assert "out: exists and is not a folder, expected .mp4 or a folder" in err
    assert (tmp_path / "out").read_text() == "mine"


def test_a_film_needs_a_scene_and_a_flight_two_cameras(files, tmp_path, run_viewer):
    status, _, err = run_viewer("--turntable", tmp_path / "out")
    assert (status, err) == (2, "gs-viewer: error: turntable: no scene to draw\n")
    poses = json.loads((files / "cameras.json").read_text())
    (tmp_path / "one.json").write_text(json.dumps(poses[:1]))
    cameras = "--cameras", tmp_path / "one.json"
    status, _, err = run_viewer(files / "a.ply", *cameras, "--flythrough", tmp_path / "out")
    assert (status, err) == (2, "gs-viewer: error: flythrough: one camera, expected at least two\n")
    assert os.listdir(tmp_path) == ["one.json"]


def test_without_imageio_ffmpeg_the_extra_is_named(files, tmp_path, run_viewer, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    status, _, err = run_viewer(files / "a.ply", "--turntable", tmp_path / "out.mp4")
    assert status == 2
    assert "pip install 'gs-codec[video]', or give a folder for PNG frames" in err
    assert len(err.splitlines()) == 1


def test_paths_without_cameras_begin_at_the_overview(files):
    scene = open_scene(files / "a.ply")
    views = choose_views(scene)
    overview = of_camera(views.cameras[0])
    poses, _ = turntable(scene, views, views.up_axis("cameras"), overview, 8)
    assert np.linalg.norm(poses[0].position - overview.position) < 0.1

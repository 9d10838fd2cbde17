"""Cameras written as cameras.json are equal when read again, by Python and by `render`."""

from __future__ import annotations

import json
import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from camera_files import (
    SHARED,
    Image,
    Intrinsics,
    camera_path,
    frame,
    inria_entry,
    project,
    random_model,
    write_json,
    write_model,
    write_transforms,
)
from camera_files import pose as supersplat_pose
from scenes import random_scene, shared_scene_path

import gs_codec
from gs_codec.cameras.camera import Camera
from gs_codec.cameras.camera_files import read_cameras, write_cameras
from gs_codec.errors import InvalidInput
from gs_codec.views.estimate import auto_cameras
from gs_codec.views.find import find_cameras


def assert_same(first: list[Camera], second: list[Camera]) -> None:
    """Check that all fields except the lens are bit-exact."""
    assert len(first) == len(second)
    for a, b in zip(first, second, strict=True):
        for field in fields(Camera):
            if field.name != "lens":
                np.testing.assert_array_equal(getattr(a, field.name), getattr(b, field.name))
        # Kernels may round differently depending on the memory layout of an array.
        assert a.rotation.flags.c_contiguous == b.rotation.flags.c_contiguous


def rotated(seed: int) -> np.ndarray:
    axes, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return axes * np.linalg.det(axes)


def every_source(folder: Path) -> dict[str, Path]:
    turned = [[*map(float, row), 1 / 3] for row in rotated(3)]
    lens = Intrinsics(1, "OPENCV", 80, 60, (50.0, 52.0, 38.0, 31.0, -0.12, 0.03, 0.002, -0.001))
    (folder / "path.json").write_text(json.dumps(camera_path()))
    (folder / "poses.json").write_text(json.dumps(project(supersplat_pose(position=[1, 0.1, 7]))))
    images, cameras = random_model(seed=4)
    return {
        "INRIA": write_json(folder / "a.json", inria_entry(cx=1 / 3, cy=7, split="test")),
        "COLMAP": write_model(folder / "model", ".bin", images, cameras),
        "lens": write_model(folder / "lens", ".txt", [Image(), Image("b.jpg")], [lens]),
        "transforms": write_transforms(
            folder / "t.json", frame("été/a", transform_matrix=turned), **SHARED
        ),
        "camera path": folder / "path.json",
        "SuperSplat": folder / "poses.json",
    }


@pytest.mark.parametrize("width", [None, 37])
@pytest.mark.parametrize(
    "source", ["INRIA", "COLMAP", "lens", "transforms", "camera path", "SuperSplat"]
)
def test_cameras_of_any_source_round_trip_exactly(source, width, tmp_path):
    cameras = find_cameras(every_source(tmp_path)[source], random_scene(1), width=width)
    write_cameras(tmp_path / "out.json", cameras)
    again = read_cameras(tmp_path / "out.json")
    assert_same(cameras, again)
    first = (tmp_path / "out.json").read_bytes()
    write_cameras(tmp_path / "out.json", again, overwrite=True)
    assert (tmp_path / "out.json").read_bytes() == first


def test_auto_cameras_round_trip_exactly(tmp_path):
    cameras = auto_cameras(random_scene(400, 0, seed=5), 6)
    write_cameras(tmp_path / "auto.json", cameras)
    assert_same(cameras, read_cameras(tmp_path / "auto.json"))


def test_cameras_of_the_trainer_round_trip(tmp_path):
    cameras = read_cameras(shared_scene_path("bonsai/cameras.json"))
    write_cameras(tmp_path / "out.json", cameras)
    assert_same(cameras, read_cameras(tmp_path / "out.json"))


def test_rotations_of_any_rounding_round_trip_exactly_seed7(tmp_path):
    rng = np.random.default_rng(7)
    cameras = []
    for i in range(200):
        rotation = rotated(i) * (1 + rng.normal() * 10.0 ** rng.uniform(-17, -4))
        position = rng.normal(size=3) * 10.0 ** rng.uniform(-300, 300)
        cameras.append(Camera(f"{i}", 8, 6, math.pi, 1 / 7, 4.1, -3e-9, rotation, position))
    write_cameras(tmp_path / "out.json", cameras)
    assert_same(cameras, read_cameras(tmp_path / "out.json"))


def test_layout_is_the_trainers(tmp_path):
    [camera] = read_cameras(write_json(tmp_path / "a.json", inria_entry(split="train")))
    write_cameras(tmp_path / "out.json", [camera])
    [entry] = json.loads((tmp_path / "out.json").read_text())
    assert entry == inria_entry(split="train") | {"cx": 200.0, "cy": 150.0}
    assert list(entry)[:8] == [
        *("id", "img_name", "width", "height", "position", "rotation", "fy", "fx"),
    ]
    write_cameras(tmp_path / "out.json", [replace(camera, split=None)], overwrite=True)
    assert "split" not in (tmp_path / "out.json").read_text()


def test_lost_lenses_are_reported(tmp_path, caplog):
    cameras = read_cameras(every_source(tmp_path)["lens"])
    path = tmp_path / "out.json"
    write_cameras(path, cameras)
    assert caplog.messages == [
        f"{path}: lens distortion of 2 cameras not written: use undistorted images"
    ]
    assert [camera.lens for camera in read_cameras(path)] == [None, None]
    caplog.clear()
    write_cameras(path, read_cameras(path), overwrite=True)
    assert not caplog.messages


def view(name: str) -> Camera:
    return Camera(name, 4, 3, 4.0, 4.0, 2.0, 1.5, np.eye(3), np.zeros(3))


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ([], "no cameras"),
        (["a", ""], "camera 1: name of 0 characters"),
        (["n" * 1025], "camera 0: name of 1,025 characters"),
        (["a\nb"], "camera 0: control characters in name"),
        (["a\ud800"], "camera 0: control characters in name"),
    ],
)
def test_unreadable_cameras_are_not_written(names, message, tmp_path):
    with pytest.raises(InvalidInput, match=message):
        write_cameras(tmp_path / "out.json", [view(name) for name in names])
    assert not list(tmp_path.iterdir())


def test_file_too_large_to_be_read_is_not_written(tmp_path, monkeypatch):
    monkeypatch.setattr("gs_codec.cameras.camera_files.MAX_BYTES", 300)
    write_cameras(tmp_path / "a.json", [view("a")])
    with pytest.raises(InvalidInput, match="bytes of cameras, expected at most 300"):
        write_cameras(tmp_path / "b.json", [view("a"), view("b")])
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


def test_python_refuses_existing_files_by_default(tmp_path):
    path = tmp_path / "out.json"
    gs_codec.write_cameras(path, [view("a")])
    gs_codec.write_cameras(path, (view(name) for name in "bc"), overwrite=True)
    with pytest.raises(InvalidInput, match="exists"):
        gs_codec.write_cameras(path, [view("d")])
    assert [camera.name for camera in gs_codec.read_cameras(path)] == ["b", "c"]
    with pytest.raises(InvalidInput, match="no directory"):
        gs_codec.write_cameras(tmp_path / "none" / "out.json", [view("a")])


# The command


@pytest.mark.thorough
@pytest.mark.usefixtures("few_cameras")
def test_render_writes_cameras(folder):
    result = folder.run("render", "scene.ply", "--cameras", "auto", "--out", "auto.JSON")
    assert (result.status, result.err) == (0, "")
    assert result.out == "auto.JSON: 24 cameras\n"
    cameras = gs_codec.read_cameras("auto.JSON")
    assert_same(cameras, gs_codec.render("scene.ply").cameras)
    views = []
    for source, out in (("auto", "first"), ("auto.JSON", "second")):
        options = ("--cameras", source, "--out", out, "--width", "24")
        assert folder.run("render", "scene.ply", *options).status == 0
        views.append({path.name: path.read_bytes() for path in Path(out).iterdir()})
    assert views[0] == views[1]
    assert len(views[0]) == 24


def test_render_converts_cameras_with_their_split_and_width(folder):
    names = {f"{i}": "test" if i % 3 == 0 else "train" for i in range(7)}
    entries = [inria_entry(img_name=name, split=split) for name, split in names.items()]
    write_json(Path("seven.json"), *entries)
    options = ("--cameras", "seven.json", "--out", "out.json", "--split", "test", "--width", "200")
    assert folder.run("render", "scene.ply", *options).status == 0
    cameras = read_cameras("out.json")
    assert [(camera.name, camera.split) for camera in cameras] == [(n, "test") for n in "036"]
    assert {(camera.width, camera.height, camera.fx) for camera in cameras} == {(200, 150, 50.0)}


def test_render_replaces_cameras_only_with_overwrite(folder):
    Path("out.json").write_text("old")
    command = ("render", "scene.ply", "--cameras", "cameras.json", "--out", "out.json")
    assert "out.json: already exists" in folder.refuse(*command)
    assert folder.run(*command, "--overwrite").status == 0
    assert len(read_cameras("out.json")) == 1
    Path("folder.json").mkdir()
    assert "folder.json: a directory" in folder.refuse(*command[:5], "folder.json")


@pytest.mark.parametrize(
    "option", ["--background white", "--device cpu", "--antialiased", "--plain"]
)
def test_render_refuses_options_without_effect_on_cameras(option, folder):
    command = ("render", "scene.ply", "--cameras", "cameras.json", "--out", "out.json")
    line = folder.refuse(*command, *option.split())
    assert "has no effect with --out out.json, which writes only cameras" in line


def test_bad_cameras_are_one_line(folder):
    Path("bad.json").write_text('{"frames": [{}]}')
    line = folder.refuse("render", "scene.ply", "--cameras", "bad.json", "--out", "out.json")
    assert "bad.json: frame 0: no 'file_path'" in line

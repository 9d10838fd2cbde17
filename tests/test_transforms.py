"""transforms.json of nerfstudio, instant-ngp and Blender's datasets: conventions, invalid files."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from camera_files import (
    HUGE,
    POINT,
    POSE,
    POSITION,
    SHARED,
    assert_refused,
    damaged,
    frame,
    inria_entry,
    pixel,
    read_damaged,
    write_json,
    write_model,
    write_transforms,
)
from PIL import Image

from gs_codec.cameras.camera_files import read_cameras
from gs_codec.cameras.image_files import find_image, seek_image
from gs_codec.errors import InvalidInput


def write_image(path: Path, width: int = 400, height: int = 300) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (width, height)).save(path)
    return path


# What is where


@pytest.mark.parametrize("name", ["transforms.json", "any name.JSON"])
def test_point_is_at_its_pixel(name, tmp_path):
    (camera,) = read_cameras(write_transforms(tmp_path / name, **SHARED))
    np.testing.assert_allclose(pixel(camera, POINT), (215, 60), atol=1e-12)
    np.testing.assert_array_equal(camera.position, POSITION)
    assert (camera.name, camera.width, camera.height) == ("images/a.jpg", 400, 300)
    assert (camera.split, camera.lens) == (None, None)


def test_intrinsics_may_be_each_frames_own(tmp_path):
    own = {"fl_x": 50.0, "fl_y": 50.0, "w": 200.0, "h": 100, "cx": 90, "cy": 60}
    path = write_transforms(tmp_path / "t.json", frame("a"), frame("b", **own), **SHARED)
    a, b = read_cameras(path)
    assert (a.fx, a.fy, a.width, a.height, a.cx, a.cy) == (100, 200, 400, 300, 190, 160)
    assert (b.fx, b.fy, b.width, b.height, b.cx, b.cy) == (50, 50, 200, 100, 90, 60)


def test_defaults_are_the_middle_and_square_pixels(tmp_path):
    (camera,) = read_cameras(write_transforms(tmp_path / "t.json", fl_x=100, w=400, h=300))
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (100, 100, 200, 150)


def test_fields_of_view_are_in_radians(tmp_path):
    angle = 2 * math.atan(2)
    path = write_transforms(tmp_path / "t.json", camera_angle_x=angle, w=400, h=300)
    (camera,) = read_cameras(path)
    assert (camera.fx, camera.fy) == (pytest.approx(100), camera.fx)
    write_transforms(path, camera_angle_x=angle, camera_angle_y=2 * math.atan(3), w=400, h=300)
    assert read_cameras(path)[0].fy == pytest.approx(50)
    # instant-ngp writes both; the focal length has more digits.
    write_transforms(path, camera_angle_x=1.0, camera_angle_y=1.0, **SHARED)
    (camera,) = read_cameras(path)
    assert (camera.fx, camera.fy) == (100, 200)


def test_rows_of_a_pose_may_be_three(tmp_path):
    path = write_transforms(tmp_path / "t.json", frame(transform_matrix=POSE[:3]), **SHARED)
    np.testing.assert_allclose(pixel(read_cameras(path)[0], POINT), (215, 60), atol=1e-12)


def test_order_is_the_files_and_names_lose_their_dot(tmp_path):
    names = ["./images/c.png", "images/a.png", ".//images/d.png", "././b"]
    path = write_transforms(tmp_path / "t.json", *map(frame, names), **SHARED)
    read = [camera.name for camera in read_cameras(path)]
    assert read == ["images/c.png", "images/a.png", "images/d.png", "b"]


def test_splits_are_those_of_the_file(tmp_path):
    path = write_transforms(
        tmp_path / "t.json",
        *map(frame, ["./a", "b", "c", "d"]),
        train_filenames=["a"],
        val_filenames=["./b"],
        test_filenames=["c", "gone"],
        **SHARED,
    )
    assert [camera.split for camera in read_cameras(path)] == ["train", "test", "test", None]


# Distortion


def coefficients_of(tmp_path: Path, **shared: Any) -> tuple[bool, tuple[float, ...]] | None:
    path = write_transforms(tmp_path / "t.json", **SHARED, **shared)
    lens = read_cameras(path)[0].lens
    return lens and (lens.fisheye, lens.coefficients)


def test_coefficients_by_the_model(tmp_path):
    some = {"k1": 0.01, "k2": -0.002, "p1": 0.0003, "p2": 0.0004}
    expected = (False, (0.01, -0.002, 0.0003, 0.0004, 0.0, 0.0, 0.0, 0.0))
    for model in ("OPENCV", "PINHOLE", "SIMPLE_RADIAL"):  # all the same for nerfstudio
        assert coefficients_of(tmp_path, camera_model=model, **some) == expected
    assert coefficients_of(tmp_path, is_fisheye=False, **some) == expected
    assert coefficients_of(tmp_path, k3=0.005)[1][4] == 0.005
    four = {"k1": 0.01, "k2": 0.002, "k3": 0.0003, "k4": 0.0004}
    expected = (True, (0.01, 0.002, 0.0003, 0.0004))
    assert coefficients_of(tmp_path, camera_model="OPENCV_FISHEYE", **four) == expected
    assert coefficients_of(tmp_path, is_fisheye=True, **four) == expected
    assert coefficients_of(tmp_path, camera_model="OPENCV_FISHEYE") == (True, (0.0,) * 4)


def test_k4_is_of_the_denominator_with_k5_or_k6_and_else_of_the_numerator(tmp_path):
    rational = {"k1": 0.01, "k2": 0.02, "k3": 0.03, "k4": 0.04, "k5": 0.05, "k6": 0.06}
    expected = (0.01, 0.02, 0.0, 0.0, 0.03, 0.04, 0.05, 0.06)
    path = write_transforms(tmp_path / "t.json", **SHARED, **rational)
    assert (read_cameras(path)[0].lens.coefficients, read_cameras(path)[0].lens.r8) == (expected, 0)
    # RealityCapture's coefficients, which nerfstudio writes as text.
    table = {"k1": "0.01", "k2": "-2e-3", "k3": "0", "k4": " 0.004", "p1": "0.0", "p2": "-0"}
    lens = read_cameras(write_transforms(path, **SHARED, **table))[0].lens
    assert (lens.coefficients, lens.r8) == ((0.01, -0.002, 0, 0, 0, 0, 0, 0), 0.004)
    zeros = dict.fromkeys(table, "0.0")
    assert read_cameras(write_transforms(path, **SHARED, **zeros))[0].lens is None


@pytest.mark.parametrize("text", ["", "nan", "inf", "1e999", "1_0", "0x1", "1" * 99, "٣"])
def test_text_that_is_no_coefficient_is_refused(text, tmp_path):
    path = write_transforms(tmp_path / "t.json", **SHARED, k4=text)
    assert_refused(path, "frame 0: k4 .*expected a finite number")


def test_zeros_are_no_distortion(tmp_path):
    zeros = dict.fromkeys(("k1", "k2", "k3", "k4", "p1", "p2"), 0)
    assert coefficients_of(tmp_path, camera_model="OPENCV", **zeros) is None
    assert coefficients_of(tmp_path, is_fisheye=True, **zeros) is None


def test_distorted_camera_is_that_of_the_same_colmap_model(tmp_path):
    from camera_files import Intrinsics

    parameters = (500.0, 520.0, 380.0, 310.0, -0.12, 0.03, 0.002, -0.001)
    model = write_model(
        tmp_path / "m", ".bin", cameras=[Intrinsics(1, "OPENCV", 800, 600, parameters)]
    )
    names = ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2")
    shared = dict(zip(names, parameters, strict=True))
    path = write_transforms(tmp_path / "t.json", frame("a.jpg"), w=800, h=600, **shared)
    (first,), (second,) = read_cameras(model), read_cameras(path)
    assert first.lens == second.lens
    np.testing.assert_allclose(first.rotation, second.rotation, atol=1e-15)
    np.testing.assert_allclose(first.position, second.position, atol=1e-15)
    assert (first.width, first.cx) == (second.width, second.cx)


# Sizes from images


def test_size_is_that_of_the_image_beside_the_file(tmp_path):
    write_image(tmp_path / "train" / "r_0.png", 80, 60)
    path = tmp_path / "transforms_train.json"
    write_transforms(path, frame("./train/r_0"), camera_angle_x=2 * math.atan(2))
    (camera,) = read_cameras(path)
    assert (camera.name, camera.width, camera.height) == ("train/r_0", 80, 60)
    assert (camera.fx, camera.fy) == (pytest.approx(20), camera.fx)
    assert (camera.cx, camera.cy) == (40, 30)
    assert find_image(tmp_path, camera.name) == tmp_path / "train" / "r_0.png"


def test_size_of_a_frame_is_that_of_its_own_image(tmp_path):
    write_image(tmp_path / "a.jpg", 80, 60)
    write_image(tmp_path / "b.jpg", 60, 80)
    path = write_transforms(tmp_path / "t.json", frame("a.jpg"), frame("b"), fl_x=50)
    assert [camera.width for camera in read_cameras(path)] == [80, 60]


def test_without_size_and_image_both_are_named(tmp_path):
    path = write_transforms(tmp_path / "t.json", frame("train/r_0"), camera_angle_x=1.0)
    assert_refused(path, "frame 0: no w and h, and no image 'train/r_0' next to the file")


def test_broken_image_is_refused(tmp_path):
    (tmp_path / "a.png").write_bytes(b"no image")
    path = write_transforms(tmp_path / "t.json", frame("a"), camera_angle_x=1.0)
    with pytest.raises(InvalidInput, match=r"a\.png: not an image"):
        read_cameras(path)


@pytest.mark.parametrize("name", ["../secret", "/etc/secret", "a/../../secret"])
def test_sizes_are_not_taken_from_elsewhere(name, tmp_path):
    write_image(tmp_path / "secret.png")
    path = write_transforms(tmp_path / "data" / "t.json", frame(name), camera_angle_x=1.0)
    with pytest.raises(InvalidInput, match="expected a name inside the folder"):
        read_cameras(path)


def test_images_are_found_in_the_folder_that_their_names_begin_with(tmp_path):
    paths = [write_image(tmp_path / folder / "a.jpg") for folder in ("images", "images_4")]
    assert find_image(tmp_path, "images/a.jpg") == paths[0]
    assert find_image(tmp_path / "images", "images/a.png") == paths[0]
    assert find_image(tmp_path / "images_4", "images/a.jpg") == paths[1]
    write_image(tmp_path / "train" / "r_0.png")
    for folder in ("images", "train"):
        with pytest.raises(InvalidInput, match="no image 'test/r_0'"):
            find_image(tmp_path / folder, "test/r_0")


@pytest.mark.parametrize("name", [".\\images\\a.jpg", "images\\a.png", "./images\\a.jpg"])
def test_names_written_on_windows_are_found_everywhere(name, tmp_path):
    image = write_image(tmp_path / "images" / "a.jpg", 80, 60)
    (camera,) = read_cameras(write_transforms(tmp_path / "t.json", frame(name), camera_angle_x=1.0))
    assert (camera.width, camera.height) == (80, 60)
    assert find_image(tmp_path, camera.name) == find_image(image.parent, camera.name) == image
    with pytest.raises(InvalidInput, match="expected a name inside the folder"):
        find_image(tmp_path, "\\images\\a.jpg")


@pytest.mark.parametrize(
    "name",
    ["/home/me/images/a.jpg", "../../images/a.jpg", "C:\\my data\\images\\a.jpg", "b/images/a"],
)
def test_images_are_found_in_a_folder_that_their_names_lead_through(name, tmp_path):
    image = write_image(tmp_path / "images" / "a.jpg")
    small = write_image(tmp_path / "images_4" / "a.jpg")
    assert find_image(image.parent, name) == image
    assert find_image(small.parent, name) == small
    # A camera without a photograph is no error for those who seek.
    assert seek_image(image.parent, f"{name}/z") is None


def test_images_outside_the_folder_are_not_found(tmp_path):
    folder = tmp_path / "images"
    write_image(folder / "a.jpg")
    secret = write_image(tmp_path / "secret.png")
    for name in (f"images/{secret}", f"images//{secret}", f"images/./{secret}"):
        with pytest.raises(InvalidInput, match="no image"):
            find_image(folder, name)
    with pytest.raises(InvalidInput, match="expected a name inside the folder"):
        find_image(folder, "images/../secret.png")
    with pytest.raises(InvalidInput, match="expected a name inside the folder"):
        find_image(folder, f"/images/../{secret.name}")


# Which files


@pytest.mark.parametrize(
    ("ending", "split"),
    [("train", "train"), ("test", "test"), ("val", "test"), ("TRAIN", "train"), ("all", None)],
)
def test_split_of_blenders_files_is_in_their_names(ending, split, tmp_path):
    path = write_transforms(tmp_path / f"transforms_{ending}.json", **SHARED)
    assert read_cameras(path)[0].split == split


def test_folder_of_blenders_files_has_both_splits(tmp_path):
    for word in ("train", "test", "val"):
        name = f"./{word}/r_0"
        write_transforms(tmp_path / f"transforms_{word}.json", frame(name), **SHARED)
    cameras = read_cameras(tmp_path)
    assert [(camera.name, camera.split) for camera in cameras] == [
        ("train/r_0", "train"),
        ("test/r_0", "test"),
    ]
    (tmp_path / "transforms_train.json").unlink()
    assert [camera.name for camera in read_cameras(tmp_path)] == ["test/r_0"]


def test_name_in_both_files_gives_two_cameras(tmp_path):
    for word in ("train", "test"):
        write_transforms(tmp_path / f"transforms_{word}.json", frame("a"), **SHARED)
    found = [(camera.name, camera.split) for camera in read_cameras(tmp_path)]
    assert found == [("a", "train"), ("a", "test")]


def test_a_model_and_cameras_json_precede_transforms(tmp_path):
    def first() -> str:
        return read_cameras(tmp_path)[0].name

    write_transforms(tmp_path / "transforms_train.json", frame("blender"), **SHARED)
    assert first() == "blender"
    write_transforms(tmp_path / "transforms.json", frame("nerfstudio"), **SHARED)
    assert first() == "nerfstudio"
    write_json(tmp_path / "cameras.json", inria_entry(img_name="inria"))
    assert first() == "inria"
    write_model(tmp_path / "sparse" / "0", ".bin")
    assert first() == "a.jpg"


# The scene that nerfstudio trains


def rotation(seed: int) -> np.ndarray:
    axes, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return axes * np.linalg.det(axes)


def moved(turn: np.ndarray, by: tuple[float, ...]) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, by
    return matrix


APPLIED = moved(rotation(1), (0.5, -1.0, 2.0))
OLD = np.array([[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])


@pytest.mark.parametrize("how", ["stated", "old", "none"])
def test_cameras_move_as_nerfstudio_moved_them(how, tmp_path):
    """A point of COLMAP's world is at the same pixel when both are in the trained scene."""
    applied = {"stated": APPLIED, "old": OLD, "none": np.eye(4)}[how]
    oriented, scale = moved(rotation(2), (3.0, 1.0, -2.0)), 0.25
    shared = dict(SHARED)
    if how == "stated":
        shared["applied_transform"] = applied[:3].tolist()
    elif how == "old":
        (tmp_path / "colmap" / "sparse" / "0").mkdir(parents=True)
    saved = applied @ np.array(POSE)
    write_transforms(tmp_path / "transforms.json", frame(transform_matrix=saved.tolist()), **shared)
    trained = scale * (oriented @ applied @ [*POINT, 1])[:3]
    # As saved by nerfstudio: dataparser_outputs.dataparser_transform, dataparser_scale.
    beside = {"transform": (oriented @ applied)[:3].tolist(), "scale": scale}
    (tmp_path / "dataparser_transforms.json").write_text(json.dumps(beside))
    (camera,) = read_cameras(tmp_path / "transforms.json")
    np.testing.assert_allclose(pixel(camera, trained), (215, 60), atol=1e-9)
    depth = camera.rotation[2] @ (trained - camera.position)
    assert depth == pytest.approx(4 * scale)


@pytest.mark.parametrize("place", ["", "sparse/0", "colmap/sparse/0"])
def test_cameras_of_colmap_move_as_nerfstudio_moved_them(place, tmp_path):
    write_model(tmp_path / place, ".bin")
    oriented, scale = moved(rotation(2), (3.0, 1.0, -2.0)), 0.25
    beside = {"transform": oriented[:3].tolist(), "scale": scale}
    (tmp_path / "dataparser_transforms.json").write_text(json.dumps(beside))
    (camera,) = read_cameras(tmp_path)
    trained = scale * (oriented @ [*POINT, 1])[:3]
    np.testing.assert_allclose(pixel(camera, trained), (215, 60), atol=1e-9)
    assert camera.rotation[2] @ (trained - camera.position) == pytest.approx(4 * scale)


def test_scale_that_was_applied_before_is_not_applied_again(tmp_path):
    write_transforms(tmp_path / "t.json", applied_scale=2.0, **SHARED)
    beside = {"transform": np.eye(4)[:3].tolist(), "scale": 0.5}
    (tmp_path / "dataparser_transforms.json").write_text(json.dumps(beside))
    (camera,) = read_cameras(tmp_path / "t.json")
    np.testing.assert_allclose(camera.position, np.array(POSITION) / 4)


BAD_MOVES: dict[str, tuple[Any, str]] = {
    "list": ([], "the transform that nerfstudio applied"),
    "no transform": ({"scale": 1.0}, "no 'transform'"),
    "no scale": ({"transform": POSE[:3]}, "no 'scale'"),
    "scale of zero": ({"transform": POSE[:3], "scale": 0}, "scale 0.0, expected a number"),
    "scale NaN": ({"transform": POSE[:3], "scale": math.nan}, "scale nan"),
    "large scale": ({"transform": POSE[:3], "scale": HUGE}, "scale inf"),
    "flat transform": ({"transform": [1.0] * 12, "scale": 1}, "transform .*3 or 4 rows"),
}


@pytest.mark.parametrize("name", BAD_MOVES)
def test_bad_move_is_refused_in_one_line(name, tmp_path):
    value, message = BAD_MOVES[name]
    beside = tmp_path / "dataparser_transforms.json"
    beside.write_text(json.dumps(value))
    assert_refused(write_transforms(tmp_path / "t.json", **SHARED), message, beside)


def test_positions_beyond_floats_are_refused(tmp_path):
    beside = {"transform": POSE[:3], "scale": 1e200}
    (tmp_path / "dataparser_transforms.json").write_text(json.dumps(beside))
    far = [[*row[:3], 1e200] for row in POSE[:3]]
    path = write_transforms(tmp_path / "t.json", frame(transform_matrix=far), **SHARED)
    assert_refused(path, "position is not three finite numbers")


BAD_APPLIED = {
    "singular": ({"applied_transform": [[0.0] * 4] * 3}, "applied_transform is singular"),
    "short": ({"applied_transform": POSE[:2]}, "applied_transform .*3 or 4 rows"),
    "scale": ({"applied_scale": "1"}, "applied_scale '1'"),
    "scale of zero": ({"applied_scale": 0}, "applied_scale 0.0, expected a number above 0"),
}


@pytest.mark.parametrize("name", BAD_APPLIED)
def test_bad_applied_transform_is_refused(name, tmp_path):
    fields, message = BAD_APPLIED[name]
    beside = {"transform": POSE[:3], "scale": 1.0}
    (tmp_path / "dataparser_transforms.json").write_text(json.dumps(beside))
    assert_refused(write_transforms(tmp_path / "t.json", **fields, **SHARED), message)


# Bad files

ROWS = np.array(POSE, float)
BAD_FRAMES: dict[str, tuple[Any, str]] = {
    "number": (3, "3, expected a frame"),
    "list": ([POSE], "expected a frame"),
    "no name": ({"transform_matrix": POSE}, "no 'file_path'"),
    "no pose": ({"file_path": "b"}, "no 'transform_matrix'"),
    "name of a number": (frame(7), "file_path 7, expected text"),
    "empty name": (frame("./"), "0 characters"),
    "long name": (frame("n" * 1025), "1,025 characters"),
    "line end in name": (frame("a\nb"), "control characters"),
    "escape in name": (frame("a\x1b[31m"), "control characters"),
    "surrogate in name": (frame("a\ud800"), "control characters"),
    "pose of two rows": (frame("b", transform_matrix=POSE[:2]), "transform_matrix .*3 or 4 rows"),
    "flat pose": (frame("b", transform_matrix=[1.0] * 16), "3 or 4 rows of 4 numbers"),
    "pose of text": (frame("b", transform_matrix="1"), "transform_matrix '1'"),
    "ragged pose": (frame("b", transform_matrix=[*POSE[:3], [0, 0, 1]]), "row .*4 numbers"),
    "pose NaN": (frame("b", transform_matrix=[[math.nan] * 4] * 4), "row nan"),
    "pose of booleans": (frame("b", transform_matrix=[[True] * 4] * 4), "row True"),
    "perspective": (frame("b", transform_matrix=[*POSE[:3], [0, 0, 1, 1]]), "ends in .*0, 0, 0, 1"),
    "scaled": (frame("b", transform_matrix=(ROWS * 1.1).tolist()), "ends in|scaled"),
    "scaled rotation": (frame("b", transform_matrix=(1.1 * ROWS[:3]).tolist()), "scaled"),
    "reflection": (frame("b", transform_matrix=(ROWS[:3] * [1, 1, -1, 1]).tolist()), "reflection"),
    "overflow": (
        frame("b", transform_matrix=(1e307 * ROWS[:3]).tolist()),
        "rotation contains 1e.307",
    ),
    "far away": (frame("b", transform_matrix=[*POSE[:2], [0, 1, 0, HUGE]]), "row inf"),
    "width of text": (frame("b", w="400"), "w '400'"),
    "fractional width": (frame("b", w=400.5), "w 400.5, expected a whole number"),
    "width 0": (frame("b", w=0), "width 0"),
    "huge height": (frame("b", h=1e300), "h 1e\\+300"),
    "large height": (frame("b", h=10**6), "height 1000000"),
    "focal of zero": (frame("b", fl_x=0), "fx 0.0"),
    "focal NaN": (frame("b", fl_y=math.nan), "fl_y nan"),
    "boolean focal": (frame("b", fl_x=True), "fl_x True"),
    "null": (frame("b", cx=None), "cx None"),
    "coefficient of text": (frame("b", k1="a"), "k1 'a'"),
    "infinite coefficient": (frame("b", p1=math.inf), "p1 inf"),
    "large coefficient": (frame("b", k1=1e300), "lens: its distortion"),
    "model of a number": (frame("b", camera_model=3), "camera_model 3, expected text"),
    "panorama": (frame("b", camera_model="EQUIRECTANGULAR"), "camera_model 'EQUIRECTANGULAR', exp"),
    "fisheye of text": (frame("b", is_fisheye="yes"), "is_fisheye 'yes'"),
    "f-theta": (frame("b", ftheta_p0=0.1), "a lens with ftheta_p0"),
    "list of coefficients": (frame("b", distortion_params=[0.1] * 6), "with distortion_params"),
}


@pytest.mark.parametrize("name", BAD_FRAMES)
def test_bad_frame_is_refused_in_one_line(name, tmp_path):
    bad, message = BAD_FRAMES[name]
    path = write_transforms(tmp_path / "t.json", frame("first"), bad, **SHARED)
    assert_refused(path, f"frame 1: .*{message}")


BAD_FILES: dict[str, tuple[Any, str]] = {
    "frames of a number": ({"frames": 3}, "frames 3, expected a list"),
    "frames of an object": ({"frames": {"a": 1}}, "frames .*expected a list"),
    "no frames": ({"frames": []}, "no cameras"),
    "no focal": ({"frames": [frame()], "w": 4, "h": 3}, "no 'fl_x' or 'camera_angle_x'"),
    "angle 0": ({"frames": [frame()], "w": 4, "h": 3, "camera_angle_x": 0}, "camera_angle_x 0.0"),
    "half a turn": (
        {"frames": [frame()], "w": 4, "h": 3, "camera_angle_x": math.pi},
        "camera_angle_x 3.14.*expected above 0 and below 3.14159",
    ),
    "angle NaN": (
        {"frames": [frame()], "w": 4, "h": 3, "camera_angle_x": math.nan},
        "camera_angle_x nan",
    ),
    "split of text": (
        {"frames": [frame()], **SHARED, "train_filenames": "a"},
        "train_filenames 'a', expected a list",
    ),
    "split of numbers": ({"frames": [frame()], **SHARED, "val_filenames": [1]}, "file_path 1"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_file_is_refused_in_one_line(name, tmp_path):
    value, message = BAD_FILES[name]
    path = tmp_path / "t.json"
    path.write_text(json.dumps(value))
    assert_refused(path, message)


def test_damaged_files_are_refused_or_give_valid_cameras_seed5(tmp_path):
    rng = np.random.default_rng(5)
    path = tmp_path / "t.json"
    frames = [frame("a"), frame("b", k1=0.01), frame("c", camera_angle_x=1.0)]
    good = write_transforms(path, *frames, train_filenames=["a"], **SHARED).read_bytes()
    read = 0
    for _ in range(600):
        path.write_bytes(damaged(good, rng))
        read += read_damaged(path)
    assert 0 < read < 600

"""Camera files: conventions against hand-computed pixels, invalid files rejected in one line."""

from __future__ import annotations

import json
import locale
import math
import os
import struct
import tracemalloc
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from camera_files import (
    HUGE,
    POINT,
    POSITION,
    QUATERNION,
    RIGHT_DOWN_FORWARD,
    WRITERS,
    Image,
    Intrinsics,
    assert_refused,
    both_forms,
    damaged,
    images_bin,
    inria_entry,
    pixel,
    random_model,
    read_damaged,
    write_json,
    write_model,
)
from scenes import shared_scene_path

from gs_codec.cameras.camera import facing
from gs_codec.cameras.camera_files import read_cameras
from gs_codec.errors import InvalidInput, printable
from gs_codec.runtime.wording import counted

# What is where


def test_inria_point_is_at_its_pixel(tmp_path):
    (camera,) = read_cameras(write_json(tmp_path / "cameras.json", inria_entry()))
    # 200 + 100 * 1 / 4 and 150 - 200 * 2 / 4: the principal point is the centre.
    np.testing.assert_allclose(pixel(camera, POINT), (225, 50), atol=1e-12)
    assert (camera.name, camera.width, camera.height, camera.split) == ("a", 400, 300, None)


@pytest.mark.parametrize(
    ("model", "parameters", "expected"),
    [
        ("PINHOLE", (100.0, 200.0, 190.0, 160.0), (215, 60)),
        ("SIMPLE_PINHOLE", (200.0, 190.0, 160.0), (240, 60)),
        ("SIMPLE_RADIAL", (200.0, 190.0, 160.0, 0.0), (240, 60)),
    ],
    ids=["PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL"],
)
@both_forms
def test_colmap_point_is_at_its_pixel(suffix, model, parameters, expected, tmp_path):
    intrinsics = Intrinsics(model=model, parameters=parameters)
    (camera,) = read_cameras(write_model(tmp_path, suffix, cameras=[intrinsics]))
    np.testing.assert_allclose(pixel(camera, POINT), expected, atol=1e-12)
    np.testing.assert_allclose(camera.position, POSITION, atol=1e-12)
    assert (camera.name, camera.width, camera.height) == ("a.jpg", 400, 300)


def test_text_and_binary_agree_seed1(tmp_path):
    model = random_model(seed=1)
    texts, binaries = (read_cameras(write_model(tmp_path / s, s, *model)) for s in (".txt", ".bin"))
    assert [camera.name for camera in texts] == sorted(image.name for image in model[0])
    for a, b in zip(texts, binaries, strict=True):
        for field in ("name", "width", "height", "fx", "fy", "cx", "cy", "split"):
            assert getattr(a, field) == getattr(b, field), field
        np.testing.assert_array_equal(a.rotation, b.rotation)
        np.testing.assert_array_equal(a.position, b.position)


@both_forms
def test_poses_are_those_of_rotated_vectors_seed2(suffix, tmp_path):
    images, cameras = random_model(seed=2)
    read = {
        camera.name: camera
        for camera in read_cameras(write_model(tmp_path, suffix, images, cameras))
    }
    point = np.array([0.3, -0.7, 1.9])
    for image in images:
        # v + 2 r x (r x v + w v) rotates v by the unit quaternion (w, r).
        w, *r = np.array(image.quaternion) / np.linalg.norm(image.quaternion)
        turned = point + 2 * np.cross(r, np.cross(r, point) + w * point)
        camera = read[image.name]
        before = camera.rotation @ (point - camera.position)
        np.testing.assert_allclose(before, turned + image.translation, atol=1e-11)
        assert camera.width == {7: 640, 2: 800}[image.camera_id]


@both_forms
@pytest.mark.parametrize("scale", [1e-320, 1e-200, 3.0, 3e307], ids=str)
def test_quaternion_of_any_length_is_normalised(suffix, scale, tmp_path):
    image = Image(quaternion=[scale * q for q in QUATERNION])
    (camera,) = read_cameras(write_model(tmp_path, suffix, [image]))
    np.testing.assert_allclose(pixel(camera, POINT), (215, 60), atol=1e-9)


@both_forms
def test_largest_ids_are_read(suffix, tmp_path):
    largest = 2**32 - 1
    image = Image(camera_id=largest, image_id=largest)
    assert len(read_cameras(write_model(tmp_path, suffix, [image], [Intrinsics(largest)]))) == 1


# Upright cameras

AXES = {sign + "xyz"[k]: (-1 if sign else 1) * np.eye(3)[k] for k in range(3) for sign in ("", "-")}


@pytest.mark.parametrize("up", AXES)
@pytest.mark.parametrize("scale", [5e-324, 1e-300, 1.0, 1e300])
def test_cameras_that_face_somewhere_are_upright_seed7(up, scale):
    direction = np.random.default_rng(7).normal(size=3) if scale > 1e-300 else np.ones(3)
    rotation = facing(scale * direction, scale * AXES[up])
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    np.testing.assert_allclose(rotation[2], direction / np.linalg.norm(direction), atol=1e-12)
    assert rotation[0] @ AXES[up] == pytest.approx(0, abs=1e-12)
    assert rotation[1] @ AXES[up] < 0


@pytest.mark.parametrize("up", [*AXES.values(), np.ones(3), np.array([1, 2, -3])])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("off", [0, 1e-13, 1e-8])
def test_cameras_that_face_straight_up_or_down_have_one_side(up, sign, off):
    direction = sign * (up + off * np.array([0.3, -0.4, 0.2]))
    rotation = facing(direction, up)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotation[2], direction / np.linalg.norm(direction), atol=1e-12)
    np.testing.assert_allclose(rotation[0], facing(up, up)[0], atol=1e-6)


@pytest.mark.parametrize("bad", [[0, 0, 0], [0, math.nan, 1], [math.inf, 0, 0]], ids=str)
def test_cameras_face_a_direction_and_have_an_up(bad):
    with pytest.raises(InvalidInput, match=r"direction .*: expected finite numbers, not all 0"):
        facing(np.array(bad), np.eye(3)[1])
    with pytest.raises(InvalidInput, match=r"up .*: expected finite numbers, not all 0"):
        facing(np.eye(3)[1], np.array(bad))


# INRIA files


def test_real_file_has_its_split():
    cameras = read_cameras(shared_scene_path("bonsai/cameras.json"))
    assert len(cameras) == 292
    assert sum(camera.split == "test" for camera in cameras) == 37
    assert sum(camera.split == "train" for camera in cameras) == 255
    assert cameras[0].name == "DSCF5565"
    # The cameras surround a table and look at it: the mean position is in front of each.
    middle = np.mean([camera.position for camera in cameras], axis=0)
    before = [(camera.rotation @ (middle - camera.position))[2] for camera in cameras]
    assert min(before) > 0


def test_inria_order_and_split_are_the_files(tmp_path):
    names = ["c", "a", "d", "b"]
    splits = [{"split": "test"}, {"split": "train"}, {}, {"split": None}]
    entries = [inria_entry(img_name=n) | s for n, s in zip(names, splits, strict=True)]
    cameras = read_cameras(write_json(tmp_path / "any name.JSON", *entries))
    assert [camera.name for camera in cameras] == names
    assert [camera.split for camera in cameras] == ["test", "train", None, None]


@pytest.mark.parametrize(
    ("keys", "expected"),
    [({}, (200, 150)), ({"cx": 1}, (200, 150)), ({"cx": -3, "cy": 7.5}, (-3, 7.5))],
    ids=["none", "cx alone", "both"],
)
def test_complete_principal_point_is_used(keys, expected, tmp_path):
    (camera,) = read_cameras(write_json(tmp_path / "cameras.json", inria_entry(**keys)))
    assert (camera.cx, camera.cy) == expected


def test_byte_order_mark_and_whole_floats_are_read(tmp_path):
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps([inria_entry(width=400.0)]), encoding="utf-8-sig")
    (camera,) = read_cameras(path)
    assert isinstance(camera.width, int)


BAD_ENTRIES: dict[str, tuple[Any, str]] = {
    "number": (3, "3, expected a camera"),
    "list": ([1] * 1000, "expected a camera"),
    "nested": ([[[[[[[[1] * 9] * 9] * 9] * 9]]]], "expected a camera"),
    "no id is needed, but a name": ({"id": 0}, "no 'img_name'"),
    "name of a fraction": ({"img_name": 7.5}, "img_name 7.5"),
    "boolean name": ({"img_name": True}, "img_name True"),
    "empty name": ({"img_name": ""}, "0 characters"),
    "long name": ({"img_name": "n" * 1025}, "1,025 characters"),
    "line end in name": ({"img_name": "a\nb"}, "control characters"),
    "zero in name": ({"img_name": "a\0"}, "control characters"),
    "line separator in name": ({"img_name": "a\u2028"}, "control characters"),
    "surrogate in name": ({"img_name": "a\ud800"}, "control characters"),
    "text for a number": ({"fx": "100"}, "fx '100', expected a finite number"),
    "boolean": ({"fx": True}, "fx True"),
    "null": ({"fy": None}, "fy None"),
    "NaN": ({"fx": math.nan}, "fx nan"),
    "infinity": ({"fy": math.inf}, "fy inf"),
    "huge integer focal": ({"fx": HUGE}, "fx inf"),
    "focal of zero": ({"fx": 0}, "fx 0.0, expected a focal length above 0"),
    "negative focal": ({"fy": -3.5}, "fy -3.5"),
    "width 0": ({"width": 0}, "width 0"),
    "negative height": ({"height": -1}, "height -1"),
    "fractional width": ({"width": 400.5}, "width 400.5, expected a whole number"),
    "large width": ({"width": 10**6}, "width 1000000"),
    "huge width": ({"width": HUGE}, "width inf"),
    "1e300 wide": ({"width": 1e300}, "width 1e\\+300"),
    "boolean width": ({"width": True}, "width True"),
    "position of two": ({"position": [1, 2]}, "position .*expected 3 numbers"),
    "position of an object": ({"position": {"x": 1}}, "position"),
    "position of text": ({"position": "123"}, "position '123'"),
    "position of lists": ({"position": [[1], [2], [3]]}, "position"),
    "infinite position": ({"position": [0, 0, -math.inf]}, "position -inf"),
    "rotation of two rows": ({"rotation": RIGHT_DOWN_FORWARD[:2]}, "rotation .*3 rows"),
    "rotation of nine": ({"rotation": [0] * 9}, "rotation .*3 rows"),
    "rotation of ragged rows": ({"rotation": [[1, 0, 0], [0, 1], [0, 0, 1]]}, "rotation row"),
    "rotation NaN": ({"rotation": [[math.nan] * 3] * 3}, "rotation row nan"),
    "rotation of zero": ({"rotation": [[0] * 3] * 3}, "singular or scaled"),
    "rotation of rank 1": ({"rotation": [[1, 0, 0]] * 3}, "singular or scaled"),
    "scaled rotation": ({"rotation": [[1.01, 0, 0], [0, 1.01, 0], [0, 0, 1.01]]}, "scaled"),
    "sheared rotation": ({"rotation": [[1, 0.01, 0], [0, 1, 0], [0, 0, 1]]}, "scaled"),
    "reflection": ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "reflection"),
    "overflowing rotation": ({"rotation": [[1e308, -1e308, 0]] * 3}, "rotation contains 1e\\+308"),
    "other split": ({"split": "val"}, "split 'val', expected 'train' or 'test'"),
    "split of a list": ({"split": ["test"]}, "split"),
    "text for cx": ({"cx": "1", "cy": 2}, "cx '1'"),
    "NaN for cy": ({"cx": 1, "cy": math.nan}, "cy nan"),
}


@pytest.mark.parametrize("name", BAD_ENTRIES)
def test_bad_inria_entry_is_refused_in_one_line(name, tmp_path):
    changes, message = BAD_ENTRIES[name]
    bad = changes
    if isinstance(changes, dict) and "id" not in changes:
        bad = inria_entry(img_name="second") | changes
    path = write_json(tmp_path / "cameras.json", inria_entry(img_name="first"), bad)
    assert_refused(path, f"entry 1: .*{message}")


@pytest.mark.parametrize("key", sorted(inria_entry().keys() - {"id"}))
def test_missing_field_is_named(key, tmp_path):
    entry = inria_entry()
    del entry[key]
    assert_refused(write_json(tmp_path / "cameras.json", entry), f"entry 0: no '{key}'")


BAD_JSON = {
    "empty": (b"", "empty file"),
    "blank": (b" \n", "not JSON"),
    "empty list": (b"[]", "no cameras"),
    "object": (b'{"cameras": []}', "expected a list of cameras"),
    "text": (b'"cameras"', "'cameras', expected a list"),
    "null": (b"null", "None, expected a list"),
    "unfinished": (json.dumps([inria_entry()]).encode()[:-1], "not JSON"),
    "two texts": (b"[][]", "not JSON"),
    "no JSON": (b"# Camera list\n1 PINHOLE", "not JSON"),
    "lone quote": (b"[{'a': 1}]", "not JSON"),
    "Latin-1": (b'[{"img_name": "\xe9t\xe9"}]', "not UTF-8 text at byte 15"),
    "UTF-16": ("[]".encode("utf-16"), "not UTF-8"),
    "binary": (bytes(range(256)), "not"),
    "deep lists": (b"[" * 200_000, "nested too deeply"),
    "deep lists in a camera": (b'[{"img_name": ' + b"[" * 200_000, "nested too deeply"),
    "deep objects": (b'[{"a": ' * 200_000, "nested too deeply"),
    "long integer": (b"[" + b"9" * 100_000 + b"]", "entry 0: inf"),
}


@pytest.mark.parametrize("name", BAD_JSON)
def test_bad_json_is_refused_in_one_line(name, tmp_path):
    data, message = BAD_JSON[name]
    path = tmp_path / "cameras.json"
    path.write_bytes(data)
    assert_refused(path, message)


def test_json_too_large_for_memory_is_refused(tmp_path):
    path = tmp_path / "cameras.json"
    with open(path, "wb") as file:
        file.truncate((1 << 25) + 1)
    assert_refused(path, "33,554,433 bytes, expected at most 33,554,432")


def test_names_may_be_numbers(tmp_path):
    entries = [inria_entry(img_name=index) for index in (0, 11)]
    cameras = read_cameras(write_json(tmp_path / "cameras.json", *entries))
    assert [camera.name for camera in cameras] == ["0", "11"]


def test_several_cameras_may_have_one_name(tmp_path):
    entries = [inria_entry(img_name="frame", position=[x, 0, 0]) for x in (3.0, 1.0, 2.0)]
    cameras = read_cameras(write_json(tmp_path / "cameras.json", *entries))
    assert [(camera.name, camera.position[0]) for camera in cameras] == [
        ("frame", 3), ("frame", 1), ("frame", 2)
    ]  # fmt: skip


# COLMAP models


def test_sizes_in_text_may_have_decimals(tmp_path):
    path = write_model(tmp_path, ".txt") / "cameras.txt"
    path.write_text(path.read_text().replace("400 300", "400.0 300."))
    assert [(c.width, c.height) for c in read_cameras(tmp_path)] == [(400, 300)]
    path.write_text(path.read_text().replace("400.0", "400.5"))
    assert_refused(tmp_path, "line 3: b'400.5', expected an integer", told=path)


@both_forms
def test_several_images_may_have_one_name(suffix, tmp_path):
    one = {"quaternion": (1, 0, 0, 0)}
    images = [
        Image("b"),
        Image("a", translation=(-1, 0, 0), image_id=2, **one),
        Image("a", translation=(-2, 0, 0), image_id=3, **one),
    ]
    cameras = read_cameras(write_model(tmp_path, suffix, images))
    assert [(camera.name, camera.position[0]) for camera in cameras] == [
        ("a", 1),
        ("a", 2),
        ("b", 1),
    ]


@both_forms
def test_every_eighth_image_by_name_is_for_testing(suffix, tmp_path):
    names = [f"img{i}.jpg" for i in range(17)]
    shuffled = np.random.default_rng(3).permutation(names).tolist()
    images = [Image(name, image_id=i) for i, name in enumerate(shuffled)]
    cameras = read_cameras(write_model(tmp_path, suffix, images))
    # By character, as the trainer sorts: img10 comes before img2.
    assert [camera.name for camera in cameras] == sorted(names)
    tests = [camera.name for camera in cameras if camera.split == "test"]
    assert tests == ["img0.jpg", "img16.jpg", "img9.jpg"]
    assert all(camera.split == "train" for camera in cameras if camera.name not in tests)


@both_forms
@pytest.mark.parametrize("name", ["a b  c.jpg", "left/été 1.jpg", "日本.png", "#1.jpg", "n" * 1024])
def test_names_are_kept_whole(suffix, name, tmp_path):
    images = [Image(name, points=2), Image("z.jpg")]
    cameras = read_cameras(write_model(tmp_path, suffix, images))
    assert [camera.name for camera in cameras] == sorted([name, "z.jpg"])


@both_forms
def test_names_in_a_code_page_are_read(suffix, tmp_path, monkeypatch, caplog):
    """COLMAP on Windows writes names in the system's code page, here that of Chinese systems."""
    images = [Image("\u5fae\u4fe1_1.png".encode("gbk"), translation=(0, 0, 1)), Image("z.jpg")]
    write_model(tmp_path, suffix, images)
    # From Python 3.11 on, whatever Python's UTF-8 mode is, the default from 3.15 on.
    asked = "getencoding" if hasattr(locale, "getencoding") else "getpreferredencoding"
    monkeypatch.setattr(f"locale.{asked}", lambda *_: "utf-8")
    escaped, other = read_cameras(tmp_path)
    assert (escaped.name, other.name) == (r"\xce\xa2\xd0\xc5_1.png", "z.jpg")
    assert caplog.messages == [
        f"{tmp_path}: names of 1 image are not UTF-8 text; photographs cannot be found by them"
    ]
    monkeypatch.setattr(f"locale.{asked}", lambda *_: "gbk")
    other, decoded = read_cameras(tmp_path)
    assert (other.name, decoded.name) == ("z.jpg", "\u5fae\u4fe1_1.png")
    np.testing.assert_array_equal(decoded.position, escaped.position)
    assert len(caplog.messages) == 1


def test_windows_line_ends_comments_and_a_missing_last_line_are_read(tmp_path):
    write_model(tmp_path, ".txt", [Image("a b.jpg"), Image("c.jpg", points=1), Image("d.jpg")])
    for name in ("cameras.txt", "images.txt"):
        data = (tmp_path / name).read_bytes().rstrip(b"\n")
        (tmp_path / name).write_bytes(b"\n  # more\n" + data.replace(b"\n", b"\r\n"))
    assert [camera.name for camera in read_cameras(tmp_path)] == ["a b.jpg", "c.jpg", "d.jpg"]
    for name in ("cameras.txt", "images.txt"):
        data = (tmp_path / name).read_bytes().lstrip()
        (tmp_path / name).write_bytes(b"\xef\xbb\xbf" + data)
    assert [camera.name for camera in read_cameras(tmp_path)] == ["a b.jpg", "c.jpg", "d.jpg"]


@pytest.mark.parametrize("second", ["b.jpg", "17"])
def test_images_without_point_lines_are_refused(tmp_path, second):
    write_model(tmp_path, ".txt", [Image("a.jpg"), Image(second), Image("c.jpg")])
    path = tmp_path / "images.txt"
    path.write_bytes(path.read_bytes().replace(b"\n\n", b"\n"))
    text = f"line 3: 10 words, b'{second}' at its end, expected 2D points"
    assert_refused(tmp_path, text, path)


def test_long_lines_of_points_are_counted(tmp_path):
    write_model(tmp_path, ".txt", [Image("a.jpg", points=9000), Image("b.jpg")])
    assert [camera.name for camera in read_cameras(tmp_path)] == ["a.jpg", "b.jpg"]


@both_forms
def test_points_are_skipped_without_keeping_them(suffix, tmp_path):
    count = 200_000
    write_model(tmp_path, suffix, [Image("a.jpg", points=count), Image("b.jpg", points=count)])
    tracemalloc.start()
    try:
        cameras = read_cameras(tmp_path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert [camera.name for camera in cameras] == ["a.jpg", "b.jpg"]
    # One image's points take 2 MB as text and 5 MB in binary.
    assert peak < 1_000_000


@both_forms
def test_other_files_of_the_model_are_not_read(suffix, tmp_path):
    write_model(tmp_path, suffix)
    for stem in ("points3D", "rigs", "frames"):
        (tmp_path / (stem + suffix)).write_bytes(b"\xff broken")
    assert len(read_cameras(tmp_path)) == 1


Change = tuple[Sequence[Image], Sequence[Intrinsics], str, str]
NAN, INF = math.nan, math.inf
ONE = (Intrinsics(),)
BAD_MODELS: dict[str, Change] = {
    "field of view": (
        [Image()],
        [Intrinsics(31, "FOV", parameters=(1.0,) * 5)],
        "cameras",
        "camera 31: model 'FOV', expected one of SIMPLE_PINHOLE",
    ),
    "thin prism": (
        [Image()],
        [Intrinsics(31, "THIN_PRISM_FISHEYE", parameters=(1.0,) * 12)],
        "cameras",
        "camera 31: model 'THIN_PRISM_FISHEYE'.*undistort the images with COLMAP",
    ),
    "panorama": (
        [Image()],
        [Intrinsics(5, "EQUIRECTANGULAR", parameters=(1.0, 1.0))],
        "cameras",
        "camera 5: model 'EQUIRECTANGULAR'",
    ),
    "distorted and not used": (
        [Image()],
        [Intrinsics(), Intrinsics(9, "FOV", parameters=(1.0,) * 5)],
        "cameras",
        "camera 9: model 'FOV'",
    ),
    "camera twice": ([Image()], ONE * 2, "cameras", "camera 1 occurs twice"),
    "no camera": ([Image()], [], "images", "camera 1, which is not in cameras"),
    "unknown camera": ([Image(camera_id=8)], ONE, "images", "camera 8, which is not in cameras"),
    "bell in name": ([Image("a\x07.jpg")], ONE, "images", "control characters in name"),
    "escape in name": ([Image("\x1b[31m.jpg")], ONE, "images", "control characters in name"),
    "C1 control in name": ([Image("a\x85b")], ONE, "images", "control characters in name"),
    "long name": ([Image("n" * 1025)], ONE, "images", "1,025 characters"),
    "zero quaternion": ([Image(quaternion=(0.0,) * 4)], ONE, "images", "pose"),
    "NaN quaternion": ([Image(quaternion=(1.0, NAN, 0.0, 0.0))], ONE, "images", "pose"),
    "infinite quaternion": ([Image(quaternion=(INF, 0.0, 0.0, 0.0))], ONE, "images", "pose"),
    "NaN translation": ([Image(translation=(0.0, NAN, 0.0))], ONE, "images", "pose"),
    "overflowing centre": (
        [Image(quaternion=(1.0, 0.1, 0.2, 0.3), translation=(1.7e308, 1.7e308, -1.7e308))],
        ONE,
        "images",
        "position is not three finite",
    ),
    **{
        f"{what} parameter": (
            [Image()],
            [Intrinsics(3, parameters=(1.0, 1.0, value, 1.0))],
            "cameras",
            "camera 3: parameters .*expected finite",
        )
        for what, value in (("NaN", NAN), ("infinite", INF))
    },
    **{
        f"{what}": ([Image()], [Intrinsics(1, "PINHOLE", *sides)], "images", message)
        for what, sides, message in (
            ("width 0", (0, 3), "width 0"),
            ("height 0", (3, 0), "height 0"),
            ("huge width", (2**64 - 1, 3), "width 18446744073709551615"),
            ("focal of zero", (3, 3, (0.0, 1.0, 1.0, 1.0)), "fx 0"),
            ("negative focal", (3, 3, (1.0, -1.0, 1.0, 1.0)), "fy -1"),
        )
    },
}


@both_forms
@pytest.mark.parametrize("name", BAD_MODELS)
def test_bad_model_is_refused_in_one_line(name, suffix, tmp_path):
    images, cameras, stem, message = BAD_MODELS[name]
    write_model(tmp_path, suffix, images, cameras)
    assert_refused(tmp_path, message, tmp_path / f"{stem}{suffix}")


@both_forms
def test_model_without_images_is_refused(suffix, tmp_path):
    assert_refused(write_model(tmp_path, suffix, []), "no cameras, expected at least one")


# Text models


def replaced(stem: str, old: str, new: str) -> tuple[str, Callable[[bytes], bytes]]:
    """Name of a model file, and a function that replaces `old` by `new` in it."""

    def make(good: bytes) -> bytes:
        assert old.encode() in good
        return good.replace(old.encode(), new.encode("latin-1"), 1)

    return stem, make


LAST = "200.0 190.0 160.0"
POSE = "1 0.5 0.5 -0.5 0.5"
BAD_TEXTS: dict[str, tuple[tuple[str, Callable[[bytes], bytes]], str]] = {
    "fields of a camera": (replaced("cameras", "PINHOLE 400 300 100.0 " + LAST, ""), "1 field,"),
    "too few parameters": (replaced("cameras", LAST, "1 1"), "3 parameters, expected 4 of PINHOLE"),
    "too many parameters": (replaced("cameras", LAST, LAST + " 7"), "5 parameters, expected 4"),
    "no parameters": (replaced("cameras", "100.0 " + LAST, ""), "0 parameters"),
    "text for a parameter": (replaced("cameras", LAST, "1 1 x"), "line 3: b'x', expected a number"),
    "grouped digits": (replaced("cameras", LAST, "1 1 1_0"), "b'1_0', expected a number"),
    "NaN": (replaced("cameras", LAST, "1 nan 1"), "camera 1: parameters .*nan"),
    "overflow": (replaced("cameras", LAST, "1 1e999 1"), "camera 1: parameters .*inf"),
    "unknown model": (
        replaced("cameras", "PINHOLE", "PIN\x1bHOLE\xe9"),
        r"camera 1: model 'PIN\\x1b",
    ),
    "model of lower case": (replaced("cameras", "PINHOLE", "pinhole"), "model 'pinhole'"),
    "fractional width": (replaced("cameras", "400", "400.5"), "b'400.5', expected an integer"),
    "negative width": (replaced("cameras", "400", "-400"), "width -400"),
    "long width": (replaced("cameras", "400", "4" * 65), "expected an integer"),
    "longer width": (replaced("cameras", "400", "4" * 5000), "expected an integer"),
    "long line": (replaced("cameras", "400", "4" * 9000), "line 3: expected less than 8192 bytes"),
    "camera id": (replaced("cameras", "1 PINHOLE", "one PINHOLE"), "b'one', expected an integer"),
    "fields of an image": (replaced("images", " 1 a.jpg", ""), "line 3: 8 fields, expected 10"),
    "no name": (replaced("images", " a.jpg", ""), "9 fields"),
    "text for a pose": (replaced("images", POSE, "1 0.5 0.5 ? 0.5"), r"b'\?', expected a number"),
    "NaN for a pose": (replaced("images", POSE, "1 0.5 nan 0.5 0.5"), "line 3: pose"),
    "text for an id": (replaced("images", POSE, "x" + POSE), "b'x1', expected an integer"),
    "comment for points": (
        replaced("images", "a.jpg\n", "a.jpg\n# no points"),
        "expected 2D points",
    ),
    "unfinished points": (replaced("images", "a.jpg\n", "a.jpg\n1.5 2."), "b'2.' at its end"),
    "zeros": (("images", lambda good: bytes(20_000)), "line 1: expected less than 8192 bytes"),
    "no line end": (("cameras", lambda good: b"9" * 20_000), "expected less than 8192 bytes"),
    "binary in text": (("images", lambda good: images_bin([Image()])), "line 1: "),
}


@pytest.mark.parametrize("name", BAD_TEXTS)
def test_bad_text_is_refused_in_one_line(name, tmp_path):
    (stem, make), message = BAD_TEXTS[name]
    path = write_model(tmp_path, ".txt") / f"{stem}.txt"
    path.write_bytes(make(path.read_bytes()))
    if "width -" in message:
        path = tmp_path / "images.txt"
    assert_refused(tmp_path, message, path)


def test_empty_text_is_refused(tmp_path):
    images = write_model(tmp_path, ".txt") / "images.txt"
    (tmp_path / "cameras.txt").write_bytes(b"")
    assert_refused(tmp_path, "camera 1, which is not in cameras.txt", images)
    images.write_bytes(b"")
    assert_refused(tmp_path, "no cameras")


# Binary models


@pytest.mark.parametrize("stem", ["cameras", "images"])
def test_every_truncation_of_a_binary_file_is_refused(stem, tmp_path):
    cameras = [Intrinsics(), Intrinsics(2, "SIMPLE_PINHOLE", parameters=(1, 2, 3))]
    images = [Image("a.jpg", points=2), Image("b/é.jpg", camera_id=2), Image("c.jpg", points=1)]
    path = write_model(tmp_path, ".bin", images, cameras) / f"{stem}.bin"
    assert len(read_cameras(tmp_path)) == 3
    good = path.read_bytes()
    for size in range(len(good)):
        path.write_bytes(good[:size])
        assert_refused(tmp_path, told=path)


@pytest.mark.parametrize("surplus", [b"\0", b"\n", bytes(100)], ids=["zero", "line", "100"])
@pytest.mark.parametrize("stem", ["cameras", "images"])
def test_bytes_after_the_last_entry_are_refused(stem, surplus, tmp_path):
    path = write_model(tmp_path, ".bin") / f"{stem}.bin"
    path.write_bytes(path.read_bytes() + surplus)
    assert_refused(tmp_path, f": {counted(len(surplus), 'byte')} after the last entry", path)


@pytest.mark.parametrize("count", [2, 100, 2**32, 2**63, 2**64 - 1])
@pytest.mark.parametrize("stem", ["cameras", "images"])
def test_count_beyond_the_file_is_refused(stem, count, tmp_path):
    path = write_model(tmp_path, ".bin") / f"{stem}.bin"
    path.write_bytes(struct.pack("<Q", count) + path.read_bytes()[8:])
    message = f"{count:,} entries, too many for" if count > 2 else "bytes left|too many"
    assert_refused(tmp_path, message, path)


@pytest.mark.parametrize("count", [1, 2**32, 2**60, 2**61, 2**64 - 1])
def test_points_beyond_the_file_are_refused(count, tmp_path):
    path = write_model(tmp_path, ".bin") / "images.bin"
    path.write_bytes(path.read_bytes()[:-8] + struct.pack("<Q", count))
    assert_refused(tmp_path, "0 bytes left", path)


@pytest.mark.parametrize(
    ("model", "name"),
    [
        (-1, "number -1"),
        (7, "FOV"),
        (11, "RAD_TAN_THIN_PRISM_FISHEYE"),
        (17, "EQUIRECTANGULAR"),
        (18, "number 18"),
        (2**31 - 1, "number 2147483647"),
        (-(2**31), "number -2147483648"),
    ],
)
def test_unsupported_camera_model_is_named(model, name, tmp_path):
    write_model(tmp_path, ".bin", cameras=[Intrinsics(6, model, parameters=(1.0,) * 20)])
    assert_refused(tmp_path, f"camera 6: model '{name}', expected", tmp_path / "cameras.bin")


def test_empty_name_is_refused(tmp_path):
    write_model(tmp_path, ".bin", [Image("")])
    assert_refused(tmp_path, "name of 0 characters", tmp_path / "images.bin")


@pytest.mark.parametrize("size", [9, 4096, 100_000])
def test_unterminated_name_is_refused(size, tmp_path):
    path = write_model(tmp_path, ".bin") / "images.bin"
    path.write_bytes(path.read_bytes()[:72] + b"n" * size)
    message = f"image 1: no end of its name in {min(size, 4097):,} bytes"
    assert_refused(tmp_path, message, path)


# Random damage

GOOD_JSON = json.dumps([inria_entry(img_name=f"{i}", split="train") for i in range(3)]).encode()


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", ["json", "cameras.bin", "images.bin", "cameras.txt", "images.txt"])
def test_damage_is_refused_or_gives_valid_cameras_seed4(name, tmp_path):
    rng = np.random.default_rng(4)
    images = [Image(f"{i}.jpg", camera_id=1 + i % 2, points=i) for i in range(3)]
    cameras = [Intrinsics(), Intrinsics(2, "SIMPLE_PINHOLE", parameters=(300.0, 200.0, 150.0))]
    if name == "json":
        path = given = tmp_path / "cameras.json"
        good = GOOD_JSON
    else:
        given = write_model(tmp_path, name[-4:], images, cameras)
        path = tmp_path / name
        good = path.read_bytes()
    read = 0
    for _ in range(600):
        path.write_bytes(damaged(good, rng))
        read += read_damaged(given)
    # Both occur: some damage is detected, some is not.
    assert 0 < read < 600


@pytest.mark.parametrize("special", [0, 0x7FF0 << 48, 0x7FEF << 48, 1, 2**64 - 1], ids=hex)
@pytest.mark.parametrize("stem", ["cameras", "images"])
def test_extreme_values_at_every_place_are_refused_or_valid(stem, special, tmp_path):
    path = write_model(tmp_path, ".bin", [Image("abcdefgh.jpg", points=1)]) / f"{stem}.bin"
    good = path.read_bytes()
    refused = 0
    for position in range(len(good) - 7):
        path.write_bytes(good[:position] + struct.pack("<Q", special) + good[position + 8 :])
        refused += not read_damaged(tmp_path)
    assert refused > 8


# Which files


def kind(path: Path) -> float:
    """The focal length of the first camera, which identifies files in these tests."""
    return read_cameras(path)[0].fx


def write_kind(folder: Path, suffix: str, focal: float) -> Path:
    return write_model(folder, suffix, cameras=[Intrinsics(parameters=(focal, 1.0, 1.0, 1.0))])


@pytest.mark.parametrize("inside", [".", "sparse/0", "sparse"])
@both_forms
def test_model_is_found_in_the_folder_of_a_dataset(suffix, inside, tmp_path):
    write_kind(tmp_path / inside, suffix, 5.0)
    assert kind(tmp_path) == 5
    assert kind(str(tmp_path)) == 5


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "cameras.txt", "images.txt"])
def test_a_models_file_stands_for_its_folder(name, tmp_path):
    write_kind(tmp_path, name[-4:], 6.0)
    assert kind(tmp_path / name) == 6


def test_binary_is_preferred_to_text_and_a_model_to_json(tmp_path):
    write_json(tmp_path / "cameras.json", inria_entry(fx=1.0))
    assert kind(tmp_path) == 1
    write_kind(tmp_path / "sparse", ".txt", 2.0)
    assert kind(tmp_path) == 2
    write_kind(tmp_path / "sparse", ".bin", 3.0)
    assert kind(tmp_path) == 3
    write_kind(tmp_path / "sparse" / "0", ".txt", 4.0)
    assert kind(tmp_path) == 4
    write_kind(tmp_path, ".txt", 5.0)
    assert kind(tmp_path) == 5
    assert kind(tmp_path / "cameras.json") == 1


def names(count: int) -> list[Image]:
    return [Image(f"{i}.jpg", image_id=i) for i in range(count)]


@both_forms
def test_the_model_with_the_most_images_is_read(suffix, tmp_path, caplog):
    for number, count in ((0, 2), (2, 3), (10, 5), (11, 1)):
        write_model(tmp_path / "sparse" / str(number), suffix, names(count))
    assert len(read_cameras(tmp_path)) == 5
    assert caplog.messages == [
        f"{tmp_path}: 4 COLMAP models (images: sparse/0 2, sparse/2 3, sparse/10 5, sparse/11 1); "
        "using sparse/10"
    ]
    assert len(read_cameras(tmp_path / "sparse" / "2")) == 3
    path = tmp_path / "sparse" / "11" / f"images{suffix}"
    path.write_bytes(b"1 broken")
    assert_refused(tmp_path, told=path)
    caplog.clear()
    for number in (0, 2, 10):
        (tmp_path / "sparse" / str(number) / f"cameras{suffix}").unlink()
    assert_refused(tmp_path, told=path)
    path.write_bytes(WRITERS[suffix][1](names(1)))
    assert len(read_cameras(tmp_path)) == 1
    assert not caplog.messages


@pytest.mark.parametrize(
    "place",
    ["sparse/1", "colmap/sparse/0", "colmap/sparse", "dense/0/sparse", "dense/sparse",
     "dense/1/sparse", "distorted/sparse/0"],
)  # fmt: skip
def test_models_are_found_where_programs_put_them(place, tmp_path):
    write_kind(tmp_path / place, ".bin", 2.0)
    assert kind(tmp_path) == 2
    # nerfstudio prefers its own cameras to COLMAP's.
    write_json(tmp_path / "cameras.json", inria_entry(fx=1.0))
    assert kind(tmp_path) == (2 if place.startswith("sparse") else 1)


def test_models_in_other_folders_are_named(tmp_path):
    for place in ("a/sparse/0", "b c/model"):
        write_kind(tmp_path / place, ".txt", 2.0)
    assert_refused(tmp_path, "nor transforms.json; COLMAP models are in 'a/sparse/0', 'b c/model'$")


def test_cameras_of_llff_are_named(tmp_path):
    (tmp_path / "poses_bounds.npy").write_bytes(b"\x93NUMPY")
    assert_refused(tmp_path, "nor transforms.json; poses_bounds.npy of LLFF is not read$")


def test_incomplete_model_is_ignored(tmp_path):
    write_kind(tmp_path, ".bin", 2.0)
    write_kind(tmp_path, ".txt", 3.0)
    (tmp_path / "images.bin").unlink()
    assert kind(tmp_path) == 3
    (tmp_path / "cameras.txt").unlink()
    assert_refused(tmp_path, "neither a COLMAP model .*nor cameras.json nor transforms.json")
    with pytest.raises(InvalidInput, match=r"both \.bin or \.txt"):
        read_cameras(tmp_path / "cameras.bin")
    write_json(tmp_path / "cameras.json", inria_entry(fx=4.0))
    assert kind(tmp_path) == 4


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("missing.json", "no such file"),
        ("missing", "no such file"),
        ("x" * 300, "no such file"),
        ("scene.ply", "expected a .json file"),
        ("folder", "neither"),
        ("pipe.json", "no such file"),
    ],
    ids=["json", "folder", "long", "ply", "empty folder", "pipe"],
)
def test_path_without_cameras_is_refused_in_one_line(name, message, tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "scene.ply").write_bytes(b"ply\n")
    if hasattr(os, "mkfifo"):
        # Reading a pipe without a writer would block for ever.
        os.mkfifo(tmp_path / "pipe.json")
    with pytest.raises(InvalidInput, match=message) as caught:
        read_cameras(tmp_path / name)
    assert str(caught.value).startswith(f"{printable(str(tmp_path / name))}: ")
    assert len(str(caught.value).splitlines()) == 1


def test_a_path_that_no_file_can_have_is_refused_in_one_line(tmp_path):
    with pytest.raises(InvalidInput, match="expected a possible path") as caught:
        read_cameras(tmp_path / "zero\0")
    assert str(caught.value).startswith("path: ")
    assert len(str(caught.value).splitlines()) == 1

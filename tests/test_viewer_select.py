"""The tools that select, in a real window on a separate display."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest
from windows import crossings, drive, make_folder, needs_display

from gs_codec.files.scenes import read_scene
from gs_codec.scene import SH_C0
from viewer.window.keys import KEYS

pytestmark = [needs_display, pytest.mark.slow]


def test_no_key_has_two_meanings():
    codes = [(key.code, key.control) for key in KEYS if key.code is not None]
    assert len(set(codes)) == len(codes)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return make_folder(tmp_path_factory)


@pytest.fixture(scope="module")
def found(display, folder) -> dict:
    return drive("drive_select.py", display, folder)


@pytest.fixture(scope="module")
def pixels(found, folder) -> np.ndarray:
    """Pixels of the centres of A; far outside the picture for those behind the camera."""
    rotation, position, (fx, fy, cx, cy) = found["pose"]
    x, y, depth = np.array(rotation) @ (read_scene(folder / "a.ply").positions.T - position).T
    pixels = np.stack([fx * x / depth + cx, fy * y / depth + cy], axis=1)
    pixels[depth <= 0.2] = -1e6
    return pixels


def in_corners(pixels: np.ndarray, corners: list) -> list[int]:
    polygon = [(x + 0.5, y + 0.5) for x, y in corners]
    return [k for k, (x, y) in enumerate(pixels.tolist()) if crossings(x, y, polygon) % 2]


def test_clicks_make_a_polygon_that_enter_or_its_first_corner_closes(found, pixels):
    corners, chosen = found["polygon"]
    assert len(chosen) > 20
    assert chosen == in_corners(pixels, corners)
    assert found["rubber"] > 50  # the next side follows the mouse
    assert found["closed"] == in_corners(pixels, corners[:3])
    assert found["dropped"] == [found["closed"], False]


def test_a_brush_selects_what_it_passes_and_shows_it_at_once(found, pixels):
    path, chosen = found["brush"]
    near = np.zeros(len(pixels), bool)
    for start, end in zip(path[:-1], path[1:], strict=True):
        for share in np.linspace(0, 1, 200):
            at = (1 - share) * np.array(start) + share * np.array(end) + 0.5
            near |= np.linalg.norm(pixels - at, axis=1) <= 15
    assert len(chosen) > 20
    assert len(set(chosen) ^ set(np.flatnonzero(near).tolist())) <= 2
    magenta, all_changed = found["painted"]
    assert all_changed > magenta > 60
    assert found["radius"] == 20
    both = set(found["intersected"])
    assert 0 < len(both) < len(chosen)
    assert both < set(chosen)


def test_spheres_colours_and_floods_begin_at_the_gaussian_under_the_mouse(found, folder):
    scene, seed = read_scene(folder / "a.ply"), found["seed"]
    rotation, position, (fx, *_) = found["pose"]
    centres = scene.positions.T.astype(float)
    depth = (np.array(rotation) @ (centres[seed] - position))[2]
    away = np.linalg.norm(centres - centres[seed], axis=1)
    sphere = np.flatnonzero(away <= 50 / fx * depth)
    assert 10 < len(sphere) < scene.count
    assert found["sphere"] == sphere.tolist()
    colours = np.clip(0.5 + SH_C0 * scene.f_dc.T, 0, 1)
    same = np.abs(colours - colours[seed]).max(axis=1) <= 50 / 255 + 1e-6
    assert found["colour"] == np.flatnonzero(same).tolist()
    flood, grown = set(found["flood"]), set(found["Grow"])
    assert seed in flood
    assert flood <= set(found["colour"])
    assert flood < grown
    assert flood <= set(found["Shrink"]) < grown


def test_the_command_of_all_but_a_sphere_crops_by_it(found, folder, run_codec, monkeypatch):
    words = shlex.split(found["command"])
    assert words[-1].startswith("--crop-sphere=")
    monkeypatch.chdir(folder)
    assert run_codec(*words[1:])[0] == 0
    assert (folder / "a-edited.ply").read_bytes() == (folder / "sphere.ply").read_bytes()
    assert read_scene(folder / "sphere.ply").count == len(found["sphere"])
    (folder / "a-edited.ply").unlink()


def test_boxes_select_by_footprints_and_only_what_is_seen(found, pixels):
    names = "False False", "False True", "True False", "True True"
    centres, front, wide, seen = (set(found[name]) for name in names)
    corners = [(70, 60), (160, 60), (160, 150), (70, 150)]
    assert centres == set(in_corners(pixels, corners))
    assert len(front) > 5
    assert front < centres
    assert len(centres - wide) < 0.02 * len(centres)  # alpha is too low
    assert seen < wide
    assert seen - centres


def test_the_status_is_empty_after_selecting(found):
    assert found["idle"] == ""


@pytest.fixture(scope="module")
def placed(display, folder) -> dict:
    return drive("drive_place.py", display, folder)


def test_handles_move_turn_and_scale(placed):
    assert placed["red"] > 30
    for kind in ("shift", "move", "turn", "scale"):
        linear, shift = np.split(np.array(placed[kind])[:3], [3], axis=1)
        factor = np.cbrt(np.linalg.det(linear))
        turned = np.abs(linear / factor - np.eye(3)).max() > 0.01
        assert (turned, abs(factor - 1) > 0.01) == (kind == "turn", kind == "scale")
        assert np.abs(shift).max() > 0.01
        assert (np.abs(shift[1:]).max() < 1e-9) == (kind == "move")
    assert placed["back"] < 1e-6
    assert placed["beside"] == [True, 0]  # the camera moves


def test_numbers_place_the_selection(placed):
    matrix, middle = np.array(placed["numbers"]), np.array(placed["middle"])
    found = (matrix @ [*middle, 1])[:3] - middle
    np.testing.assert_allclose(found, [0.1, 0.2, 0.3], atol=1e-5)
    expected = 0.5 * np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    np.testing.assert_allclose(matrix[:3, :3], expected, atol=1e-6)
    assert placed["moved"] == 2174


def test_scenes_are_joined_and_saved_as_a_project(placed, folder, run_codec, monkeypatch):
    assert placed["caption"] == " A: a.ply + b.egs, edited"
    assert placed["again"] == [[["a.ply", 3000], ["coded", 3000]], True]
    assert not placed["unsaved"]
    words = shlex.split(placed["command"])
    assert words[-1] == "--edits=both.gsproj"
    monkeypatch.chdir(folder)
    assert run_codec(*words[1:])[0] == 0
    assert (folder / "a-edited.ply").read_bytes() == (folder / "both.ply").read_bytes()

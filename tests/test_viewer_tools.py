"""The camera path and other tools of the viewer's window, driven as in test_viewer_window.py."""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from windows import drive, make_folder, needs_display

import gs_codec
from gs_codec.files.annotations import read_annotations
from viewer.window import annotating
from viewer.window.annotating import Annotating
from viewer.window.file_dialog import Files
from viewer.window.watching import newest

pytestmark = [needs_display, pytest.mark.slow]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return make_folder(tmp_path_factory)


@pytest.fixture(scope="module")
def found(display, folder) -> dict:
    return drive("drive_tools.py", display, folder)


def test_keyframes_are_kept_replaced_and_put_between_others(found):
    first, later = found["enabled"]
    assert first == ["Keep", "Open", "Timeline"]
    assert later == ["Keep", "Set", "Drop", "Fly", "Even", "Film", "Save", "Open", "Timeline"]
    now = found["scrubbed"][0]
    assert found["between"] == pytest.approx([0, now, found["times"][-1][1], 4])


def test_times_are_dragged_between_neighbours(found):
    at_first, dragged, clipped, last = found["times"]
    assert at_first == [0, 2, 4]
    assert dragged == pytest.approx([0, 3, 4], abs=0.05)
    assert clipped == pytest.approx([0, 4, 4], abs=0.05)
    assert last == pytest.approx([0, 2, 4], abs=0.05)
    assert found["chosen"] == 1
    assert found["at key"]


def test_the_timeline_looks_along_the_path(found):
    now, apart = found["scrubbed"]
    assert now == pytest.approx(1, abs=0.05)
    assert apart < 1e-9


def test_a_film_of_too_many_frames_is_refused(found):
    assert found["long"] == "5,000,000,001 frames, expected at most 99,999"


def test_the_path_is_flown_filmed_saved_and_opened(found, folder):
    assert found["flown"]
    assert found["ends"][0] > 0.1
    assert found["ends"][-1] < 1e-9
    if find_spec("imageio_ffmpeg") is not None:
        assert found["film"] == "film.mp4 saved: 6 frames"
        assert (folder / "film.mp4").read_bytes()[4:8] == b"ftyp"
    assert not [path for path in folder.iterdir() if "stopped" in path.name]
    assert max(found["apart"]) < 1e-9
    times, fps = found["again"]
    assert times == pytest.approx([0, 0.5, 1], abs=0.02)
    assert fps == 5
    assert found["unsaved"] == [False, False]  # once saved, and once opened
    assert len(gs_codec.read_cameras(folder / "path.json")) == 6
    title, text = found["message"]
    assert title == "Not possible"
    assert text.startswith("nothing.json: no such file")


def test_distances_are_measured_on_what_is_seen_and_set_the_scale(found):
    assert max(map(max, found["off"])) < 1e-4
    distance, expected = found["distance"]
    assert distance == expected > 0
    label, said = found["measured"]
    assert label == f" {2 * distance:.4g} "
    assert said == f"{distance:.5g} scene units = {2 * distance:.5g}\ngs-codec convert --scale 2"
    assert found["drawn"] > 40
    assert found["scaled"] == [0.0, "--transform=2,0,0,0,0,2,0,0,0,0,2,0"]
    assert found["after scaling"] == [1.0, "scaled by 2"]
    assert max(found["seen from"]) < 1e-6  # the camera goes with the scene, and back
    assert found["left"] <= 4
    assert not found["picked"]


def test_annotations_are_clicked_titled_and_saved_for_pages(found, folder):
    assert found["annotates alone"]
    assert found["annotated"] < 1e-3
    assert found["titled"] == ["Ear", "Annotation 2"]
    assert found["tag"] == " 1: Ear "
    assert found["over B"] > 200
    assert found["rings"] > 40
    first, second = read_annotations(folder / "notes.json")
    assert (first.title, second.title, first.text) == ("Ear", "Annotation 2", "")
    assert not found["asks again"]
    assert found["without rings"] <= 4


def test_a_short_length_has_all_its_digits(found):
    assert found["digits"] == 8  # 0.00003000


def test_an_annotation_far_from_0_is_where_it_was_clicked(monkeypatch):
    point = np.array([500_000.3712, -4_000_001.3712, 1.3712])
    pose = SimpleNamespace(project=None)
    stage = SimpleNamespace(pose=pose, picture_size=(9, 9), overlays={}, arrange=Mock())
    viewer = SimpleNamespace(stage=stage, panel=Mock(), modal=SimpleNamespace(cancels=[]))
    monkeypatch.setattr(annotating, "find_point", lambda *of: of[-1](point))
    notes = Annotating(viewer)
    notes.on = True
    notes.click(None, (1, 1))
    np.testing.assert_allclose(notes.notes[0].position, point, atol=1e-3)


def test_what_was_put_on_a_scene_goes_where_all_of_it_goes(found):
    assert found["put"] == 7  # annotations, measured points, keyframes
    assert found["follows"] == ["goes", "stays", "goes", "stays"]


def test_a_point_found_after_annotating_ended_is_not_added(found):
    assert found["late"] == 0


def test_what_was_said_of_a_click_is_not_said_of_the_next(found):
    assert found["said"] == ""


def test_changed_files_are_reported_or_reloaded_from_the_same_pose(found):
    count, said = found["changed"]
    assert count == 1001
    assert " ".join(said.split()) == "cloud.ply has changed on disk: ctrl + R reloads it"
    assert found["reloaded"] == [[1002, 1003, 1004], True, "model/iteration_30/cloud.ply"]
    assert found["edited"] == 1000  # unsaved edits are kept
    assert found["cloud"] == ""  # it has no file


def test_the_newest_file_has_the_largest_number(tmp_path):
    names = ("iteration_7/cloud.ply", "iteration_30/cloud.ply", "iteration_99/other.ply",
             "iteration_x/cloud.ply", "out/export_500.ply", "out/export_1000.ply",
             "out/export_2000.txt", "out/2.ply")  # fmt: skip
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert newest(tmp_path / names[0]) == tmp_path / names[1]
    assert newest(tmp_path / names[4]) == tmp_path / names[5]
    for name in (names[1], names[2], names[5], names[7], "gone_1/cloud.ply"):
        assert newest(tmp_path / name) == tmp_path / name


def test_without_reading_a_folder_there_is_no_newer_file(tmp_path, monkeypatch):
    def denied(_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "listdir", denied)
    assert newest(tmp_path / "export_1.ply") == tmp_path / "export_1.ply"


def test_dialogs_list_a_folder_that_exists(tmp_path):
    files = Files(None, SimpleNamespace(scenes=[]))
    assert files._folder(tmp_path / "removed" / "a.ply") == tmp_path
    files._last = tmp_path / "removed" / "too"
    assert files._folder(Path()) == tmp_path

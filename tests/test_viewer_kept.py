"""What is kept in the viewer's window while jobs run, or fail."""

from __future__ import annotations

import pytest
from windows import drive, make_folder, needs_display

pytestmark = [needs_display, pytest.mark.slow]


@pytest.fixture(scope="module")
def found(display, tmp_path_factory) -> dict:
    return drive("drive_kept.py", display, make_folder(tmp_path_factory))


def test_each_of_several_saves_writes_its_file(found):
    assert found["saves"] == [True] * 4


def test_escape_clears_the_pick_after_closing_was_cancelled(found):
    assert found["escape"]


def test_a_window_closes_once_files_and_films_are_saved_and_stays_if_that_fails(found):
    assert found["close"] == [False] * 4 + [True, True, 6]


def test_a_stroke_ends_when_its_gaussians_are_deleted_and_leaves_no_preview(found):
    (every, some), deleted, dropped, same = found["brush"]
    assert some > 0
    assert deleted == dropped == [every - some, 0]
    assert same


def test_a_drag_with_a_tool_ends_when_another_button_is_released(found):
    plain, other, still = found["buttons"]
    assert 0 < other < plain
    assert still


def test_scenes_whose_cameras_cannot_be_read_can_be_edited(found):
    assert found["fails"] == ["photographs: need cameras from a file", True]


def test_transparent_parts_of_photographs_show_the_background(found):
    assert found["transparent"] == [[51, 0, 0], [51, 204, 0]]


def test_a_scene_that_is_loaded_is_not_dropped_for_something_else(found):
    said = "loading b.egs: wait for it, or stop it (Backspace)"
    assert found["several"] == [*[said] * 3, "loading b.egs ... 0 %", ["b.egs", "b.egs"]]


def test_an_encoding_without_room_for_it_is_reported(found):
    text, doing = found["full"]
    assert text.endswith(": No such file or directory")
    assert doing is None


def test_a_scene_is_added_to_the_one_chosen_before(found):
    first, said, second, other = found["added"]
    assert (first, said) == (["a.ply + a.ply", "b.egs"], "")
    assert (second, other) == (
        ["a.ply", "b.egs"], "a.ply not added, because another scene was opened"
    )  # fmt: skip


def test_a_scene_edited_while_it_is_read_again_is_kept(found):
    said = "not reloaded, because the scene was edited: ctrl + R reloads it"
    assert found["reload"] == [said, ""]


def test_the_limit_applies_to_scenes_opened_later(found):
    assert len(found["limit"]) == 2
    assert all("1,000" in said for said in found["limit"])


def test_lengths_are_of_all_clicks_and_of_the_scene_shown(found):
    count, text, after, unit, other = found["lengths"]
    assert count == 2
    assert "= 7" in text
    assert after == 0
    assert (unit, other) == (1, "Click two points.\n")


def test_pictures_of_a_tiny_window_are_saved(found):
    assert len(found["tiny"]) == 3
    assert all(high >= 64 and 62 <= wide < 100 for wide, high in found["tiny"])


def test_measured_views_are_named_after_the_cameras_they_were_measured_with(found):
    assert found["measured"] == ["views", "estimated views"]


def test_a_converted_scene_is_converted_again_when_its_file_changes(found):
    assert found["reload_turned"] == ["RUB", "RUB", "RDF"]


def test_a_project_is_not_replaced_by_its_scene(found):
    before, after = found["reload_project"]
    assert before == after == 2990


def test_edits_in_a_project_are_not_lost_when_the_file_changes(found):
    placed, saved, count, unsaved, said, back, off = found["watched_project"]
    assert placed == [-4, 2, 7]
    assert back == [1, 2, 3]  # what was put on the scene goes back with it
    assert off < 1e-6
    assert (saved, count, unsaved) == (False, 2990, True)
    assert said == ": changed after it was opened"


def test_short_memory_is_reported_and_the_window_stays_open(found):
    assert found["memory"] == [*["not enough memory"] * 2, "a.ply: Permission denied"]


def test_a_dialog_stays_open_while_jobs_fail(found):
    assert found["question"] == [True, "first", "second", None]

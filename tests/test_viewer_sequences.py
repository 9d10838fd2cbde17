"""Sequences in the viewer: frames as scenes, and a window that plays them."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
from moving_scenes import coded, moving
from windows import drive, needs_display

import gs_codec
from gs_codec.formats.ply.file import read_ply
from gs_codec.formats.ply.writer import write_ply
from gs_codec.scene import ANTIALIASED
from gs_codec.sequences.frame_decoding import opened_sequence
from viewer.scenes.clip import Clip, Moment
from viewer.scenes.frame_scenes import at_moment, open_frame
from viewer.scenes.opened import open_scene
from viewer.scenes.pose import look_at
from viewer.scenes.saving import open_file, save_scene
from viewer.scenes.view_request import Request

GROUP, FRAMES = 3, 6


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A sequence in one file and in a folder, and a scene."""
    folder = tmp_path_factory.mktemp("sequence")
    scenes = moving(1200, FRAMES, 1)
    coded(folder / "moving.egs", scenes, group=GROUP)
    (folder / "frames").mkdir()
    for number, scene in enumerate(scenes):
        write_ply(folder / "frames" / f"{number}.ply", scene)
    with ZipFile(folder / "frames.zip", "w") as archive:
        for path in sorted((folder / "frames").iterdir()):
            archive.write(path, path.name)
    write_ply(folder / "a.ply", scenes[0])
    camera = look_at(np.array([0.0, 0.0, -4.0]), np.zeros(3)).camera(200, 150)
    (folder / "cameras.json").write_text(json.dumps([camera | {"img_name": "front"}]))
    return folder


@pytest.fixture(scope="module")
def found(display, folder) -> dict:
    return drive("drive_play.py", display, folder)


def test_frames_are_the_decoded_ones_in_any_order(folder):
    with opened_sequence(folder / "moving.egs") as sequence:
        expected = [scene.positions.T for scene in sequence.frames()]
    clip = Clip(folder / "moving.egs")
    for number in (4, 0, 5, 5, 2, 1, 3):
        frame = open_frame(clip, number)
        np.testing.assert_array_equal(frame.positions, expected[number])
        assert frame.name == f"moving.egs, frame {number}"
        assert not frame.is_stored
    assert len(clip._groups) == 2


def test_opening_a_sequence_as_a_scene_warns_once(folder, caplog):
    open_scene(folder / "moving.egs")
    assert [each.getMessage() for each in caplog.records] == ["only the first of 6 frames is read"]


def test_frames_keep_the_antialias_flag_and_are_saved_with_it(folder, tmp_path):
    (tmp_path / "frames").mkdir()
    for number in range(2):
        scene = read_ply(folder / "frames" / f"{number}.ply")
        flagged = replace(scene, comments=(ANTIALIASED,))
        write_ply(tmp_path / "frames" / f"{number}.ply", flagged)
    frame = open_file(tmp_path / "frames")
    assert frame.gaussians.antialiased
    save_scene(frame, tmp_path / "frame.ply")
    assert read_ply(tmp_path / "frame.ply").antialiased


def test_a_frame_is_not_saved_over_its_sequence(folder, tmp_path):
    shutil.copy(folder / "moving.egs", tmp_path)
    path = tmp_path / "moving.egs"
    with pytest.raises(gs_codec.InvalidInput, match="input and output are the same file"):
        save_scene(open_file(path), path)
    assert path.read_bytes() == (folder / "moving.egs").read_bytes()


def test_a_frame_that_cannot_be_read_leaves_the_others(folder, tmp_path):
    data = bytearray((folder / "moving.egs").read_bytes())
    data[-9] ^= 1
    (tmp_path / "damaged.egs").write_bytes(data)
    clip = Clip(tmp_path / "damaged.egs")
    for _ in range(2):
        with pytest.raises(gs_codec.CorruptStream):
            clip.read(FRAMES - 1)
        assert clip.read(0).count == 1200


def test_a_frame_that_is_no_longer_wanted_keeps_what_is_decoded(folder):
    clip, asked = Clip(folder / "moving.egs"), []

    def progress(_: str, done: int, total: int) -> None:
        asked.append(done)
        if len(asked) == 3:
            raise gs_codec.GsCodecError("another frame is wanted")

    with pytest.raises(gs_codec.GsCodecError, match="another"):
        clip.read(2, progress)
    clip.read(2, progress)
    assert asked == [0, 1, 2, 2]


@pytest.mark.parametrize(
    ("number", "step", "loop", "expected"),
    [
        (4, 1, True, 5),
        (5, 1, True, 0),
        (4, 3, True, 1),
        (2, FRAMES, True, 1),
        (2, 99, True, 1),
        (4, 1, False, 5),
        (2, 99, False, 5),
        (5, 1, False, None),
    ],
)
def test_another_frame_is_next_however_long_drawing_takes(folder, number, step, loop, expected):
    assert Moment(Clip(folder / "frames"), number).after(step, loop) == expected


@pytest.mark.parametrize("loop", [True, False])
def test_a_single_frame_does_not_play(folder, tmp_path, loop):
    (tmp_path / "0.ply").write_bytes((folder / "frames" / "0.ply").read_bytes())
    assert Moment(Clip(tmp_path), 0).after(1, loop) is None


@pytest.mark.parametrize(
    ("fps", "expected"), [((None, 25.0), [3, 3]), ((25.0, 50.0), [3, 5]), ((50.0, 25.0), [3, 1])]
)
def test_sequences_are_shown_at_the_same_moment(folder, fps, expected):
    clips = [Clip(folder / "frames") for _ in fps]
    for clip, each in zip(clips, fps, strict=True):
        clip.fps = each
    found = at_moment([open_frame(clip, 0) for clip in clips], 3)
    assert [scene.moment.number for scene in found] == expected


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["a.ply", "--frame", "1"], "frame: expected a sequence"),
        (["moving.egs", "--frame", "6"], "frame 6: expected 0 to 5"),
        (["moving.egs", "--frame", "-1"], "frame -1: expected 0 to 5"),
        (["frames/*.ply", "moving.egs", "--frame", "9"], "frame 9: expected 0 to 5"),
        (["--frame", "0"], "no scene to show"),
    ],
)
def test_frames_that_do_not_exist_are_refused(
    folder, tmp_path, run_viewer, monkeypatch, arguments, said
):
    monkeypatch.chdir(folder)
    out = tmp_path / "out.png"
    result = run_viewer(*arguments, "--screenshot", str(out))
    assert result.status == 2
    assert said in result.err.splitlines()[-1]
    assert not out.exists()


def test_pictures_of_a_frame(folder, tmp_path, run_viewer):
    for number in (0, 5):
        out = tmp_path / f"{number}.png"
        given = "moving.egs", "--frame", str(number), "--screenshot", str(out), "--width", "200"
        assert run_viewer(str(folder / given[0]), *given[1:]).status == 0
    assert (tmp_path / "0.png").read_bytes() != (tmp_path / "5.png").read_bytes()


@pytest.mark.parametrize("source", ["frames", "frames/*.ply", "frames.zip"])
def test_frames_that_are_not_encoded_are_no_page(folder, run_viewer, monkeypatch, source):
    monkeypatch.chdir(folder)
    result = run_viewer("--web", source)
    assert result.status == 2
    assert f"{source}: a " in result.err
    assert " of 6 files, expected one file; if they are the frames of a sequence, " in result.err


def test_watching_a_sequence_is_refused(folder):
    with pytest.raises(gs_codec.GsCodecError, match="watch: has no effect on a sequence"):
        Request(folder / "moving.egs", watch=True).scenes()


@pytest.mark.thorough
@needs_display
@pytest.mark.slow
class TestWindow:
    def test_both_sequences_show_the_frame_that_the_slider_names(self, found):
        assert found["at first"] == [1, 1, 1]
        assert found["dragged"] == [[5, 5, 5], [3, 3, 3]]
        assert len(set(found["pictures"])) == 3
        assert found["names"] == [" A: moving.egs, frame 3", " B: frames, frame 3"]

    def test_it_plays_to_the_end_or_in_a_loop(self, found):
        assert found["played"] == [5, 5, 5]
        assert found["again"] == [0, 5, 5]
        assert len(set(found["stopped"])) == 1

    def test_an_edited_frame_is_saved_and_asked_about(self, found, folder):
        saved = gs_codec.read(folder / "frame.ply")
        assert len(saved.point.positions) == found["saved"] < 1200
        assert "a frame of a sequence, expected files" in found["command"][1]
        assert found["beyond"] == [5, False]
        assert found["asked"] == [2, 2, 2]
        assert found["left"] == [3, 3]

    def test_it_stops_at_a_frame_that_is_edited(self, found):
        assert found["edited"] == [False, [0], True]

    def test_a_trial_of_a_frame_goes_with_it(self, found):
        assert found["trial"] == [5, None]
        assert found["trial left"] == [4]
        assert found["bar"] == 0

    def test_the_dialog_opens_zips_and_folders_of_frames(self, found):
        assert found["opened"] == [" A: frames.zip, frame 0", " A: frames, frame 0"]

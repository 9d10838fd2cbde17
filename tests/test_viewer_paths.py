"""Typed paths in dialogs: listings and suggestions."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import gs_codec
from viewer.scenes import typed_paths
from viewer.scenes.typed_paths import (
    CAMERAS,
    FOLDERS,
    PICTURES,
    SAVED_SCENES,
    SCENES,
    SEQUENCES,
    check_readable,
    first_folder,
    listed,
    suggested,
    to_write,
    typed_path,
)


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """A home folder with a folder of scenes; the working directory is elsewhere."""
    scenes = tmp_path / "scenes"
    scenes.mkdir()
    (tmp_path / "elsewhere").mkdir()
    for name in ("b.PLY", "A.egs", "c d.ply", "notes.txt", ".hidden.ply", "x.png", "Z.zip"):
        (scenes / name).write_text("x")
    (tmp_path / "elsewhere" / "here.ply").write_text("x")
    (scenes / "Sub").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path / "elsewhere")
    return scenes


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("b.PLY", "scenes/b.PLY"),
        ("Sub", "scenes/Sub"),
        ("new.ply", "scenes/new.ply"),
        ("here.ply", "elsewhere/here.ply"),
        ("~/scenes/b.PLY", "scenes/b.PLY"),
        ("'~/scenes/c d.ply'", "scenes/c d.ply"),
        ('  "c d.ply"\n', "scenes/c d.ply"),
        ("b.PLY\nA.egs", "scenes/b.PLY"),
        ("", "scenes"),
    ],
)
def test_paths_are_typed_and_pasted(folder, text, expected):
    assert typed_path(text, folder) == folder.parent / expected


def test_files_are_saved_to_the_folder_listed(folder):
    assert typed_path("here.ply", folder, saves=True) == folder / "here.ply"


@pytest.mark.parametrize(
    "text", ["{}/c d.ply", "file://{}/c%20d.ply", "file://localhost{}/c d.ply"]
)
def test_whole_paths_and_addresses_of_files_are_pasted(folder, text):
    assert typed_path(text.format(folder), Path("/")) == folder / "c d.ply"


@pytest.mark.parametrize(
    ("name", "kind", "said"),
    [
        ("none.ply", SCENES, "no such file"),
        ("none", FOLDERS, "no such folder"),
        ("Sub", SCENES, "not a file"),
        ("A.egs", FOLDERS, "not a folder"),
        ("empty.ply", SCENES, "an empty file"),
        ("pipe.ply", SCENES, "not a file"),
    ],
)
def test_unreadable_paths_are_reported_in_a_line(folder, name, kind, said):
    (folder / "empty.ply").touch()
    os.mkfifo(folder / "pipe.ply")
    with pytest.raises(gs_codec.InvalidInput) as caught:
        check_readable(folder / name, kind)
    assert str(caught.value) == f"{folder / name}: {said}"


def test_a_file_without_permission_is_reported(folder, monkeypatch):
    def denied(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", denied)
    with pytest.raises(gs_codec.InvalidInput, match=r"b\.PLY: Permission denied$"):
        check_readable(folder / "b.PLY", SCENES)


def test_a_folder_lists_its_folders_and_then_its_files_of_a_kind(folder, monkeypatch):
    (folder / os.fsdecode(b"\xff.ply")).touch()  # no widget can display it
    assert listed(folder, SCENES) == ["../", "Sub/", "A.egs", "b.PLY", "c d.ply"]
    assert listed(folder, SEQUENCES) == ["../", "Sub/", "A.egs", "b.PLY", "c d.ply", "Z.zip"]
    assert listed(folder, CAMERAS) == ["../", "Sub/", "notes.txt"]
    assert listed(folder, FOLDERS) == ["../", "Sub/"]
    monkeypatch.setattr(typed_paths, "MOST", 3)
    assert listed(folder, SCENES) == ["../", "Sub/", "A.egs"]
    with pytest.raises(gs_codec.InvalidInput, match="none: No such file or directory"):
        listed(folder / "none", SCENES)


@pytest.mark.parametrize(
    ("name", "kind", "suffix", "written"),
    [
        ("new", PICTURES, ".png", "new.png"),
        ("new.PNG", PICTURES, ".png", "new.PNG"),
        ("new", SAVED_SCENES, ".compressed.ply", "new.compressed.ply"),
        ("new.compressed.ply", SAVED_SCENES, ".egs", "new.compressed.ply"),
        ("b.PLY", SAVED_SCENES, ".egs", "b.PLY"),
    ],
)
def test_a_name_gets_a_suffix_if_it_has_none(folder, name, kind, suffix, written):
    assert to_write(folder / name, kind, suffix) == folder / written


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("a.jpg", r"a\.jpg: suffix '\.jpg', expected \.png"),
        ("none/a.png", "no directory"),
        ("Sub.png", "a directory, expected a file name"),
    ],
)
def test_unwritable_paths_are_reported(folder, name, said):
    (folder / "Sub.png").mkdir()
    with pytest.raises(gs_codec.InvalidInput, match=said):
        to_write(folder / name, PICTURES, ".png")


@pytest.mark.parametrize(
    ("scene", "suffix", "mark", "name"),
    [
        ("a.ply", ".png", "", "a.png"),
        ("x.ply", ".png", "", "x-2.png"),
        ("a.compressed.ply", ".compressed.ply", "-edited", "a-edited.compressed.ply"),
        ("A.ply", ".egs", "", "A-2.egs"),
        ("Z.zip", ".egs", "-edited", "Z-edited.egs"),
        ("", ".png", "", "scene.png"),
    ],
)
def test_suggested_names_are_unused(folder, scene, suffix, mark, name):
    assert suggested(folder, Path(scene), suffix, mark) == name


def test_another_format_changes_only_the_suffix():
    assert SAVED_SCENES.named("a.b.compressed.ply", ".egs") == "a.b.egs"
    assert SAVED_SCENES.named("a.b", ".egs") == "a.b.egs"


@pytest.mark.parametrize(
    "text",
    ["a\0.ply", "file:///a%00.ply", "file://[a/b.ply", "~\0/a.ply", "a\ud800.ply"],
    ids=ascii,
)
@pytest.mark.parametrize("saves", [False, True])
def test_what_is_no_path_is_refused(folder, text, saves):
    with pytest.raises(gs_codec.InvalidInput, match="not a path"):
        typed_path(text, folder, saves)


def test_dialogs_begin_elsewhere_if_the_working_directory_was_removed(folder, monkeypatch):
    (folder / "gone").mkdir()
    monkeypatch.chdir(folder / "gone")
    (folder / "gone").rmdir()
    assert first_folder(Path("a.ply")) == first_folder(Path()) == Path(os.sep)
    assert first_folder(folder / "a.ply") == folder

"""The list of recently opened files."""

from __future__ import annotations

import pytest

from viewer.scenes.recent import MOST, recent_files, remember


@pytest.fixture(autouse=True)
def state(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state" / "gs-viewer" / "recent.json"


def test_the_newest_is_first_once_and_deleted_files_are_skipped(tmp_path):
    assert recent_files() == []
    paths = [tmp_path / f"{k}.ply" for k in range(MOST + 3)]
    for path in paths:
        path.touch()
        remember(path)
    assert recent_files() == paths[:2:-1]
    remember(paths[5])
    paths[-1].unlink()
    assert recent_files() == [paths[5], *(p for p in paths[-2:2:-1] if p != paths[5])]


@pytest.mark.parametrize("text", ["", "{", '{"a": 1}', "[1, null]", '["\\u0000"]', "[" * 9999])
def test_a_damaged_list_is_empty_and_is_replaced(state, tmp_path, text):
    state.parent.mkdir(parents=True)
    state.write_text(text)
    assert recent_files() == []
    remember(tmp_path)
    assert recent_files() == [tmp_path]


def test_an_unwritable_list_is_ignored(state, tmp_path):
    state.parent.mkdir(parents=True)
    state.mkdir()
    remember(tmp_path)
    assert recent_files() == []


def test_nothing_is_remembered_without_a_home(tmp_path, monkeypatch):
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setattr("os.path.expanduser", lambda path: path)
    monkeypatch.chdir(tmp_path)
    remember(tmp_path)
    assert recent_files() == []
    assert list(tmp_path.iterdir()) == []

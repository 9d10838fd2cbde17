"""The page by keyboard, screen reader, and with little sight, in Chromium."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from scenes import thorough
from web_pages import Job, decibels, in_browser, open_pages, seen

from gs_codec.cameras.camera_files import write_cameras
from gs_codec.codecs import encode_scene
from gs_codec.config import Config
from gs_codec.files.sharing import share
from gs_codec.views.estimate import auto_cameras
from samples.generate import generate

pytestmark = in_browser

#: A computer, a phone, a frame in another page.
SIZES = {"computer": (1280, 800), "phone": (390, 844), "frame": (700, 400)}

#: A white picture behind everything, which axe-core cannot see through a canvas.
WHITE = """(() => {
    document.getElementById('view').style.visibility = 'hidden';
    document.body.style.background = '#fff';
})()"""

OPEN = "['panel', 'keys'].forEach((id) => (document.getElementById(id).open = true))"

SAID = "document.getElementById('said').textContent"


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> str:
    folder = tmp_path_factory.mktemp("access")
    scene = generate(2000, 1, 12)
    cameras = auto_cameras(scene, 2)
    named = [replace(each, name=f"from {k}") for k, each in enumerate(cameras)]
    write_cameras(folder / "cameras.json", named)
    for name, coarseness in (("a", 1.0), ("b", 16.0)):
        config = Config("l", block_size=1024, coarseness=coarseness)
        (folder / f"{name}.egs").write_bytes(encode_scene(scene, config)[0])
    files = [folder / "a.egs", folder / "b.egs"]
    share(files, folder / "page.html", folder / "cameras.json")
    notes = [{"position": [0, 0, 0], "title": "Middle", "text": "Where it is.", "view": 1}]
    (folder / "notes.json").write_text(json.dumps(notes))
    noted = {"annotations": folder / "notes.json"}
    share(files, folder / "noted.html", folder / "cameras.json", **noted)
    return Path(folder / "page.html").as_uri()


@pytest.mark.parametrize("place", ["computer", thorough("phone"), thorough("frame")])
def test_axe_objects_to_nothing(page, place):
    """With the panel open, a wipe, an error view, an annotation, and a message."""
    noted = page.replace("page.html", "noted.html")
    job = Job(noted, [("drawn",), ("axe",), ("value", OPEN), ("key", "m")], SIZES[place])
    job.steps += [("drawn",), ("key", "4"), ("axe",), ("value", WHITE), ("axe",)]
    job.mobile = place == "phone"
    failed = Job(page, [("drawn",), ("axe",), ("value", WHITE), ("axe",)], SIZES[place])
    failed.before = "HTMLCanvasElement.prototype.getContext = () => null"
    for told in open_pages(job, failed):
        found = [value for value in told.values if isinstance(value, list)]
        assert len(found) >= 2
        assert found == [[]] * len(found)


def test_changes_are_said_once(page):
    job = Job(page, [("drawn",), ("until", f"{SAID} === 'A: a.egs, B: b.egs'"), ("key", "n")])
    job.steps += [("until", f"{SAID} === 'View 1: from 1'"), ("key", "2")]
    job.steps += [("until", f"{SAID} === 'Show B'"), ("value", OPEN), ("key", "u"), ("key", "4")]
    job.steps += [("until", f"{SAID} === 'Show Error, Up -y'"), ("focus", "#degree")]
    job.steps += [("choose", "#degree", "0"), ("value", "new Promise((f) => setTimeout(f, 700))")]
    job.steps += [("value", SAID), ("focus", "#link"), ("key", "o")]
    job.steps += [("until", f"{SAID} === 'Turn slowly on'"), ("key", "o")]
    job.steps += [("until", f"{SAID} === 'Turn slowly off'"), ("key", "c")]
    job.steps += [("until", f"{SAID}.startsWith('file:')")]
    job.before = "navigator.clipboard.writeText = () => Promise.reject()"
    [told] = open_pages(job)
    assert told.errors == []
    assert "Show Error, Up -y" in told.values  # a screen reader says the degree by itself


def test_everything_is_reached_by_keys(page):
    """The scene itself, the line of the wipe, and all controls, in the order on the page."""
    focused = "document.activeElement.id || document.activeElement.localName"
    job = Job(page, [("drawn",), ("value", OPEN)], SIZES["computer"])
    for _ in range(16):
        job.steps += [("key", "Tab"), ("value", focused)]
    [told] = open_pages(job)
    names = [value for value in told.values[2:] if value]
    assert names == [
        "view", "wipe", "summary", "input", "views", "ups", "degree", "background", "turn", "tour",
        "theme", "language", "full", "save", "link", "summary",
    ]  # fmt: skip


def test_keys_pan_and_zoom_as_the_mouse_does(page, tmp_path):
    moves = {
        "start": [],
        "aside": [("hold", "Shift+ArrowRight", 400)],
        "near": [("hold", "=", 400)],
        "back": [("hold", "-", 400)],
    }
    job = Job(page + "#show=a", [])
    for name, steps in moves.items():
        job.steps += [("key", "r"), ("drawn",), *steps]
        job.shot(str(tmp_path / f"{name}.png"))
    [told] = open_pages(job)
    assert told.errors == []
    shown = {name: seen(tmp_path / f"{name}.png") for name in moves}
    covered = {name: (picture.sum(axis=2) > 0.1).mean() for name, picture in shown.items()}
    assert covered["back"] < covered["start"] < covered["near"]
    assert decibels(shown["aside"], shown["start"]) < 35


def test_letters_may_be_switched_off(page):
    view = ("value", "document.getElementById('views').value")
    job = Job(page, [("drawn",), ("value", OPEN), ("click", "#letters"), ("key", "n"), view])
    job.steps += [("key", "Home"), ("click", "#letters"), ("key", "n"), view]
    [told] = open_pages(job)
    assert [value for value in told.values if value in ("0", "1")] == ["0", "1"]


def test_the_key_of_the_overview_leaves_the_panel_where_it_is(page):
    scrolled = ("value", "document.getElementById('panel').scrollTop")
    job = Job(page, [("drawn",), ("value", OPEN), ("focus", "#letters"), scrolled, ("key", "Home")])
    job.steps += [("value", "new Promise((f) => setTimeout(f, 700))"), scrolled]
    [told] = open_pages(job)
    before, after = told.values[3], told.values[-1]
    assert before == after > 0


def test_nothing_makes_the_page_scroll(page):
    beyond = "document.documentElement.scrollHeight - innerHeight"
    [told] = open_pages(Job(page, [("drawn",), ("value", beyond)]))
    assert told.values[-1] == 0


def test_a_clicked_scene_shows_no_ring_and_a_focused_one_does(page):
    ring = ("value", "getComputedStyle(document.getElementById('view')).outlineStyle")
    job = Job(page, [("drawn",), ("press",), ("key", "r"), ring])
    job.steps += [("focus", "#view"), ring]
    [told] = open_pages(job)
    assert [value for value in told.values if value in ("none", "solid")] == ["none", "solid"]

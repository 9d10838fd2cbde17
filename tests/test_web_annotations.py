"""Annotations of a page: points with titles and texts."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from web_pages import LENS, POSITIONS, SIZE, Job, in_browser, open_pages, small_page

from gs_codec.errors import InvalidInput
from gs_codec.files.annotations import Annotation, read_annotations, write_annotations

MARKUP = "<img src=x onerror=alert(1)> &amp; <b>"

NOTES = [
    {"position": [0, 0, 0], "title": "middle", "text": f"two\nlines {MARKUP}"},
    {"position": [1, 0.5, 1], "title": MARKUP, "view": 2},
    {"position": [0, 0, -9], "title": "behind"},
]

#: Number, visibility and centre of each annotation on the page.
PLACED = """[...document.querySelectorAll('#notes button')].map((one) => {
    const { x, y, width, height } = one.getBoundingClientRect();
    return [one.textContent, one.checkVisibility({ visibilityProperty: true }),
        x + width / 2, y + height / 2];
})"""

#: What the open annotation tells; null if none is open.
OPEN = """document.getElementById('note').checkVisibility()
    ? [...document.getElementById('note').children].slice(1).map((one) => one.textContent) : null"""


def written(folder: Path, notes: object) -> Path:
    path = folder / "notes.json"
    path.write_text(json.dumps(notes))
    return path


@in_browser
def test_annotations_are_at_their_points_and_open_as_plain_text(tmp_path):
    url = small_page(tmp_path, annotations=written(tmp_path, NOTES))
    job = Job(url, [("drawn",), ("value", PLACED), ("value", OPEN)])
    job.steps += [("click", "#notes button"), ("value", OPEN), ("key", "Escape"), ("value", OPEN)]
    job.steps += [("key", "m"), ("key", "m"), ("value", OPEN)]
    job.steps.append(("until", "location.hash.startsWith('#view=2&camera=0,1,-6,')"))
    job.steps.append(("value", "location.hash"))
    still = Job(url + "#note=2", [("drawn",), ("value", OPEN), ("key", "m"), ("key", "m")])
    still.before = "globalThis.matchMedia = () => ({ matches: true, addEventListener() {} })"
    still.steps += [("drawn",), ("value", PLACED)]
    opened, at_once = open_pages(job, still)
    for told in (opened, at_once):
        assert (told.state, told.errors) == ("ready", [])
    placed, address = opened.values[1], opened.values[-1]
    shown = [opened.values[k] for k in (2, 4, 6, 9)]
    scale = SIZE[0] / LENS["width"]
    for (number, is_seen, *centre), note in zip(placed[:2], NOTES, strict=False):
        x, y, z = (p - e for p, e in zip(note["position"], POSITIONS[0], strict=True))
        pixel = [
            LENS[f] * v / z + LENS[s] / 2 for f, s, v in (("fx", "width", x), ("fy", "height", y))
        ]
        assert (number, is_seen) == (str(NOTES.index(note) + 1), True)
        assert centre == pytest.approx([scale * p for p in pixel], abs=0.1)
    assert placed[2][:2] == ["3", False]
    assert shown == [None, ["middle", f"two\nlines {MARKUP}"], None, [MARKUP, ""]]
    assert address.endswith("&note=2")
    assert at_once.values[1] == [MARKUP, ""]
    # With reduced motion, the page turns to the point at once.
    assert at_once.values[-1][0][2:] == pytest.approx([SIZE[0] / 2, SIZE[1] / 2], abs=0.1)


@in_browser
def test_the_open_annotation_is_in_front_of_others(tmp_path):
    notes = [{"position": [0, 0, z], "title": f"{z}"} for z in (0, 0.01)]
    url = small_page(tmp_path, annotations=written(tmp_path, notes))
    front = f"document.elementFromPoint({SIZE[0] / 2}, {SIZE[1] / 2}).textContent"
    [told] = open_pages(Job(url + "#note=1", [("drawn",), ("value", front)]))
    assert told.values[1] == "1"


def test_texts_and_views_are_optional(tmp_path):
    path = written(tmp_path, [{"position": [1, 2, 3], "title": " a\t\u05d0 "}])
    assert read_annotations(path) == [Annotation([1.0, 2.0, 3.0], "a\t\u05d0", "", None)]


def test_written_annotations_are_read_again(tmp_path):
    notes = [
        Annotation([1.0, 2.0, 3.0], "\u05d0 <b>", "two\nlines"),
        Annotation([0, 0, 0], "b", "", 2),
    ]
    write_annotations(tmp_path / "notes.json", notes)
    assert read_annotations(tmp_path / "notes.json") == notes
    with pytest.raises(InvalidInput, match="annotation 1: empty title"):
        write_annotations(tmp_path / "empty.json", [Annotation([0, 0, 0], " ")])
    assert not (tmp_path / "empty.json").exists()


GOOD = {"position": [1, 2, 3], "title": "a"}


@pytest.mark.parametrize(
    ("notes", "message"),
    [
        ({}, r"annotations \{\}, expected a list"),
        ([GOOD] * 201, "201 annotations, expected at most 200"),
        ([GOOD, 3], "annotation 2: 3, expected position, title and text"),
        ([{"title": "a"}], "annotation 1: no 'position'"),
        ([{"position": [1, 2, 3]}], "annotation 1: no 'title'"),
        ([GOOD | {"position": [1, 2]}], r"position \[1, 2\], expected 3 numbers"),
        ([GOOD | {"position": [1, 2, float("nan")]}], "nan, expected a finite number"),
        ([GOOD | {"title": "  "}], "annotation 1: empty title"),
        ([GOOD | {"title": "a" * 201}], "title of 201 characters, expected at most 200"),
        ([GOOD | {"text": "a" * 5001}], "text of 5,001 characters, expected at most 5,000"),
        ([GOOD | {"text": 3}], "text 3, expected text"),
        ([GOOD | {"text": "a\x1b[2J"}], r"text contains U\+001B, expected text"),
        ([GOOD | {"title": "\ud800"}], r"title contains U\+D800, expected text"),
        ([GOOD | {"view": True}], "view True, expected a view's number"),
        ([GOOD | {"view": -1}], "view -1, expected a view's number"),
        ([GOOD | {"html": "<b>"}], "unknown field 'html', expected position, title, text, view"),
    ],
)
def test_invalid_annotations_are_refused(tmp_path, notes, message):
    with pytest.raises(InvalidInput, match=message):
        read_annotations(written(tmp_path, notes))


def test_a_view_that_is_not_there_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("gs_codec.files.sharing._open", None)  # before a scene is encoded
    notes = written(tmp_path, [GOOD | {"view": 3}])
    with pytest.raises(InvalidInput, match="annotation 1: view 3, expected one of 3 views"):
        small_page(tmp_path, annotations=notes)
    assert not (tmp_path / "page.html").exists()

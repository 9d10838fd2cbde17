"""Sequences on the page: it plays them, and shows the frames of the Python decoder."""

from __future__ import annotations

import numpy as np
import pytest
from moving_scenes import coded, moving
from web_pages import (
    HEIGHT,
    WIDTH,
    Job,
    decibels,
    drawn,
    in_browser,
    open_pages,
    seen,
    serving,
)

from gs_codec.cameras.camera import Camera, facing
from gs_codec.cameras.camera_files import write_cameras
from gs_codec.egs.egs_file import SectionId, read_file
from gs_codec.errors import InvalidInput
from gs_codec.files.sharing import share
from gs_codec.formats.ply.writer import write_ply
from gs_codec.sequences.frame_decoding import opened_sequence

CAMERA = Camera(
    "a", WIDTH, HEIGHT, 250.0, 250.0, WIDTH / 2, HEIGHT / 2,
    facing(np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])), np.array([0.0, 0.0, -9.0]),
)  # fmt: skip

PAUSED = "document.getElementById('play').ariaLabel === 'Play'"
FRAME = "Number(document.getElementById('time').value)"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A sequence of two groups of four frames, the second of fewer Gaussians, and pages of it."""
    folder = tmp_path_factory.mktemp("player")
    scenes = [*moving(sh_degree=1, frames=4), *moving(280, 4, sh_degree=1, seed=5)]
    coded(folder / "clip.egs", scenes)
    write_ply(folder / "one.ply", scenes[0])
    write_cameras(folder / "cameras.json", [CAMERA])
    for name in ("page.html", "site"):
        [shared] = share([folder / "clip.egs"], folder / name, folder / "cameras.json")
        assert (shared.frames, shared.encoded) == (8, False)
    assert (folder / "site" / "clip.egs").read_bytes() == (folder / "clip.egs").read_bytes()
    return folder


@in_browser
def test_frames_are_those_of_python(folder, tmp_path):
    """The frame of the address, the next one, one before in its group, and one of the other."""
    page = (folder / "page.html").as_uri()
    steps = [
        ("shot", str(tmp_path / "6.png")),
        ("key", "."),
        ("until", f"{FRAME} === 7"),
        ("shot", str(tmp_path / "7.png")),
        *[("key", ",")] * 3,
        ("until", f"{FRAME} === 4"),
        ("shot", str(tmp_path / "4.png")),
        ("value", "new Promise((done) => setTimeout(() => done(location.hash), 600))"),
        *[("key", ",")] * 2,
        ("until", f"{FRAME} === 2"),
        ("shot", str(tmp_path / "2.png")),
    ]
    [opened] = open_pages(Job(f"{page}#frame=6", steps))
    assert not opened.errors
    assert opened.values[9] == "#view=0&frame=4"
    with opened_sequence(folder / "clip.egs") as sequence:
        for number, scene in enumerate(sequence.frames()):
            if number in (2, 4, 6, 7):
                ours = drawn(scene, CAMERA)
                assert decibels(seen(tmp_path / f"{number}.png"), ours) > 45, number


@in_browser
def test_it_plays_again_and_again_until_space_is_pressed(folder):
    """Also from a server without ranges."""
    plays = [
        ("until", f"{FRAME} > 4"),
        ("until", f"{FRAME} < 3"),
        ("until", f"{FRAME} > 4"),
        ("value", PAUSED),
        ("key", " "),
        ("until", PAUSED),
        ("drawn",),
        ("value", "document.getElementById('clock').textContent.endsWith(' / 0.32 s')"),
        ("value", FRAME),
        ("value", "new Promise((done) => setTimeout(() => done(0), 300))"),
        ("value", FRAME),
        ("click", "#play"),
        ("value", PAUSED),
    ]
    with serving(folder / "site") as url:
        for opened in open_pages(Job((folder / "page.html").as_uri(), plays), Job(url, plays)):
            assert not opened.errors
            assert [opened.values[k] for k in (3, 7, 12)] == [False, True, False]
            assert opened.values[8] == opened.values[10]


@in_browser
def test_it_plays_after_its_slider_was_dragged_back_to_where_it_was(folder):
    steps = [("drawn",), ("slide", "#time", [0, 0.5, 0]), ("until", f"{FRAME} === 0")]
    steps += [("click", "#play"), ("until", f"{FRAME} > 1")]
    [opened] = open_pages(Job(f"{(folder / 'page.html').as_uri()}#frame=0", steps))
    assert not opened.errors


@in_browser
def test_the_slider_stays_on_the_frame_that_is_asked_for(folder):
    """While the frames before it are decoded."""
    jump = """new Promise((done) => {
      const [time, found] = [document.getElementById('time'), []];
      new MutationObserver(() => {
        found.push(Number(time.value));
        if (viewer.player.shown === 7) done(found);
      }).observe(time, { attributes: true, attributeFilter: ['aria-valuetext'] });
      viewer.player.seek(7);
    })"""
    page = f"{(folder / 'page.html').as_uri()}#frame=0"
    [opened] = open_pages(Job(page, [("drawn",), ("value", jump)]))
    assert not opened.errors
    assert len(opened.values[1]) > 1
    assert set(opened.values[1]) == {7}


@in_browser
@pytest.mark.parametrize("mobile", [False, True])
def test_the_bar_fits_into_a_narrow_page(folder, mobile):
    """Its times stay inside, also long ones, and its slider keeps a width."""
    fits = """(() => {
      const [bar, time, clock] = ['bar', 'time', 'clock'].map((id) => document.getElementById(id));
      clock.textContent = '100.00 / 240.00 s';
      const [outer, inner] = [bar.getBoundingClientRect(), clock.getBoundingClientRect()];
      const isInside = inner.right < outer.right && inner.top >= outer.top;
      return [isInside && inner.bottom <= outer.bottom, bar.scrollWidth <= bar.clientWidth,
        time.offsetWidth >= 44];
    })()"""
    job = Job((folder / "page.html").as_uri(), [("drawn",), ("value", fits)], (200, 300))
    job.mobile = mobile
    [opened] = open_pages(job)
    assert not opened.errors
    assert opened.values[1] == [True, True, True]


@in_browser
def test_keys_of_the_slider_leave_the_camera_where_it_is(folder):
    page = f"{(folder / 'page.html').as_uri()}#frame=3&camera=0,0,-5,0,0,0,0,-1,0"
    camera = ("value", "viewer.pose.eye[2]")
    steps = [("drawn",), ("focus", "#time")]
    for key, frame in (("Home", 0), ("End", 7), ("ArrowLeft", 6)):
        steps += [("key", key), ("until", f"{FRAME} === {frame}"), ("drawn",), camera]
    steps += [("focus", "#view"), ("key", "Home"), camera]
    [opened] = open_pages(Job(page, steps))
    assert not opened.errors
    assert [value for value in opened.values if isinstance(value, int)] == [-5, -5, -5, -9]


@in_browser
def test_damage_in_a_later_group_is_reported(folder, tmp_path):
    data = bytearray((folder / "site" / "clip.egs").read_bytes())
    data[-9] ^= 4
    for name in ("index.html", "clip.egs"):
        (tmp_path / name).write_bytes((folder / "site" / name).read_bytes())
    (tmp_path / "clip.egs").write_bytes(data)
    with serving(tmp_path) as url:
        [opened] = open_pages(Job(url, [("until", "document.body.dataset.state === 'error'")]))
    assert opened.status.startswith("clip.egs: frame 7: ")


@in_browser
def test_other_frames_can_be_shown_after_one_that_is_damaged(folder, tmp_path):
    """Also one after it in its group, which fails, and then one of another group."""
    (tmp_path / "index.html").write_bytes((folder / "site" / "index.html").read_bytes())
    data = bytearray((folder / "site" / "clip.egs").read_bytes())
    position, _, _ = read_file(bytes(data)).table[SectionId.MOTION, 2]
    data[position + 20] ^= 4
    (tmp_path / "clip.egs").write_bytes(data)
    stopped = ("until", "viewer.errors.length && !viewer.player.isJumping")
    told = [("value", FRAME), ("value", "viewer.player.shown"), ("value", "viewer.state.frame")]
    steps = [stopped, ("value", "viewer.player.seek(3)"), stopped, *told]
    steps += [("value", "viewer.player.seek(5)"), ("until", "viewer.player.shown === 5")]
    with serving(tmp_path) as url:
        [opened] = open_pages(Job(f"{url}#frame=1", steps))
    assert not opened.failure
    assert opened.values[3:6] == [1, 1, 1]  # not the frame that failed
    assert opened.status.startswith("clip.egs: frame 2: ")


@in_browser
def test_a_picture_shows_the_frame_that_is_asked_for(folder):
    asked = """(() => {
      const { sequence } = viewer.player;
      const open = sequence.group.bind(sequence);
      sequence.group = (number) => new Promise((done) => setTimeout(() => done(open(number)), 500));
      viewer.player.seek(7);
      return viewer.picture().then(() => viewer.player.shown);
    })()"""
    page = f"{(folder / 'page.html').as_uri()}#frame=0"
    [opened] = open_pages(Job(page, [("drawn",), ("value", asked)]))
    assert not opened.errors
    assert opened.values[1] == 7


@in_browser
def test_a_lost_graphics_card_is_all_that_is_reported(folder):
    """Also when the next group of frames begins."""
    lose = "viewer.renderer.gl.getExtension('WEBGL_lose_context').loseContext()"
    steps = [("drawn",), ("value", lose), ("until", "viewer.errors.length")]
    steps += [("value", "viewer.player.seek(5)"), ("until", "viewer.player.shown === 5")]
    [opened] = open_pages(Job(f"{(folder / 'page.html').as_uri()}#frame=0", steps))
    assert not opened.errors
    assert opened.status == "the graphics card was lost: reload the page"


def test_a_sequence_is_shared_alone(folder, tmp_path):
    with pytest.raises(InvalidInput, match="a sequence is shown alone"):
        share([folder / "clip.egs", folder / "one.ply"], tmp_path / "page.html")

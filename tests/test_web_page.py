"""The page from `gs-codec share`, in Chromium: display and controls."""

from __future__ import annotations

import gzip
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

import numpy as np
import pytest
from damage import flipped
from javascript import GOLDEN, digest
from scenes import random_scene, thorough
from web_pages import (
    HEIGHT,
    NODE,
    ROOT,
    SIZE,
    WIDTH,
    Job,
    decibels,
    drawn,
    in_browser,
    open_pages,
    seen,
    serving,
    small_page,
)

from gs_codec.cameras.camera import Camera, facing
from gs_codec.cameras.camera_files import write_cameras
from gs_codec.cameras.up import UPS, up_of
from gs_codec.cameras.widest import widest_view
from gs_codec.cli.main import main
from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.config import Config
from gs_codec.egs.egs_file import SectionId, read_file
from gs_codec.encoding import order
from gs_codec.encoding.request import Request
from gs_codec.errors import GsCodecError, InvalidInput, MissingTool
from gs_codec.files import sharing
from gs_codec.files.scenes import turn_scene
from gs_codec.files.sharing import Publication, share
from gs_codec.formats.ply.writer import write_ply
from gs_codec.scene import ANTIALIASED, Scene
from gs_codec.views.estimate import auto_cameras
from gs_codec.views.find import find_cameras
from samples.generate import generate
from viewer.pictures.layers import error_image

WEB = ROOT / "viewer" / "web"


@dataclass
class Files:
    """Two versions of a scene, and cameras for it."""

    folder: Path
    a: Scene
    b: Scene
    cameras: list[Camera]


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Files:
    folder = tmp_path_factory.mktemp("page")
    scene = generate(4000, 3, 12)
    cameras = [
        replace(camera.resized(*SIZE), name=f"view {k}", cx=150.0 + 9 * k)
        for k, camera in enumerate(auto_cameras(scene, 3))
    ]
    write_cameras(folder / "cameras.json", cameras)
    versions = []
    for name, profile in (("a", "l"), ("b", "s")):
        config = Config(profile, block_size=1024, coarseness=16.0 if name == "b" else 1.0)
        (folder / f"{name}.egs").write_bytes(encode_scene(scene, config)[0])
        versions.append(sharing._open(folder / f"{name}.egs", None, None)[1])
    return Files(folder, *versions, cameras)


@pytest.fixture(scope="module")
def pages(files) -> dict[str, Path]:
    """Pages with one scene and with two, each in a single file."""
    folder, cameras = files.folder, files.folder / "cameras.json"
    share([folder / "a.egs"], folder / "one.html", cameras)
    share([folder / "a.egs", folder / "b.egs"], folder / "two.html", cameras)
    return {name: folder / f"{name}.html" for name in ("one", "two")}


DECODED = """(async () => {
    const { decode } = await import('/project/viewer/web/src/index.js');
    const found = {};
    for (const name of NAMES) {
        const s = await decode(`/files/${name}`, { workers: 2 });
        const parts = [s.positions, s.fDc, s.fRest, s.opacity, s.logScale, s.rotation];
        const data = await new Blob(parts).arrayBuffer();
        const hash = new Uint8Array(await crypto.subtle.digest('SHA-256', data));
        found[name] = [...hash].map((byte) => byte.toString(16).padStart(2, '0')).join('');
    }
    return found;
})()"""


@in_browser
def test_the_decoder_gives_the_floats_of_python(files):
    """In workers of a browser; Node tests cover much more."""
    golden = [path for path in GOLDEN if "lossless" not in path.name]
    assert len(golden) > 10
    for path in golden:
        shutil.copy(path, files.folder)
    names = ["a.egs", "b.egs", *(path.name for path in golden)]
    with serving(files.folder) as url:
        script = DECODED.replace("NAMES", json.dumps(names))
        [told] = open_pages(Job(f"{url}project/viewer/web/page/page.html", [("value", script)]))
    assert told.values == [
        {name: digest(decode_scene((files.folder / name).read_bytes())) for name in names}
    ]


@in_browser
def test_views_are_those_of_our_rasteriser(files, pages, tmp_path):
    job = Job(pages["one"].as_uri(), [], panel=True)
    for k in range(3):
        job.shot(str(tmp_path / f"{k}.png"))
        job.steps.append(("key", "n"))
    for degree in "01":
        job.steps.append(("choose", "#degree", degree))
        job.shot(str(tmp_path / f"degree {degree}.png"))
    job.steps += [("choose", "#degree", "3"), ("choose", "#background", "white")]
    job.shot(str(tmp_path / "white.png"))
    [told] = open_pages(job)
    assert (told.state, told.status, told.errors) == ("ready", "", [])
    assert told.requests[0] == pages["one"].as_uri()
    assert all(url.startswith(("blob:", "data:")) for url in told.requests[1:])
    for k, camera in enumerate(files.cameras):
        ours = drawn(files.a, camera)
        assert np.ptp(ours) > 0.3
        assert decibels(seen(tmp_path / f"{k}.png"), ours) > 45
    for degree, rows in ((0, 0), (1, 3)):
        rest = files.a.f_rest.reshape(3, 15, files.a.count)[:, :rows]
        less = replace(files.a, f_rest=rest.reshape(3 * rows, files.a.count).copy())
        ours = drawn(less, files.cameras[0])
        assert decibels(seen(tmp_path / f"degree {degree}.png"), ours) > 45
    ours = drawn(files.a, files.cameras[0], (1.0, 1.0, 1.0))
    assert decibels(seen(tmp_path / "white.png"), ours) > 45


@pytest.mark.thorough
@in_browser
def test_two_scenes_are_compared(files, pages, tmp_path):
    job = Job(pages["two"].as_uri(), [])
    for name, key in (("wipe", "3"), ("a", "1"), ("flipped", "f"), ("error", "4"), ("b", "2")):
        job.steps.append(("key", key))
        job.shot(str(tmp_path / f"{name}.png"))
    job.steps += [("key", "3"), ("drag", [[150, 92], [230, 92], [75, 92]], 3)]
    job.shot(str(tmp_path / "left.png"))
    job.steps += [("focus", "#wipe"), ("key", "ArrowRight"), ("key", "ArrowRight")]
    job.steps.append(("value", "document.getElementById('wipe').getAttribute('aria-valuenow')"))
    job.steps += [("key", "End")]
    job.shot(str(tmp_path / "all a.png"))
    [told] = open_pages(job)
    assert (told.state, told.errors) == ("ready", [])
    assert "29" in told.values  # 25 plus 2 twice
    a, b = (drawn(scene, files.cameras[0]) for scene in (files.a, files.b))
    assert decibels(a, b) < 40
    page = {path.stem: seen(path) for path in tmp_path.glob("*.png")}
    half, quarter = WIDTH // 2, WIDTH // 4
    for name, line in (("wipe", half), ("left", quarter), ("a", WIDTH), ("flipped", 0), ("b", 0)):
        assert decibels(page[name], np.concatenate([a[:, :line], b[:, line:]], axis=1)) > 45
    assert decibels(page["all a"], a) > 45
    ours = error_image(a, b)
    assert np.abs(page["error"] - ours).max(axis=2).mean() < 0.05
    assert np.ptp(ours) > 0.3


@in_browser
def test_a_link_shows_the_same(pages, tmp_path):
    """The address tells what is shown, also after the camera has moved."""
    url = pages["two"].as_uri()
    asked = "#view=1&show=a&degree=1&up=z&background=white"
    job = Job(url + asked, [("drawn",), ("drag", [[150, 100], [190, 90]], 4)])
    job.shot(str(tmp_path / "first.png"))
    job.steps += [("until", "location.hash.includes('camera')"), ("value", "location.hash")]
    [told] = open_pages(job)
    assert (told.state, told.errors) == ("ready", [])
    address = told.values[-1]
    parts = dict(parse_qsl(address.removeprefix("#")))
    assert parts.pop("camera").count(",") == 8
    assert parts == dict(parse_qsl(asked[1:]))
    again = Job(url + address, [("until", "document.getElementById('degree').value === '1'")])
    again.shot(str(tmp_path / "again.png"))
    fresh = Job(url, [("drawn",), ("value", "location.hash")])
    odd = Job(url + "#view=9&show=x&wipe=2&camera=1,2,3,nan&up=&degree=1.5&background=%", [])
    odd.shot(str(tmp_path / "odd.png"))
    fresh.shot(str(tmp_path / "fresh.png"))
    for each in (opened := open_pages(again, fresh, odd)):
        assert (each.state, each.errors) == ("ready", [])
    assert opened[1].values[1] == ""
    assert decibels(seen(tmp_path / "first.png"), seen(tmp_path / "again.png")) > 60
    assert decibels(seen(tmp_path / "odd.png"), seen(tmp_path / "fresh.png")) > 60


@in_browser
def test_a_picture_turns_alone_until_it_is_touched(pages, tmp_path):
    url = pages["one"].as_uri() + "#view=1&turn=1&bare=1"
    shown = "getComputedStyle(document.getElementById('panel')).display !== 'none'"
    job = Job(url, [("value", shown), ("until", "document.getElementById('turn').checked")])
    job.steps += [("drag", [[150, 100], [151, 100]], 1), ("drawn",), ("key", "i")]
    # While it turned, the address had a camera, too.
    at_rest = "location.hash.includes('camera') && !location.hash.includes('turn')"
    job.steps += [("value", shown), ("until", at_rest), ("key", "r")]
    job.steps += [("until", "location.hash === '#view=1'")]
    still = Job(url, [("drawn",), ("value", "document.getElementById('turn').checked")])
    still.before = "globalThis.matchMedia = () => ({ matches: true, addEventListener() {} })"
    turned, resting = open_pages(job, still)
    assert (turned.state, turned.errors) == ("ready", [])
    assert [value for value in turned.values if isinstance(value, bool)] == [False, True]
    assert resting.values[-1] is False  # reduced motion


@in_browser
def test_another_address_is_followed_and_a_link_is_copied(files, pages, tmp_path):
    keep = "navigator.clipboard.writeText = async (text) => { globalThis.kept = text; }"
    job = Job(pages["one"].as_uri(), [("drawn",)], before=keep, panel=True)
    job.steps += [("value", "location.hash = '#view=2&background=grey'"), ("drawn",)]
    job.steps += [("until", "document.getElementById('views').value === '2'")]
    job.shot(str(tmp_path / "grey.png"))
    job.steps += [("click", "#link"), ("until", "globalThis.kept"), ("value", "globalThis.kept")]
    job.steps += [("value", "document.getElementById('link').textContent")]
    # What an address leaves out is kept, and then in it.
    kept = Job(pages["one"].as_uri(), [("drawn",), ("drag", [[150, 100], [190, 90]], 4)])
    kept.steps += [("value", "location.hash = '#background=white'")]
    kept.steps += [("until", "/camera=.*background=white/.test(location.hash)")]
    told, moved = open_pages(job, kept)
    assert moved.errors == []
    assert told.values[-2:] == [
        f"{pages['one'].as_uri()}#view=2&background=grey",
        "Link copied",
    ]
    ours = drawn(files.a, files.cameras[2], (0.5, 0.5, 0.5))
    assert decibels(seen(tmp_path / "grey.png"), ours) > 45


def test_large_scenes_have_levels_in_folders(tmp_path, monkeypatch):
    monkeypatch.setattr(sharing, "_LEVELLED", 2000)
    with_levels = []

    def encode(scene: Scene, request: Request, *rest: Any):
        with_levels.append(request.config.lod)
        small = replace(request, config=replace(request.config, block_size=1024))
        return order.encode(scene, small, *rest)

    monkeypatch.setattr(sharing, "encode", encode)
    for name, count in (("large", 5000), ("small", 2000)):
        write_ply(tmp_path / f"{name}.ply", generate(count, 0, 3))
        [one] = share([tmp_path / f"{name}.ply"], tmp_path / name)
        assert (one.encoded, one.levels > 0) == (True, name == "large")
        [alone] = share([tmp_path / f"{name}.ply"], tmp_path / f"{name}.html")
        assert (alone.encoded, alone.levels) == (True, 0)
    assert with_levels == [True, False, False, False]


@pytest.mark.thorough
@in_browser
def test_a_folder_is_shown_by_any_server(files, tmp_path):
    site = tmp_path / "site"
    share([files.folder / "a.egs", files.folder / "b.egs"], site, files.folder / "cameras.json")
    assert sorted(path.name for path in site.iterdir()) == [
        "a.egs", "b.egs", "embed.js", "index.html", "preview.jpg",
    ]  # fmt: skip
    with serving(site) as url:
        job = Job(url, [])
        job.shot(str(tmp_path / "wipe.png"))
        told, on_disk = open_pages(job, Job((site / "index.html").as_uri(), [("drawn",)]))
    assert on_disk.state == "error"
    assert on_disk.status.startswith("a.egs: a page opened from disk cannot read other files")
    assert (told.state, told.errors) == ("ready", [])
    asked = [request for request in told.requests if not request.startswith(("blob:", "data:"))]
    assert asked == [url, f"{url}a.egs", f"{url}b.egs"]
    a, b = (drawn(scene, files.cameras[0]) for scene in (files.a, files.b))
    both = np.concatenate([a[:, : WIDTH // 2], b[:, WIDTH // 2 :]], axis=1)
    assert decibels(seen(tmp_path / "wipe.png"), both) > 45


@pytest.mark.thorough
@in_browser
def test_a_stopped_download_keeps_its_data(files, tmp_path):
    site = tmp_path / "site"
    shutil.copy(files.folder / "a.egs", tmp_path / "stalled.egs")
    share([tmp_path / "stalled.egs"], site, files.folder / "cameras.json")
    with serving(site) as url:
        loaded = "document.querySelector('progress').value > 0.4"
        described = "document.querySelector('small').textContent"
        steps = [("until", loaded), ("until", described), ("click", "#stop")]
        job = Job(url, steps, panel=True)
        job.shot(str(tmp_path / "part.png"))
        [told] = open_pages(job)
    assert (told.state, told.status) == ("ready", "Stopped: the page shows what was loaded.")
    assert told.errors == []
    assert np.ptp(seen(tmp_path / "part.png")) > 0.3


@pytest.mark.thorough
@in_browser
def test_invalid_files_are_explained_and_the_other_is_shown(files, tmp_path):
    """A damaged file, one of a later version, and one that is not a scene."""
    data = (files.folder / "b.egs").read_bytes()
    place = 3 * len(data) // 4
    bad = {
        "damaged": data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :],
        "later": data[:8] + b"\3" + data[9:],
        "cut": data[: len(data) // 2],
        "text": b"<html>not found</html>",
    }
    said = {
        "damaged": "checksum", "later": "version 3 of the format", "cut": "cut off",
        "text": "not an .egs file",
    }  # fmt: skip
    site = tmp_path / "site"
    share([files.folder / "a.egs", files.folder / "b.egs"], site, files.folder / "cameras.json")
    index = (site / "index.html").read_text()
    jobs = []
    with serving(site) as url:
        for name, content in (*bad.items(), ("missing", None)):
            if content is not None:
                (site / f"{name}.egs").write_bytes(content)
            (site / f"{name}.html").write_text(index.replace('"b.egs"}', f'"{name}.egs"}}'))
            jobs.append(Job(f"{url}{name}.html", [("drawn",), ("key", "1")]))
            jobs[-1].shot(str(tmp_path / f"{name}.png"))
        found = open_pages(*jobs)
    a = drawn(files.a, files.cameras[0])
    for job, told in zip(jobs, found, strict=True):
        name = Path(job.url).stem
        assert told.state == "error"
        assert told.status.startswith("b.egs: ")
        assert said.get(name, "404") in told.status
        assert decibels(seen(tmp_path / f"{name}.png"), a) > 45


@in_browser
def test_a_truncated_page_says_that_it_is_incomplete(files, tmp_path):
    whole, cut = tmp_path / "whole.html", tmp_path / "cut.html"
    share([files.folder / "a.egs"], whole, files.folder / "cameras.json")
    cut.write_bytes(whole.read_bytes()[:-60_000])
    shown = "document.getElementById('told').checkVisibility()"
    jobs = [Job(cut.as_uri(), []), Job(whole.as_uri(), [("drawn",)])]
    for job in jobs:
        job.steps.append(("value", shown))
    incomplete, complete = open_pages(*jobs)
    assert incomplete.values[-1] is True
    assert "the page is incomplete: download it again" in incomplete.status
    assert complete.values[-1] is False


@in_browser
def test_a_damaged_block_is_named_and_the_others_are_drawn(files, tmp_path):
    data = (files.folder / "a.egs").read_bytes()
    damaged = flipped(data, 8 * read_file(data).table[SectionId.OPACITY, 2].position)
    share([files.folder / "a.egs"], tmp_path / "site", files.folder / "cameras.json")
    (tmp_path / "site" / "a.egs").write_bytes(damaged)
    with serving(tmp_path / "site") as url:
        job = Job(url, [("drawn",)])
        job.shot(str(tmp_path / "left.png"))
        [told] = open_pages(job)
    assert told.status == "a.egs: section opacity of block 2: wrong checksum"
    block = np.arange(files.a.count) // read_file(data).header.block_size
    left = files.a.take(np.flatnonzero(block != 2))
    assert decibels(seen(tmp_path / "left.png"), drawn(left, files.cameras[0])) > 45
    assert decibels(seen(tmp_path / "left.png"), drawn(files.a, files.cameras[0])) < 35


@pytest.mark.thorough
@in_browser
def test_a_whole_portrait_view_is_visible_in_a_wide_page(files, tmp_path):
    camera = replace(files.cameras[0], width=60, cx=30.0)
    write_cameras(tmp_path / "cameras.json", [camera])
    share([files.folder / "a.egs"], tmp_path / "page.html", tmp_path / "cameras.json")
    job = Job((tmp_path / "page.html").as_uri(), [])
    job.shot(str(tmp_path / "page.png"))
    open_pages(job)
    strip = seen(tmp_path / "page.png")[:, 120:180]
    assert decibels(strip, drawn(files.a, camera)) > 45


#: Touchable elements that are smaller than a finger needs.
SMALL = """[...document.querySelectorAll('#panel, #panel *, #wipe i')]
    .filter((one) => one.matches('select, button, summary, #budget, label:has([type=radio]), i'))
    .filter((one) => one.checkVisibility() && !one.closest('#legend'))
    .map((one) => [one.id || one.textContent, one.getBoundingClientRect()])
    .filter(([, { width, height }]) => Math.min(width, height) < 44)
    .map(([name]) => name)"""


@in_browser
def test_on_a_phone_only_the_handle_moves_the_wipe_and_targets_are_large(pages):
    split = ("value", "Number(document.getElementById('wipe').getAttribute('aria-valuenow'))")
    handle = "document.querySelector('#wipe i').getBoundingClientRect()"
    job = Job(pages["two"].as_uri(), [("drawn",), ("value", f"{handle}.y + 22")], (360, 640))
    job.mobile = True
    job.steps += [("touch", [[[180, 60], [260, 60]]]), split, ("value", SMALL)]
    [told] = open_pages(job)
    middle = told.values[1]
    assert told.values[3:] == [50, []]
    opened = Job(job.url, [("drawn",), ("value", SMALL)], (360, 640), panel=True, mobile=True)
    moved = Job(job.url, [("drawn",), ("touch", [[[180, middle], [270, middle]]]), split])
    moved.size, moved.mobile = (360, 640), True
    opened, moved = open_pages(opened, moved)
    assert opened.values[1] == []
    assert moved.values[2] == 75


@in_browser
def test_on_a_phone_a_joystick_flies(pages):
    url = pages["one"].as_uri() + "#view=1"
    stick = "document.getElementById('stick').checkVisibility()"
    push = [[72, 590]] + [[72, 540 + k % 2] for k in range(60)]
    job = Job(url, [("drawn",), ("value", stick), ("touch", [push])], (390, 700), mobile=True)
    job.steps.append(("until", "location.hash.includes('camera')"))
    job.steps += [("value", "location.hash"), ("click", "summary"), ("value", stick)]
    [told] = open_pages(job)
    assert (told.state, told.errors) == ("ready", [])
    assert (told.values[1], told.values[-1]) == (True, False)
    camera = dict(parse_qsl(told.values[-3]))["camera"].split(",")
    view = described(pages["one"])["views"][1]
    moved = np.array(camera[:3], float) - view["position"]
    forward = np.array(view["rotation"])[:, 2]
    assert moved @ forward > 0.99 * np.linalg.norm(moved) > 0


@in_browser
def test_on_a_phone_sh_that_do_not_fit_are_left_out(files, pages):
    """A Gaussian has 59 floats, 38 up to SH degree 2, 14 without SH-AC."""
    told = ("value", "document.querySelector('#scenes small').textContent")
    jobs = []
    for floats in (59, 40, 13):
        memory = 4 * files.a.count * floats / 2**26
        jobs.append(Job(pages["one"].as_uri(), [("drawn",), told], mobile=True))
        jobs[-1].before = f"Object.defineProperty(navigator, 'deviceMemory', {{ value: {memory} }})"
    whole, reduced, refused = open_pages(*jobs)
    assert "SH degree 3, " in whole.values[1]
    assert "left out" not in whole.values[1]
    assert ", SH degree 2, " in reduced.values[1]
    assert "SH left out to save memory" in reduced.values[1]
    assert (reduced.state, reduced.errors) == ("ready", [])
    assert refused.state == "error"
    assert "bytes of floats, at most 208000" in refused.status


def test_gaussians_with_nan_are_left_out_of_pages_and_counted(tmp_path, caplog):
    scene = generate(500, 1, 12)
    scene.positions[0, :7] = np.nan
    write_ply(tmp_path / "a.ply", scene)
    [shared] = share([tmp_path / "a.ply"], tmp_path / "page.html")
    assert decode_scene(shared.data).count == 493
    assert "a.ply: left out: 7 Gaussians with NaN or infinity" in caplog.text


@in_browser
def test_on_a_phone_extra_properties_take_no_memory(tmp_path):
    scene = replace(generate(2000, 3, 12), extra={"mark": np.zeros(2000, "<f8")})
    (tmp_path / "a.egs").write_bytes(encode_scene(scene, Config("l", extra="keep"))[0])
    share([tmp_path / "a.egs"], tmp_path / "page.html")
    told = ("value", "document.querySelector('#scenes small').textContent")
    job = Job((tmp_path / "page.html").as_uri(), [("drawn",), told], mobile=True)
    memory = 4 * scene.count * 60 / 2**26  # a Gaussian has 59 floats
    job.before = f"Object.defineProperty(navigator, 'deviceMemory', {{ value: {memory} }})"
    [opened] = open_pages(job)
    assert (opened.state, opened.errors) == ("ready", [])
    assert "SH degree 3, " in opened.values[1]
    assert "left out" not in opened.values[1]


@in_browser
def test_the_end_of_a_picture_is_noticed_at_rest(pages):
    """Otherwise, idle time would count as time of drawing."""
    job = Job(pages["one"].as_uri(), [("drawn",), ("until", "window.ended === window.begun")])
    job.before = """window.begun = window.ended = 0;
        const device = WebGL2RenderingContext.prototype;
        const { fenceSync, deleteSync } = device;
        device.fenceSync = function (...given) { begun++; return fenceSync.apply(this, given); };
        device.deleteSync = function (given) { ended++; return deleteSync.call(this, given); };"""
    [told] = open_pages(job)
    assert told.errors == []


@pytest.mark.thorough
@in_browser
def test_in_an_embedded_page_the_wheel_needs_a_click_first(pages, tmp_path):
    shutil.copy(pages["one"], tmp_path / "one.html")
    (tmp_path / "host.html").write_text(
        '<body style="height: 3000px"><p id="status"></p>'
        '<iframe src="one.html" width="700" height="400" style="position: fixed; inset: 0">'
    )
    inside = "document.querySelector('iframe').contentDocument"
    there = f"['ready'].includes({inside}.body?.dataset.state)"
    with serving(tmp_path) as url:
        job = Job(f"{url}host.html", [("until", there), ("wheel", 200), ("until", "scrollY > 0")])
        job.steps += [("value", f"{inside}.getElementById('panel').open")]
        job.steps += [("value", "scrollTo(0, 0)"), ("press",), ("wheel", 200)]
        job.steps += [("until", there), ("value", "scrollY")]
        job.size = (700, 400)
        [told] = open_pages(job)
    assert told.values[3] is False
    assert told.values[-1] == 0


@pytest.mark.thorough
@in_browser
def test_without_webgl_2_it_says_so_and_nothing_is_loading(pages):
    job = Job(pages["one"].as_uri(), [("drawn",)])
    job.before = "HTMLCanvasElement.prototype.getContext = () => null"
    job.steps.append(("value", "document.getElementById('stop').hidden"))
    [told] = open_pages(job)
    assert (told.state, told.status) == ("error", "this browser has no WebGL 2")
    assert told.values[-1] is True


@in_browser
def test_a_drag_there_and_back_changes_nothing_and_directions_are_right(files, pages, tmp_path):
    there, back = [[150, 100], [190, 120]], [[150, 100], [190, 120], [150, 100]]
    moves = {
        "start": [],
        "fast": [("drag", back, 1)],
        "slow": [("drag", back, 15)],
        "once": [("drag", there, 1)],
        "often": [("drag", there, 15)],
        "right": [("drag", [[150, 100], [170, 100]], 2, "right")],
        "near": [("wheel", -300)],
        "flown": [("hold", "w", 400)],
        "faster": [("hold", "Shift+w", 400)],
        "turned": [("hold", "ArrowLeft", 400)],
        "pinched": [("touch", [[[140, 100], [100, 100]], [[160, 100], [200, 100]]])],
        "swiped": [("touch", [[[150, 100], [190, 120]]])],
        "reset": [],
    }
    job = Job(pages["one"].as_uri(), [])
    for name, steps in moves.items():
        job.steps += [("key", "r"), ("drawn",), *steps]
        job.shot(str(tmp_path / f"{name}.png"))
    job.steps.append(("value", "document.querySelector('summary').textContent"))
    [told] = open_pages(job)
    assert (told.state, told.errors, told.values[-1]) == ("ready", [], "Scene")
    pictures = {name: seen(tmp_path / f"{name}.png") for name in moves}
    start = pictures["start"]
    for name in ("fast", "slow", "reset"):
        assert decibels(pictures[name], start) > 45, name
    assert decibels(pictures["once"], pictures["often"]) > 40
    assert decibels(pictures["swiped"], pictures["once"]) > 40
    for name in ("once", "right", "near", "flown", "faster", "turned", "pinched"):
        assert decibels(pictures[name], start) < 30, name
    assert decibels(pictures["faster"], pictures["flown"]) < 30
    # The pixels shifted to the right match.
    shifts = [
        decibels(pictures["right"][:, 40 + d : -40 + d], start[:, 40:-40]) for d in (-20, 0, 20)
    ]
    assert np.argmax(shifts) == 2
    # Nearer objects fill more of the picture.
    for name in ("near", "flown", "pinched"):
        assert (pictures[name].sum(axis=2) > 0.1).mean() > (start.sum(axis=2) > 0.1).mean(), name


def described(page: Path) -> dict[str, Any]:
    """The description of scenes and views that a page contains."""
    return json.loads(page.read_text().split('id="scene-list">')[1].split("</script>")[0])


def upright(camera: Camera, up: str) -> Camera:
    return replace(camera, rotation=facing(camera.rotation[2], UPS[up]))


@in_browser
def test_up_is_from_cameras_or_an_axis_and_rolls_the_picture(files, pages, tmp_path):
    job = Job(pages["one"].as_uri(), [("key", "n"), ("key", "u")], panel=True)
    camera = files.cameras[1]
    expected = {"key": upright(camera, "-y")}
    job.shot(str(tmp_path / "key.png"))
    job.steps.append(("choose", "#ups", "z"))
    expected["list"] = upright(camera, "z")
    job.shot(str(tmp_path / "list.png"))
    job.steps += [("focus", "#save"), ("key", "n")]
    expected["next"] = upright(files.cameras[2], "z")
    job.shot(str(tmp_path / "next.png"))
    job.steps += [("key", "u")] * 3 + [("value", "document.getElementById('ups').value")]
    job.steps.append(("key", "r"))
    expected["given"] = files.cameras[2]
    job.shot(str(tmp_path / "given.png"))
    job.steps.append(("value", "[...document.getElementById('ups')].map((o) => o.value)"))
    [told] = open_pages(job)
    assert (told.state, told.errors) == ("ready", [])
    assert "cameras" in told.values
    assert told.values[-1] == ["cameras", *UPS]
    for name, view in expected.items():
        assert decibels(seen(tmp_path / f"{name}.png"), drawn(files.a, view)) > 45, name


@in_browser
def test_pages_orbit_about_the_requested_axis(files, tmp_path):
    """With mouse and touch: half a turn about z, which is up."""
    share([files.folder / "a.egs"], tmp_path / "z.html", files.folder / "cameras.json", up="z")
    first = upright(files.cameras[0], "z")
    middle = np.median(files.a.positions.astype(np.float64), axis=1)
    distance = (middle - first.position) @ first.rotation[2]
    angle = -0.005 * 80
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    about = np.eye(3)
    about[:2, :2] = turn
    rotation = first.rotation @ about.T
    target = first.position + distance * first.rotation[2]
    turned = replace(first, rotation=rotation, position=target - distance * rotation[2])
    line = [[100, 100], [180, 100]]
    job = Job((tmp_path / "z.html").as_uri(), [])
    job.shot(str(tmp_path / "first.png"))
    job.steps.append(("drag", line, 8))
    job.shot(str(tmp_path / "drag.png"))
    job.steps += [("key", "r"), ("touch", [line])]
    job.shot(str(tmp_path / "touch.png"))
    [told] = open_pages(job)
    assert (told.state, told.errors) == ("ready", [])
    expected = {"first": first, "drag": turned, "touch": turned}
    for name, view in expected.items():
        assert decibels(seen(tmp_path / f"{name}.png"), drawn(files.a, view)) > 45, name


def test_pages_contain_the_possible_up_axes(files, tmp_path):
    cameras = files.folder / "cameras.json"
    for up in (None, "-x"):
        share([files.folder / "a.egs"], tmp_path / "page.html", cameras, up=up, overwrite=True)
        told = described(tmp_path / "page.html")
        assert told["up"] == (up or "cameras")
        assert list(told["ups"]) == ["cameras", *UPS]
        by_cameras = up_of([camera.rotation for camera in files.cameras])
        np.testing.assert_allclose(told["ups"]["cameras"], by_cameras, atol=1e-12)
        assert told["ups"]["-z"] == [0, 0, -1]
        assert len(told["views"]) == 3


@in_browser
def test_home_is_the_given_camera_that_shows_most(files, tmp_path):
    cameras = sorted(files.cameras, key=lambda camera: camera is files.cameras[0])
    near = replace(cameras[0], fx=9 * cameras[0].fx, fy=9 * cameras[0].fy)
    write_cameras(tmp_path / "cameras.json", [near, *cameras[1:]])
    share([files.folder / "a.egs"], tmp_path / "page.html", tmp_path / "cameras.json")
    home = described(tmp_path / "page.html")["home"]
    assert home == widest_view(files.a, [near, *cameras[1:]]) > 0
    shown = ("value", "Number(document.getElementById('views').value)")
    job = Job((tmp_path / "page.html").as_uri(), [shown, ("key", "Home"), shown])
    [told] = open_pages(job)
    assert told.values == [0, None, home]


@pytest.mark.usefixtures("few_cameras")
def test_estimated_cameras_are_upright_for_the_requested_axis(files, tmp_path, caplog):
    # A scene without SH-AC, whose up axis cannot be estimated.
    scene = replace(random_scene(3000, 0, seed=8), comments=[])
    (tmp_path / "a.egs").write_bytes(encode_scene(scene, Config("l"))[0])
    share([tmp_path / "a.egs"], tmp_path / "page.html", up="z")
    for view in described(tmp_path / "page.html")["views"]:
        right, down, _ = np.array(view["rotation"]).T
        assert right[2] == pytest.approx(0, abs=1e-9)
        assert down[2] < 0
    assert not caplog.records
    share([tmp_path / "a.egs"], tmp_path / "page.html", overwrite=True)
    assert [record.getMessage() for record in caplog.records] == [
        "cameras 'auto': the up axis is uncertain; choose an axis (up), or give its cameras"
    ]


ROLLED = """
import { Pose } from POSE;
const pose = new Pose([1, 2, 3], [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], 2);
const told = [];
for (const up of [[0, -1, 0], [1, 0, 0], [0, 0, 1], [0, 0, -1]]) {
    pose.roll(up);
    told.push([pose.turn.flat(), pose.eye, pose.target]);
}
console.log(JSON.stringify(told));
"""


@pytest.mark.skipif(NODE is None, reason="needs Node")
def test_poses_are_rolled_upright_unless_they_look_straight_up_or_down():
    pose = (ROOT / "viewer" / "web" / "page" / "pose.js").as_uri()
    script = ROLLED.replace("POSE", json.dumps(pose))
    done = subprocess.run(
        [str(NODE), "--input-type=module", "-e", script],
        capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    upright, aside, *steep = json.loads(done.stdout)
    np.testing.assert_allclose(np.reshape(upright[0], (3, 3)), np.eye(3), atol=1e-12)
    np.testing.assert_allclose(
        np.reshape(aside[0], (3, 3)), facing([0, 0, 1], [1, 0, 0]), atol=1e-12
    )
    assert steep == [aside, aside]
    for told in (upright, aside):
        assert told[1:] == [[1, 2, 3], [1, 2, 5]]


SLOW = """(() => {
    const device = WebGL2RenderingContext.prototype;
    const { fenceSync, clientWaitSync } = device;
    window.widths = [];
    let begun = 0;
    device.fenceSync = function (...given) {
        begun = performance.now();
        window.widths.push(this.canvas.width);
        return fenceSync.apply(this, given);
    };
    device.clientWaitSync = function (...given) {
        const isSoon = performance.now() < begun + 120;
        return isSoon ? this.TIMEOUT_EXPIRED : clientWaitSync.apply(this, given);
    };
})()"""


@pytest.mark.thorough
@in_browser
def test_slow_devices_draw_drafts_during_a_move_but_save_and_compare_in_full(
    files, pages, tmp_path
):
    def turn(kind: str) -> tuple:
        event = f"new KeyboardEvent('{kind}', {{code: 'ArrowLeft', bubbles: true}})"
        return ("value", f"document.body.dispatchEvent({event})")

    drafted = ("until", "window.widths.at(-1) < 300")
    one = Job(pages["one"].as_uri(), [("drawn",), ("key", "n"), ("drawn",)], before=SLOW)
    one.panel = True
    one.steps += [("key", "r"), ("drawn",), turn("keydown"), drafted]
    one.steps += [("saved", "#save", str(tmp_path / "saved.png")), drafted, turn("keyup")]
    one.steps += [("drawn",), ("value", "window.widths.at(-1)"), ("key", "p"), ("key", "n")]
    one.shot(str(tmp_path / "rested.png"))
    two = Job(pages["two"].as_uri(), [("drawn",), ("key", "4"), ("drawn",)], before=SLOW)
    two.steps += [("key", "3"), turn("keydown"), ("until", "window.widths.length > 9")]
    two.steps += [turn("keyup"), ("value", "Math.min(...window.widths)")]
    found = open_pages(one, two)
    for told in found:
        assert told.errors == []
    assert WIDTH in found[0].values
    assert seen(tmp_path / "saved.png").shape[:2] == (HEIGHT, WIDTH)
    ours = drawn(files.a, files.cameras[1])
    assert decibels(seen(tmp_path / "rested.png"), ours) > 45
    assert found[1].values[-1] == WIDTH


@in_browser
def test_a_picture_is_sorted_for_its_view(pages):
    """Also if sorting takes long; one while the camera moves does not wait for its rest."""
    asked = """(async () => {
      const [{ sorter }] = viewer.scenes;
      const post = sorter.postMessage.bind(sorter);
      sorter.postMessage = (...given) => setTimeout(post, 400, ...given);
      viewer.choose(1);
      await viewer.picture();
      const isSorted = viewer.scenes[0].isInOrder(viewer.pose);
      viewer.turn(true);
      await new Promise(requestAnimationFrame);
      await viewer.picture();
      const { isTurning } = viewer;
      viewer.turn(false);
      return [isSorted, isTurning];
    })()"""
    [opened] = open_pages(Job(pages["one"].as_uri(), [("drawn",), ("value", asked)]))
    assert not opened.errors
    assert opened.values[1] == [True, True]


@in_browser
def test_a_pinch_on_a_touchpad_comes_closer(pages):
    """In browsers, it is a wheel with ctrl, in steps of a few pixels."""
    pinch = """(() => {
      const { distance } = viewer.pose;
      const step = { deltaY: -5, ctrlKey: true, bubbles: true, cancelable: true };
      for (let k = 0; k < 20; k++) viewer.canvas.dispatchEvent(new WheelEvent('wheel', step));
      return distance / viewer.pose.distance;
    })()"""
    [opened] = open_pages(Job(pages["one"].as_uri(), [("drawn",), ("value", pinch)]))
    assert not opened.errors
    assert 2 < opened.values[1] < 5


@in_browser
def test_a_failure_to_sort_is_reported(pages):
    """As for lack of memory."""
    fails = ("value", "viewer.scenes[0].sorter.postMessage({ count: -1 })")
    failed = ("until", "document.body.dataset.state === 'error'")
    steps = [("drawn",), fails, fails, failed, ("value", "viewer.errors.length")]
    [opened] = open_pages(Job(pages["one"].as_uri(), steps))
    assert opened.values[-1] == 1
    assert opened.status.startswith("a.egs: ")
    assert "length" in opened.status


@in_browser
def test_the_camera_rests_after_the_command_key(pages):
    """On a Mac, a key that is released while the command key is held causes no event."""
    moves = """new Promise((done) => {
      const send = (kind, given) =>
        document.body.dispatchEvent(new KeyboardEvent(kind, { bubbles: true, ...given }));
      send('keydown', { code: 'KeyW', key: 'w' });
      send('keydown', { code: 'MetaLeft', key: 'Meta', metaKey: true });
      send('keyup', { code: 'MetaLeft', key: 'Meta' });
      const { pose } = viewer;
      setTimeout(() => done([viewer.hasMoved, viewer.pose === pose]), 300);
    })"""
    job = Job(pages["one"].as_uri(), [("drawn",), ("hold", "w", 100), ("value", moves)])
    [opened] = open_pages(job)
    assert not opened.errors
    assert opened.values[2] == [True, True]


@pytest.mark.thorough
@in_browser
def test_splats_reaching_into_the_picture_are_drawn(files, tmp_path):
    """Most centres are outside the picture or behind the camera."""
    [camera] = [replace(files.cameras[0], position=files.cameras[0].position * 0.3)]
    write_cameras(tmp_path / "cameras.json", [camera])
    share([files.folder / "a.egs"], tmp_path / "page.html", tmp_path / "cameras.json")
    job = Job((tmp_path / "page.html").as_uri(), [])
    job.shot(str(tmp_path / "near.png"))
    [told] = open_pages(job)
    assert (told.state, told.errors) == ("ready", [])
    ours = drawn(files.a, camera)
    assert np.ptp(ours) > 0.3
    assert decibels(seen(tmp_path / "near.png"), ours) > 45


@in_browser
def test_no_external_code_runs_and_names_are_text(files, tmp_path):
    name = "a <script>alert(1)<!--&'.egs"
    shutil.copy(files.folder / "a.egs", tmp_path / name)
    share([tmp_path / name], tmp_path / "page.html", files.folder / "cameras.json")
    share([tmp_path / name], tmp_path / "site", files.folder / "cameras.json")
    tries = """(() => {
        const found = {title: document.title, name: document.querySelector('li').firstChild.data};
        document.body.setAttribute('onclick', 'window.ran = true');
        document.body.onclick?.();
        const script = document.createElement('script');
        script.textContent = 'window.ran = true';
        document.body.append(script);
        return {...found, ran: window.ran ?? false};
    })()"""
    fetched = "fetch('https://example.org/').then(() => 'fetched', (error) => error.name)"
    with serving(tmp_path / "site") as url:
        found = open_pages(
            Job((tmp_path / "page.html").as_uri(), [("drawn",), ("value", tries)]),
            Job(url, [("drawn",), ("value", tries), ("value", fetched)]),
        )
    for told in found:
        assert told.state == "ready"
        assert told.values[1] == {"title": name, "name": name, "ran": False}
    assert found[1].values[2] == "TypeError"


@in_browser
def test_pictures_are_named_after_the_title_in_any_script(tmp_path):
    titled = Publication(title="\u5bfa\u306e\u5ead: \u00e9t\u00e9/2")
    page = small_page(tmp_path, publication=titled)
    steps = [("drawn",), ("saved", "#save", str(tmp_path / "saved.png"))]
    [told] = open_pages(Job(page, steps, panel=True))
    assert told.values[-1] == "\u5bfa\u306e\u5ead_\u00e9t\u00e9_2.png"


@pytest.mark.thorough
@in_browser
def test_sizes_are_those_of_inspect_and_pictures_are_saved(files, pages, tmp_path):
    cells = """Object.fromEntries([...document.querySelectorAll('#sizes tbody tr')].map(
        (row) => [row.cells[0].textContent, [...row.cells].slice(1).map((c) => +c.textContent)]))"""
    job = Job(pages["two"].as_uri(), [("drawn",), ("value", cells), ("key", "1")], panel=True)
    job.steps += [("drawn",), ("saved", "#save", str(tmp_path / "saved.png"))]
    unnamed = """[...document.querySelectorAll('select, button, input, canvas, [tabindex]')]
        .filter((e) => !e.closest('[hidden]'))
        .filter((e) => !(e.labels?.length || e.ariaLabel || e.textContent.trim()))
        .map((e) => e.outerHTML)"""
    job.steps.append(("value", unnamed))
    [told] = open_pages(job)
    assert (told.errors, told.values[-1]) == ([], [])
    assert told.values[-2] == "a.egs_and_b.egs.png"
    assert decibels(seen(tmp_path / "saved.png"), drawn(files.a, files.cameras[0])) > 45
    shown = told.values[1]
    for k, name in enumerate("ab"):
        info = sharing.inspect_bytes((files.folder / f"{name}.egs").read_bytes())
        bits = {stream.name: stream.bits_per_gaussian for stream in info.streams}
        whole = 8 * info.file_bytes / info.count
        assert shown["file"][k] == pytest.approx(whole, abs=0.051)
        assert shown["SH-DC"][k] == pytest.approx(bits["sh-dc"], abs=0.051)
        ac = sum(bits[band] for band in ("sh1", "sh2", "sh3"))
        assert shown["SH-AC"][k] == pytest.approx(ac, abs=0.051)
        assert sum(row[k] for title, row in shown.items() if title != "file") == pytest.approx(
            whole, abs=0.4
        )


@pytest.mark.one_in(2)
@in_browser
@pytest.mark.parametrize(
    "kind", ["turned", thorough("antialiased"), thorough("paper"), "empty", "tiny"]
)
def test_scenes_of_all_kinds(files, tmp_path, kind):
    """In the file's coordinates, antialiased, with other profiles, empty, and in tiny units."""
    scene, config, cameras = files.a, Config("l", block_size=1024), files.cameras
    if kind == "turned":
        scene = turn_scene(replace(scene, comments=["CoordinateSystem: RDF"]), "RUB")
    if kind == "antialiased":
        scene = replace(scene, comments=[ANTIALIASED])
    if kind == "paper":
        config = Config("paper-l", block_size=1024)
    if kind == "empty":
        scene = random_scene(0)
    if kind == "tiny":
        unit = 1 / 256
        scene = replace(
            scene,
            positions=scene.positions * np.float32(unit),
            log_scale=scene.log_scale + np.float32(np.log(unit)),
        )
        cameras = [replace(view, position=unit * view.position) for view in cameras]
    write_cameras(tmp_path / "cameras.json", cameras)
    (tmp_path / "a.egs").write_bytes(encode_scene(scene, config)[0])
    share([tmp_path / "a.egs"], tmp_path / "page.html", tmp_path / "cameras.json")
    expected = sharing._open(tmp_path / "a.egs", None, None)[1]
    job = Job((tmp_path / "page.html").as_uri(), [])
    job.shot(str(tmp_path / "a.png"))
    [told] = open_pages(job)
    assert (told.state, told.errors) == ("ready", [])
    ours = drawn(expected, find_cameras(cameras, expected)[0])
    page = seen(tmp_path / "a.png")
    if kind == "empty":
        assert not page.any()
    else:
        assert np.ptp(ours) > 0.3
        assert decibels(page, ours) > 45


@pytest.mark.thorough
@in_browser
@pytest.mark.parametrize(("program", "least"), [("playcanvas", 28), ("spark", 28)])
def test_other_programs_draw_scenes_by_an_adapter(files, tmp_path, program, least):
    with serving(files.folder) as url:
        job = Job(f"{url}project/tests/web/{program}.html", [])
        job.shot(str(tmp_path / "a.png"))
        open_pages(job)
    ours = drawn(files.a, files.cameras[0])
    assert decibels(seen(tmp_path / "a.png"), ours) > least


@pytest.mark.thorough
@in_browser
def test_a_browser_without_webgl_says_so(pages):
    none = "HTMLCanvasElement.prototype.getContext = () => null"
    [told] = open_pages(Job(pages["one"].as_uri(), [("drawn",)], before=none))
    assert (told.state, told.status) == ("error", "this browser has no WebGL 2")


@pytest.mark.thorough
@in_browser
def test_it_fits_a_telephone(pages, tmp_path):
    job = Job(pages["two"].as_uri(), [("drawn",)], size=(360, 640))
    inside = """[...document.querySelectorAll('#panel, #wipe, canvas')].every((element) => {
        const box = element.getBoundingClientRect();
        return box.left >= 0 && box.right <= innerWidth && box.bottom <= innerHeight;
    }) && document.documentElement.scrollWidth === innerWidth"""
    job.steps.append(("value", inside))
    [told] = open_pages(job)
    assert told.values[-1] is True


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """The exit status of a command."""
    monkeypatch.setattr("sys.argv", ["gs-codec", *map(str, arguments)])
    with pytest.raises(SystemExit) as stop:
        main()
    return stop.value.code or 0


def test_other_scenes_are_encoded_for_the_page(files, tmp_path, monkeypatch, capsys):
    write_ply(tmp_path / "a.ply", files.a)
    (tmp_path / "a.egs").write_bytes(encode_scene(files.a, Config("lossless"))[0])
    cameras = files.folder / "cameras.json"
    for name in ("a.ply", "a.egs"):
        (tmp_path / "folder").mkdir(exist_ok=True)
        arguments = (tmp_path / name, "--cameras", cameras, "--out", tmp_path / "folder")
        assert run(monkeypatch, "share", *arguments, "--overwrite") == 0
        out = capsys.readouterr().out
        assert f"folder: {name}, " in out
        shared, rendered = out.splitlines()
        assert shared.endswith(" kB, encoded for the page by profile l")
        assert re.match(r"rendered views: \d+\.\d dB against the original, a loss of ", rendered)
        info = sharing.inspect_bytes((tmp_path / "folder" / "a.egs").read_bytes())
        assert (info.profile, info.count) == ("l", files.a.count)


def test_a_page_does_not_replace_a_scene_that_it_encodes(files, tmp_path):
    exact = encode_scene(files.a, Config("lossless"))[0]
    (tmp_path / "exact.egs").write_bytes(exact)
    with pytest.raises(InvalidInput, match=r"exact\.egs: input and output are the same file"):
        share([tmp_path / "exact.egs"], tmp_path, files.folder / "cameras.json", overwrite=True)
    assert [path.name for path in tmp_path.iterdir()] == ["exact.egs"]
    assert (tmp_path / "exact.egs").read_bytes() == exact
    # The page reads this one as it is.
    shutil.copy(files.folder / "a.egs", tmp_path)
    share([tmp_path / "a.egs"], tmp_path, files.folder / "cameras.json", overwrite=True)
    assert (tmp_path / "a.egs").read_bytes() == (files.folder / "a.egs").read_bytes()


@in_browser
def test_pages_show_the_loss_of_their_encoding(files, tmp_path):
    write_ply(tmp_path / "a.ply", files.a)
    sources = [tmp_path / "a.ply", files.folder / "b.egs"]
    shared = share(sources, tmp_path / "page.html", files.folder / "cameras.json")
    assert shared[0].rendered is not None
    assert shared[1].rendered is None
    lines = "[...document.querySelectorAll('#scenes li')].map((li) => li.children[0].textContent)"
    job = Job((tmp_path / "page.html").as_uri(), [("drawn",), ("value", lines)])
    [told] = open_pages(job)
    a, b = told.values[1]
    lost = f"encoded for this page, profile l, views: {shared[0].rendered.psnr:.1f} dB"
    assert a.endswith(f", {lost} against the original")
    assert b.endswith(" kB, profile s")


def test_two_files_of_one_name_are_kept_apart(files, tmp_path):
    (tmp_path / "other").mkdir()
    shutil.copy(files.folder / "b.egs", tmp_path / "other" / "A.egs")
    sources = [files.folder / "a.egs", tmp_path / "other" / "A.egs"]
    share(sources, tmp_path / "site", files.folder / "cameras.json")
    for name, source in zip(("a-a.egs", "b-A.egs"), sources, strict=True):
        assert (tmp_path / "site" / name).read_bytes() == source.read_bytes()


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are text")
def test_names_that_are_not_utf_8_are_shown(files, tmp_path):
    path = tmp_path / os.fsdecode(b"a\xff.egs")
    shutil.copy(files.folder / "a.egs", path)
    share([path], tmp_path / "page.html", files.folder / "cameras.json")
    assert "<title>a\ufffd.egs" in (tmp_path / "page.html").read_text()
    share([path], tmp_path / "site", files.folder / "cameras.json")
    assert (tmp_path / "site" / "a\ufffd.egs").read_bytes() == path.read_bytes()


@pytest.mark.thorough
@pytest.mark.usefixtures("few_cameras")
def test_cameras_are_estimated_without_a_file(files, tmp_path):
    share([files.folder / "a.egs"], tmp_path / "page.html")
    views = described(tmp_path / "page.html")["views"]
    assert len(views) == 24
    assert {"img_name", "fx", "rotation"} <= set(views[0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["a.egs", "--out", "page.txt"], "page.txt: expected a .html file or a folder"),
        (["a.egs", "--out", "taken.html"], "taken.html: already exists"),
        (["a.egs", "--out", "taken"], "taken: not empty"),
        (["none.egs", "--out", "page.html"], "none.egs: No such file"),
        (["a.egs", "--out", "nowhere/page.html"], "nowhere"),
        (["a.egs", "--out", "page.html", "--max-bytes", "999"], "the limit is 999"),
        (["a.egs", "--out", "page.html", "--up", "w"], "up 'w': expected -y, y, -z, z, -x, x"),
        (["a.egs", "--out", "page.html", "--cameras", "none.json"], "none.json: no such file"),
    ],
)
def test_refusals_are_one_line(files, tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    shutil.copy(files.folder / "a.egs", "a.egs")
    Path("taken.html").write_text("")
    Path("taken").mkdir()
    Path("taken/file").write_text("")
    before = sorted(tmp_path.rglob("*"))
    assert run(monkeypatch, "share", *arguments) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.skipif(
    not (NODE and (WEB / "node_modules").is_dir()), reason="needs Node, and make web for esbuild"
)
def test_the_built_page_matches_its_sources(tmp_path):
    subprocess.run([NODE, WEB / "build.mjs", tmp_path / "page.html"], check=True)
    for name in ("page.html", "inspect.js"):
        assert (tmp_path / name).read_bytes() == (WEB / name).read_bytes(), "make web"


def test_the_built_page_is_small():
    assert len(gzip.compress((WEB / "page.html").read_bytes())) <= 60_000


def test_three_scenes_are_too_many(files, tmp_path):
    with pytest.raises(InvalidInput, match="3 scenes, expected one or two"):
        share([files.folder / "a.egs"] * 3, tmp_path / "page.html")


def test_an_installation_without_the_page_is_reported(files, tmp_path, monkeypatch):
    monkeypatch.setattr(sharing.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(MissingTool, match=r"viewer/web/page\.html: no such file"):
        share([files.folder / "a.egs"], tmp_path / "page.html")


def test_an_unwritable_page_leaves_nothing(files, tmp_path, monkeypatch):
    def full(*_: object) -> Callable:
        raise GsCodecError("No space left on device")

    monkeypatch.setattr(sharing, "atomic_writer", full)
    with pytest.raises(GsCodecError, match="No space"):
        share([files.folder / "a.egs"], tmp_path / "page.html", files.folder / "cameras.json")
    assert list(tmp_path.iterdir()) == []

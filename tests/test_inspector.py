"""The inspection of a page that ``gs-viewer --web`` serves."""

from __future__ import annotations

import http.client
import io
import json
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from moving_scenes import coded, moving
from PIL import Image
from scenes import random_scene
from web_pages import LENS, Job, decibels, drawn, in_browser, open_pages, seen

import gs_codec
from gs_codec.cameras.inria import as_camera
from gs_codec.formats.ply.writer import write_ply
from viewer.inspector import Inspector
from viewer.scenes.view_request import Request
from viewer.served import Page, serve

#: A camera of `folder`.
CAMERA = {
    "img_name": "view",
    "position": [0, 0, -5],
    "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "cx": 30,
    "cy": 20,
    **LENS,
}

#: What a page asks for a picture.
ASKED = {
    "call": "picture", "scene": 0, "trial": 0, "camera": CAMERA, "w": 60, "h": 40,
    "layers": ["splats", "boxes"], "colouring": "colour", "scale": None, "depth": 6,
    "cells": "occupancy", "degree": 3, "background": [0, 0, 0],
}  # fmt: skip

#: What it asks for an encoding.
ENCODING = {"call": "encode", "profile": "m", "wish": "steps", "value": 2.0, "guided": False}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A scene, one with other colours, cameras and photographs."""
    folder = tmp_path_factory.mktemp("inspected")
    scene = random_scene(500, 1, seed=2)
    write_ply(folder / "a.ply", scene)
    write_ply(folder / "b.ply", replace(scene, f_dc=scene.f_dc + np.float32(0.3)))
    cameras = [CAMERA | {"id": k, "img_name": f"view{k}"} for k in range(2)]
    (folder / "cameras.json").write_text(json.dumps(cameras))
    (folder / "images").mkdir()
    Image.new("RGB", (60, 40), (200, 30, 30)).save(folder / "images" / "view0.png")
    return folder


@pytest.fixture
def page(folder) -> Iterator[Page]:
    cameras, scenes = str(folder / "cameras.json"), [folder / "a.ply", folder / "b.ply"]
    request = Request(*scenes, cameras=cameras, images=folder / "images")
    inspector = Inspector(request)
    page = serve(scenes, request, inspector=inspector)
    threading.Thread(target=page.serve_forever, daemon=True).start()
    yield page
    page.shutdown()
    page.server_close()
    inspector.close()


def ask(page: Page, asked: object, path: str = "", host: str = "127.0.0.1") -> tuple:
    """Status, facts and body of the answer to a call."""
    if page.inspector is not None:
        path = path or page.inspector.address
    connection = http.client.HTTPConnection("127.0.0.1", page.server_port, timeout=60)
    body = asked if isinstance(asked, bytes) else json.dumps(asked).encode()
    connection.request("POST", urlsplit(page.url).path + path, body, {"Host": host})
    response = connection.getresponse()
    return response.status, json.loads(response.getheader("Facts", "{}")), response.read()


def get(page: Page, path: str) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", page.server_port, timeout=60)
    connection.request("GET", urlsplit(page.url).path + path)
    response = connection.getresponse()
    return response.status, response.read()


def put(page: Page, name: str, data: bytes, **headers: str) -> tuple[int, str]:
    """Drop a file on the page."""
    connection = http.client.HTTPConnection("127.0.0.1", page.server_port, timeout=60)
    connection.request("PUT", urlsplit(page.url).path + name, data, headers)
    response = connection.getresponse()
    return response.status, response.read().decode()


def picture(page: Page, **changes: object) -> np.ndarray:
    status, _, data = ask(page, ASKED | changes)
    assert status == 200, data
    return seen(io.BytesIO(data))


def until_idle(page: Page) -> dict:
    while True:
        told = json.loads(ask(page, {"call": "progress"})[2])
        if not told["doing"]:
            return told
        time.sleep(0.02)


def test_pictures_are_those_of_the_window(page):
    scene = random_scene(500, 1, seed=2)
    assert decibels(picture(page), drawn(scene, as_camera(CAMERA))) > 35  # JPEG
    status, facts, data = ask(page, ASKED | {"scene": 1, "layers": ["splats", "error"]})
    assert status == 200
    assert facts["remark"] == "B: b.ply, error against A"
    assert [legend["title"] for legend in facts["legends"]] == ["error of a pixel, of 255"]
    assert decibels(seen(io.BytesIO(data)), picture(page, scene=1)) < 30
    grey = picture(page, layers=["centres"], background=[0.5, 0.5, 0.5])
    assert np.abs(np.median(grey) - 0.5) < 0.02
    told = json.loads(ask(page, {"call": "quality", "camera": CAMERA, "trial": 0})[2])
    assert "dB, SSIM" in told["text"]


def test_photographs_are_of_the_page_s_views(page):
    asked = {"call": "photograph", "background": [0, 0, 0]}
    status, _, data = ask(page, asked | {"view": 0})
    assert status == 200
    assert np.allclose(
        seen(io.BytesIO(data)).mean((0, 1)), np.array([200, 30, 30]) / 255, atol=0.01
    )
    assert ask(page, asked | {"view": 1})[0] == 400  # there is no such file
    assert ask(page, asked | {"view": 2})[0] == 400


def test_transparent_parts_of_photographs_show_the_background(page, folder):
    Image.new("RGBA", (60, 40), (255, 0, 0, 51)).save(folder / "images" / "view1.png")
    asked = {"call": "photograph", "view": 1, "background": [0, 1, 0]}
    status, _, data = ask(page, asked)
    (folder / "images" / "view1.png").unlink()
    assert status == 200
    assert np.allclose(seen(io.BytesIO(data)).mean((0, 1)), [0.2, 0.8, 0], atol=0.02)


def test_an_encoding_is_listed_served_and_shown_as_b(page, folder):
    assert get(page, "trial-1.egs")[0] == get(page, "?b=1")[0] == 404
    assert ask(page, ENCODING)[0] == 200
    [told] = until_idle(page)["trials"]
    status, data = get(page, "trial-1.egs")
    cloud = gs_codec.read(folder / "a.ply")
    assert (status, data) == (200, gs_codec.encode(cloud, gs_codec.Config("m", coarseness=2.0)))
    assert (told["name"], told["bytes"], told["readable"]) == ("#1 m x2", len(data), True)
    assert told["views"] == 2
    assert "dB, SSIM" in told["mean"]
    status, text = get(page, "?b=1")
    assert status == 200
    assert b'"name": "#1 m x2", "encoded": false, "levels": false, "url": "trial-1.egs"' in text
    assert b"b.egs" in get(page, "")[1]
    assert b"b.egs" not in text
    assert decibels(picture(page, scene=1, trial=1), picture(page)) > 20
    assert ask(page, ASKED | {"trial": 2})[0] == 400


def test_a_cancelled_encoding_leaves_nothing(page, monkeypatch):
    begun = threading.Event()

    def encode(self: object, settings: object, progress) -> None:
        begun.set()
        while True:
            progress("code", 1, 2)
            time.sleep(0.01)

    monkeypatch.setattr("viewer.scenes.trial_list.Trials.encode", encode)
    ask(page, ENCODING)
    assert begun.wait(60)
    told = json.loads(ask(page, {"call": "cancel"})[2])
    assert told == {"doing": None, "error": "", "trials": []}


def test_an_encoding_that_fails_says_why(page, monkeypatch):
    def encode(self: object, settings: object, progress: object) -> None:
        raise MemoryError

    monkeypatch.setattr("viewer.scenes.trial_list.Trials.encode", encode)
    ask(page, ENCODING)
    assert until_idle(page)["error"] == "not enough memory"


def test_the_latest_picture_of_a_kind_is_drawn(page):
    page.inspector.open()
    found: dict[int, int] = {}

    def wait(number: int) -> None:
        found[number] = ask(page, ASKED | {"w": 40 + number})[0]

    with page.inspector._drawing:  # as if another picture were drawn
        threads = []
        for number in range(3):
            threads.append(threading.Thread(target=wait, args=[number]))
            threads[-1].start()
            while page.inspector._newest["picture 0"] <= number:
                time.sleep(0.01)
    for thread in threads:
        thread.join(60)
    assert found == {0: 409, 1: 409, 2: 200}


@pytest.mark.parametrize(
    "changes",
    [
        {"call": "open"},
        {"call": ["picture"]},
        {"scene": 2},
        {"w": 1e5},
        {"h": 0},
        {"layers": ["/etc/passwd"]},
        {"layers": "splats"},
        {"colouring": 1},
        {"scale": "cubic"},
        {"depth": 99},
        {"degree": 4},
        {"background": [0, 0]},
        {"trial": -1},
        {"camera": None},
        {"camera": CAMERA | {"fx": "inf"}},
        {"call": "encode", "profile": "m", "wish": "steps", "value": -1},
        {"call": "encode", "profile": "x", "wish": "steps", "value": 1},
    ],
    ids=str,
)
def test_calls_that_are_not_possible_are_refused(page, changes):
    status, _, text = ask(page, ASKED | changes)
    assert status == 400
    assert 0 < len(text.decode().splitlines()) == 1


def test_calls_from_elsewhere_or_without_the_address_are_refused(page):
    assert ask(page, ASKED, host="example.org")[0] == 404
    assert ask(page, ASKED, path=f"../{page.inspector.address}")[0] == 404
    assert ask(page, b"{")[0] == 400
    assert ask(page, b"[" * 60_000)[0] == 400
    assert ask(page, b" " * 70_000)[0] == 413
    assert get(page, "inspect")[0] == 404


@pytest.mark.thorough
def test_a_dropped_file_is_shown_and_inspected_instead(page, folder):
    before = page.inspector.address
    assert ask(page, {"call": "facts"})[0] == 200
    write_ply(folder / "c d.ply", random_scene(700, 0, seed=3))
    assert put(page, "c%20d.ply", (folder / "c d.ply").read_bytes()) == (200, "")
    status, shown = get(page, "")
    assert status == 200
    assert b"<title>c d.ply</title>" in shown
    assert get(page, "a.egs")[0] == 404
    facts = json.loads(ask(page, {"call": "facts"})[2])
    assert (facts["second"], facts["photographs"]) == (False, False)
    assert ask(page, ASKED)[0] == 200
    assert ask(page, ASKED, before)[0] == 404  # of a page that shows the earlier scenes
    assert put(page, "e.ply", b"ply")[0] == 400
    assert put(page, "e.ply", b"ply")[1].startswith("e.ply: ")
    with pytest.raises(gs_codec.GsCodecError, match=r"e\.splat: only a part of it has arrived"):
        page.take("e.splat", io.BufferedReader(io.BytesIO(bytes(64))), 96)
    assert get(page, "") == (200, shown)


def test_inspections_that_dropped_files_end_are_closed(page, folder, monkeypatch):
    coded(folder / "moving.egs", moving(100, 2, 1), group=2)
    closed, close = [], Inspector.close
    monkeypatch.setattr(Inspector, "close", lambda self: closed.append(self) or close(self))
    first = page.inspector
    assert put(page, "e.ply", b"ply")[0] == 400
    assert len(closed) == 1
    assert page.inspector is first
    assert put(page, "moving.egs", (folder / "moving.egs").read_bytes())[0] == 200
    assert len(closed) == 3
    assert closed[1] is first
    assert page.inspector is None
    assert ask(page, {"call": "facts"})[0] == 404  # sequences are only played
    assert put(page, "a.ply", (folder / "a.ply").read_bytes())[0] == 200
    assert ask(page, {"call": "facts"})[0] == 200


@pytest.mark.parametrize("name", ["", "..", "x/y.ply", "..%2Fy.ply", "y%00.ply"])
def test_dropped_files_without_a_plain_name_are_refused(page, name):
    assert put(page, name, b"ply")[0] in (400, 404)


def test_a_large_dropped_file_that_cannot_be_written_is_read_before_the_answer(page):
    status, told = put(page, 300 * "x", bytes(1 << 25))
    assert (status, told.endswith("File name too long")) == (400, True)


def test_dropped_files_are_written_to_the_folder_for_large_files(page, folder, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(folder / "missing"))
    status, told = put(page, "a.ply", (folder / "a.ply").read_bytes())
    assert (status, str(folder / "missing") in told) == (400, True)


def test_dropped_files_are_limited_and_come_from_this_host(page):
    assert put(page, "a.ply", b"", **{"Content-Length": str(1 << 32)})[0] == 413
    assert put(page, "a.ply", b"ply", Host="example.org")[0] == 404


@in_browser
def test_a_browser_opens_a_dropped_file(page, folder):
    data = list((folder / "b.ply").read_bytes())
    drop = """((bytes, name) => {
        const dataTransfer = new DataTransfer();
        dataTransfer.items.add(new File([new Uint8Array(bytes)], name));
        const of = { dataTransfer, bubbles: true, cancelable: true };
        const event = (kind) => new DragEvent(kind, of);
        return ['dragover', 'drop'].map((kind) => document.body.dispatchEvent(event(kind)));
    })"""
    told = "document.getElementById('status').textContent"
    job = Job(page.url, [("drawn",), ("value", f"{drop}([112, 108, 121], 'e.ply')")])
    job.steps += [("until", f"{told}.startsWith('e.ply')"), ("value", told)]
    folder_of = """(() => {
        const slice = () => ({ arrayBuffer: () => Promise.reject(new Error('a folder')) });
        const dataTransfer = { files: [{ name: 'f', size: 4096, slice }] };
        return dispatchEvent(Object.assign(new Event('drop'), { dataTransfer }));
    })()"""
    job.steps += [("value", folder_of), ("until", f"{told} === 'a folder'")]
    job.steps += [("value", f"{drop}({data}, 'b.ply')"), ("until", "document.title === 'b.ply'")]
    job.steps += [("drawn",), ("value", "document.querySelectorAll('#inspect').length")]
    [told] = open_pages(job)
    assert told.errors == [
        "Failed to load resource: the server responded with a status of 400 (Bad Request)"
    ]
    assert told.state == "ready"
    assert told.values[1] == [False, False]  # the browser itself opens no file
    assert told.values[-1] == 1


@in_browser
def test_a_browser_picks_the_error_encodes_and_shows_the_result(page, tmp_path):
    here = "#inspect fieldset ~ fieldset"
    job = Job(page.url, [("drawn",)], panel=True)
    job.steps += [("click", "#inspect > summary"), ("until", "document.querySelector('.layers')")]
    layers = "document.getElementById('layers')"
    job.shot(str(tmp_path / "own.png"))
    job.steps += [("click", "#inspect input[value=error]"), ("until", f"!{layers}.hidden")]
    job.shot(str(tmp_path / "error.png"))
    slide = f"""(() => {{
        const slider = document.querySelector('{here} input[type=range]');
        slider.value = 190;
        slider.dispatchEvent(new Event('input'));
        return slider.nextSibling.value;
    }})()"""
    job.steps += [("value", slide), ("click", f"{here} button")]
    job.steps += [("until", "document.querySelector('#inspect li')?.textContent.includes('worst')")]
    job.steps += [("value", "document.querySelector('#inspect li').textContent")]
    job.steps += [("click", "#inspect li button"), ("until", "location.search === '?b=1'")]
    job.steps += [("drawn",), ("until", f"!{layers}?.hidden")]
    job.shot(str(tmp_path / "encoded.png"))
    job.steps += [("value", "document.querySelector('#scenes').textContent")]
    [told] = open_pages(job)
    assert told.errors == []
    own, error, encoded = (seen(tmp_path / f"{n}.png") for n in ("own", "error", "encoded"))
    left = np.s_[:, : own.shape[1] // 2 - 20]
    assert decibels(own[left], error[left]) > 30  # A, drawn by the server
    assert decibels(own, error) < 25
    assert decibels(error, encoded) < 35  # the errors of another B
    texts = [value for value in told.values if isinstance(value, str)]
    assert texts[0] == "3.48"
    assert texts[1].startswith("#1 m x3.48")
    assert "B: #1 m x3.48" in texts[2]

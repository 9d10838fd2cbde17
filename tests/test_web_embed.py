"""Pages inside other pages, previews of links, and web servers, in Chromium."""

from __future__ import annotations

import io
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from web_pages import Job, decibels, drawn, in_browser, open_pages, serving

from gs_codec.cameras.camera import Camera
from gs_codec.cameras.camera_files import write_cameras
from gs_codec.cli.main import main
from gs_codec.codecs import decode_scene, encode_scene
from gs_codec.config import Config
from gs_codec.errors import InvalidInput
from gs_codec.files.link_preview import picture_of
from gs_codec.files.sharing import Publication, share
from gs_codec.views.estimate import auto_cameras
from samples.generate import generate

SIZE = WIDTH, HEIGHT = 300, 200

#: A page of another site, or of the same; `SITE` and `OPTIONS` are replaced.
HOST = """<!doctype html>
<html lang="en"><title>host</title><link rel="icon" href="data:,">
<body style="margin: 0"><p id="status" hidden></p><div id="here" style="height: 200px"></div>
<script type="module">
import { createViewer } from './site/embed.js';
window.states = [];
window.messages = [];
window.viewer = createViewer(document.getElementById('here'), {
    page: 'SITE',
    onChange: (state) => window.states.push(state),
    onMessage: (...message) => window.messages.push(message),
    ...OPTIONS,
});
window.viewer.ready.then(
    (facts) => { window.facts = facts; document.body.dataset.state = 'ready'; },
    (error) => { window.facts = error.message; document.body.dataset.state = 'ready'; },
);
</script>"""


@pytest.fixture(scope="module")
def cameras() -> list[Camera]:
    found = auto_cameras(generate(4000, 1, 12), 3)
    return [
        replace(camera.resized(*SIZE), name=f"view {k}", cx=150.0 + 9 * k)
        for k, camera in enumerate(found)
    ]


@pytest.fixture(scope="module")
def folder(tmp_path_factory, cameras) -> Path:
    """Two sites and pages that show them: one scene, which any site may embed, and two."""
    folder = tmp_path_factory.mktemp("embed")
    scene = generate(4000, 1, 12)
    write_cameras(folder / "cameras.json", cameras)
    for name, coarseness in (("a", 1.0), ("b", 16.0)):
        config = Config("l", block_size=1024, coarseness=coarseness)
        (folder / f"{name}.egs").write_bytes(encode_scene(scene, config)[0])
    views, files = folder / "cameras.json", [folder / "a.egs", folder / "b.egs"]
    share(files, folder / "site", views)
    share(files[:1], folder / "open", views, publication=Publication(embed=["*"]))
    share(files, folder / "alone.html", views)
    return folder


def host(folder: Path, page: str, options: str = "{}") -> str:
    """Name of a page that embeds another."""
    name = f"host{len(list(folder.glob('host*')))}.html"
    (folder / name).write_text(HOST.replace("SITE", page).replace("OPTIONS", options))
    return name


#: A picture of the viewer as rows of RGB, 0-255.
PICTURE = """(async () => {
    const picture = await createImageBitmap(await window.viewer.picture());
    const canvas = new OffscreenCanvas(picture.width, picture.height).getContext('2d');
    canvas.drawImage(picture, 0, 0);
    return [...canvas.getImageData(0, 0, picture.width, picture.height).data];
})()"""


@in_browser
def test_an_embedding_page_controls_the_viewer(folder, cameras, tmp_path):
    start = "{title: 'A statue', state: {view: 1, show: 'a', background: 'white', turn: undefined}}"
    with serving(folder) as url:
        job = Job(url + host(folder, "site/index.html", start), [("drawn",), ("value", "facts")])
        job.steps += [("value", "viewer.state"), ("value", "viewer.element.title")]
        job.steps.append(("value", PICTURE))
        job.steps.append(("value", "viewer.set({view: 2, background: 'black', show: 'b'})"))
        job.steps += [("until", "states.at(-1).view === 2"), ("value", PICTURE)]
        again = "viewer.set(viewer.state)"
        job.steps += [("value", "viewer.set({camera: [0, 0, -4, 0, 0, 0, 0, -1, 0]})")]
        job.steps += [("value", again), ("value", "messages")]
        [told] = open_pages(job)
    _, facts, state, title, first, changed, _, second, moved, same, messages = told.values
    assert told.errors == []
    assert facts["views"] == ["view 0", "view 1", "view 2"]
    assert [each["name"] for each in facts["scenes"]] == ["a.egs", "b.egs"]
    assert (facts["scenes"][0]["count"], facts["errors"]) == (4000, [])
    assert (state["view"], state["show"], state["background"]) == (1, "a", "white")
    assert title == "A statue"
    assert (changed["view"], changed["show"], changed["turn"]) == (2, "b", False)
    assert moved["camera"] == pytest.approx([0, 0, -4, 0, 0, 0, 0, -1, 0])
    assert same.pop("camera") == pytest.approx(moved.pop("camera"))
    assert same == moved
    assert messages == []
    versions = {name: decode_scene((folder / f"{name}.egs").read_bytes()) for name in "ab"}
    for pixels, name, view, background in ((first, "a", 1, (1, 1, 1)), (second, "b", 2, (0, 0, 0))):
        page = np.reshape(pixels, (HEIGHT, WIDTH, 4))[..., :3] / 255
        assert decibels(page, drawn(versions[name], cameras[view], background)) > 45


@in_browser
def test_impossible_values_are_refused_and_change_nothing(folder):
    refused = {
        "{view: 3}": "view: not possible: 3",
        "{view: 1, show: 'wipe'}": "show: not possible: wipe",
        "{camera: [1, 2]}": "camera: not possible: 1,2",
        "{view: 1, camera: [0, 0, 1, 0, 0, 1, 0, 1, 0]}": "camera: not possible: 0,0,1,0,0,1,0,1,0",
        "{turn: 'constructor'}": "turn: not possible: constructor",
        "{constructor: 1}": "constructor: not possible: 1",
    }
    with serving(folder) as url:
        job = Job(url + host(folder, "open/index.html"), [("drawn",)])
        for asked in refused:
            job.steps.append(("value", f"viewer.set({asked}).catch((error) => error.message)"))
        job.steps.append(("value", "viewer.state.view"))
        [told] = open_pages(job)
    assert told.values[1:] == [*refused.values(), 0]


#: Answers to a page that embeds another without the module.
ASKED = """new Promise((resolve) => {
    addEventListener('message', ({ data }) => resolve(data));
    const call = { gsCodec: 1, id: 7, call: 'picture' };
    document.querySelector('iframe').contentWindow.postMessage(call, '*');
})"""


@in_browser
def test_only_permitted_sites_see_the_page(folder):
    with serving(folder) as url, serving(folder) as other:
        jobs = [
            Job(url + host(folder, f"{other}{name}/index.html"), []) for name in ("site", "open")
        ]
        for job in jobs:
            job.steps += [("drawn",), ("value", "facts"), ("value", ASKED)]
        jobs[0].steps.append(("value", "states.length + messages.length"))
        refused, allowed = open_pages(*jobs)
    message = f"pages of {url[:-1]} may not control this page: gs-codec share --embed"
    assert refused.values[1:] == [message, {"gsCodec": 1, "id": 7, "error": message}, 0]
    assert allowed.values[1]["views"] == ["view 0", "view 1", "view 2"]
    assert allowed.values[2]["id"] == 7
    assert "result" in allowed.values[2]


FRAME = "document.querySelector('iframe')"


@in_browser
def test_other_pages_and_closed_viewers_do_not_answer(folder):
    (folder / "other.html").write_text('<link rel="icon" href="data:,">no viewer')
    wait = "((later) => (globalThis.setTimeout = (f, t, ...g) => later(f, t / 9, ...g)))"
    hasty = f"{wait}(setTimeout)"
    closed = "(viewer.close(), viewer.set({view: 1}).catch((error) => error.message))"
    early = """import('./site/embed.js').then(({ createViewer }) => {
      const viewer = createViewer(document.body);
      viewer.close();
      return viewer.set({ view: 1 }).catch((error) => error.message);
    })"""
    with serving(folder) as url:
        told, gone = open_pages(
            Job(url + host(folder, "other.html"), [("drawn",), ("value", "facts")], before=hasty),
            Job(
                url + host(folder, "alone.html"),
                [("drawn",), ("value", closed), ("value", FRAME), ("value", early)],
            ),
        )
    assert told.values[1] == f"{url}other.html: no answer; it is not a page of gs-codec share"
    assert gone.values[1:] == ["the viewer is closed", None, "the viewer is closed"]


def tags(page: Path) -> dict[str, str]:
    text = page.read_text(encoding="utf-8")
    return dict(re.findall(r'<meta (?:property|name)="([\w:]+)" content="([^"]*)">', text))


def test_links_have_a_title_a_description_and_a_picture(folder, cameras, tmp_path):
    url = "https://example.org/fox/index.html?from=a/b#view=1/2"
    publication = Publication(title='Fox "<1>', url=url)
    views = folder / "cameras.json"
    share([folder / "a.egs"], tmp_path / "site", views, publication=publication)
    found = tags(tmp_path / "site" / "index.html")
    assert found["og:title"] == "Fox &quot;&lt;1&gt;"
    assert found["og:image"] == "https://example.org/fox/preview.jpg"
    assert found["og:url"] == url
    assert re.search(r": 4,000 Gaussians, \d+\.\d\d kB$", found["og:description"])
    here = tags(folder / "site" / "index.html")
    assert here["og:title"] == "a.egs and b.egs"
    assert here["og:image"] == "preview.jpg"
    assert "og:image" not in tags(folder / "alone.html")
    picture = np.asarray(Image.open(tmp_path / "site" / "preview.jpg"))
    scene = decode_scene((folder / "a.egs").read_bytes())
    assert decibels(picture / 255, drawn(scene, cameras[0].resized(1200, 800))) > 30


def test_the_picture_of_two_scenes_has_a_line_between_their_halves(cameras):
    scenes = [generate(300, 0, 1), generate(300, 0, 2)]
    alone = [_pixels(picture_of([scene], cameras[0])) for scene in scenes]
    both = _pixels(picture_of(scenes, cameras[0]))
    for half, columns in zip(alone, (slice(0, 590), slice(610, 1200)), strict=True):
        assert decibels(both[:, columns], half[:, columns]) > 35
    assert both[:, 599:601].min() > 0.9


def test_a_tall_view_is_cut_to_a_square(cameras):
    scene = generate(300, 0, 1)
    tall = replace(cameras[0], height=600, cy=300.0)
    square = replace(tall, height=300, cy=150.0).resized(1200, 1200)
    assert decibels(_pixels(picture_of([scene], tall)), drawn(scene, square)) > 30


def _pixels(data: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(data)), np.float64) / 255


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"url": "example.org"}, "url 'example.org': expected"),
        ({"url": "https://example.org?a/b"}, "expected the page's: https://example.org/a/"),
        ({"url": "https://example.org"}, "expected the page's"),
        ({"url": "https://example.org/\udce9"}, "expected UTF-8"),
        ({"title": "A\udce9"}, r"title 'A\\udce9': expected UTF-8"),
        ({"embed": ["https://example.org/"]}, "expected \\* or a site: https://example.org"),
        ({"embed": ["*", "null"]}, "embed 'null'"),
        ({"embed": ["https://Example.org"]}, "in lower case"),
        ({"embed": ["https://example.org:443"]}, "without the default port"),
        ({"embed": ["http://a.b:80"]}, "without the default port"),
        ({"embed": ["https://müller.example"]}, "as browsers state it"),
    ],
)
def test_addresses_are_checked(given, message):
    with pytest.raises(InvalidInput, match=message):
        Publication(**given)


def test_origins_are_those_of_browsers():
    origins = ["https://a-b.example.org", "http://localhost:8000", "http://[::1]:8443"]
    assert Publication(embed=origins).embed == origins


def test_the_command_has_the_same_options(folder, tmp_path, monkeypatch):
    arguments = ["share", folder / "a.egs", "--cameras", folder / "cameras.json"]
    arguments += ["--out", tmp_path / "page.html", "--title", "T", "--url", "http://a.b/page.html"]
    arguments += ["--embed", "https://c.d", "--embed", "http://127.0.0.1:8000"]
    monkeypatch.setattr("sys.argv", ["gs-codec", *map(str, arguments)])
    with pytest.raises(SystemExit) as stop:
        main()
    assert not stop.value.code
    found = (tmp_path / "page.html").read_text(encoding="utf-8")
    listed = json.loads(found.split('id="scene-list">')[1].split("</script>")[0])
    assert listed["embed"] == ["https://c.d", "http://127.0.0.1:8000"]
    assert "<title>T</title>" in found
    assert tags(tmp_path / "page.html")["og:url"] == "http://a.b/page.html"

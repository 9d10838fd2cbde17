"""The page for scenes with levels of detail, in Chromium: what is fetched, cached and drawn."""

from __future__ import annotations

import http.server
import re
import shutil
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from damage import flipped
from level_files import city
from web_pages import Job, decibels, drawn, in_browser, open_pages, seen
from web_pages import serving as serving_without_ranges

from gs_codec.cameras.camera import Camera, facing
from gs_codec.cameras.camera_files import write_cameras
from gs_codec.codecs import decode_part
from gs_codec.codecs.decode import choose_part
from gs_codec.codecs.part import Part
from gs_codec.egs.egs_file import Section, SectionId, read_file, write_file
from gs_codec.egs.index import levels_of, open_level
from gs_codec.files.sharing import share
from gs_codec.scene import Scene

pytestmark = in_browser

SIZE = WIDTH, HEIGHT = 300, 200


def camera(name: str, place: tuple, target: tuple, focal: float = 250.0) -> Camera:
    position = np.array(place, np.float64)
    turn = facing(np.array(target) - position, np.array([0.0, -1.0, 0.0]))
    return Camera(name, WIDTH, HEIGHT, focal, focal, WIDTH / 2, HEIGHT / 2, turn, position)


@dataclass
class Site:
    """A page with a scene with levels."""

    folder: Path
    scene: Scene
    cameras: list[Camera]


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Site:
    folder = tmp_path_factory.mktemp("detail")
    data = city()
    (folder / "city.egs").write_bytes(data)
    scene = decode_part(data, Part())[0]
    low, high = (np.quantile(scene.positions, q, axis=1) for q in (0.02, 0.98))
    middle, span = (low + high) / 2, high - low
    far = middle + span * (0.2, -2.0, -3.0)
    near = low + span * (0.1, 0.3, 0.1)
    other = low + span * (0.9, 0.3, 0.9)
    cameras = [
        camera("far", far, middle),
        camera("near", near, middle),
        camera("other", other, middle),
    ]
    write_cameras(folder / "cameras.json", cameras)
    share([folder / "city.egs"], folder / "site", folder / "cameras.json")
    return Site(folder, scene, cameras)


@dataclass
class Requested:
    """The requests that a server received."""

    ranges: list[tuple[int, int]] = field(default_factory=list)
    given: int = 0  # bytes of the scene sent
    over: threading.Event = field(default_factory=threading.Event)
    mended: bool = False


class serving:  # noqa: N801
    """A server of a folder, with ranges.

    Ranges with `stalls(begin, end)` are not answered until `mended` is requested; those with
    `fails(begin, end)` fail on the first request. A request for the whole scene gets half of it at
    first, and all of it the second time.
    """

    def __init__(
        self,
        folder: Path,
        stalls: Callable[[int, int], bool] = lambda begin, end: False,
        fails: Callable[[int, int], bool] = lambda begin, end: False,
    ) -> None:
        requested = self.requested = Requested()

        class Handler(http.server.SimpleHTTPRequestHandler):
            def __init__(self, *given: Any) -> None:
                super().__init__(*given, directory=str(folder))

            def log_message(self, *_: Any) -> None:
                pass

            def do_GET(self) -> None:
                found = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
                if found is None:
                    if self.path == "/mended":
                        requested.mended = True
                        requested.over.set()
                        self.send_response(204)
                        self.end_headers()
                    elif self.path.endswith(".egs"):
                        self.send_whole()
                    else:
                        super().do_GET()
                    return
                begin, end = int(found[1]), int(found[2]) + 1
                requested.ranges.append((begin, end))
                if stalls(begin, end):
                    requested.over.wait(300)
                    if not requested.mended:
                        return
                if fails(begin, end) and requested.ranges.count((begin, end)) == 1:
                    self.send_error(503)
                    return
                data = Path(self.translate_path(self.path)).read_bytes()
                part = data[begin:end]
                requested.given += len(part)
                self.send_response(206)
                self.send_header("Content-Range", f"bytes {begin}-{end - 1}/{len(data)}")
                self.send_header("Content-Length", str(len(part)))
                self.end_headers()
                self.wfile.write(part)

            def send_whole(self) -> None:
                data = Path(self.translate_path(self.path)).read_bytes()
                requested.ranges.append((0, len(data)))
                self.send_response(200)
                self.send_header("Content-Length", str(len(data)))
                self.end_headers()
                self.wfile.write(data[: len(data) // 2])
                if requested.ranges.count((0, len(data))) == 1:
                    requested.over.wait(300)
                else:
                    self.wfile.write(data[len(data) // 2 :])

        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)

    def __enter__(self) -> tuple[str, Requested]:
        threading.Thread(target=self.server.serve_forever, daemon=True).start()
        return f"http://127.0.0.1:{self.server.server_port}/", self.requested

    def __exit__(self, *_: object) -> None:
        self.requested.over.set()
        self.server.shutdown()
        self.server.server_close()


DETAIL = "document.querySelector('.detail').textContent"
MISSING = "document.getElementById('refined').textContent"


def gaussians_of(text: str) -> int:
    """The number of drawn Gaussians shown in the panel."""
    return int(text.split("fetched, ")[1].split(maxsplit=1)[0].replace(",", ""))


def first_block() -> int:
    """Start of the blocks of the scene itself in its file."""
    return read_file(city()).table[SectionId.GEOMETRY, 0].position


@pytest.mark.thorough
def test_views_are_sharp_everywhere_and_nothing_else_is_fetched(site, tmp_path):
    assert (site.folder / "site" / "city.egs").read_bytes() == city()
    job = Job("", [], panel=True)
    for k in range(3):
        job.shot(str(tmp_path / f"{k}.png"))
        job.steps += [("value", DETAIL), ("key", "n")]
    job.shot(str(tmp_path / "again.png"))
    job.steps.append(("value", MISSING))
    with serving(site.folder / "site") as (url, requested):
        job.url = url
        [told] = open_pages(job)
    assert (told.state, told.status, told.errors, told.values[-1]) == ("ready", "", [], "")
    for k, one in enumerate(site.cameras):
        ours = drawn(site.scene, one)
        assert np.ptp(ours) > 0.3
        assert decibels(seen(tmp_path / f"{k}.png"), ours) > 35
    assert decibels(seen(tmp_path / "again.png"), seen(tmp_path / "0.png")) > 45
    told_of = [text for text in told.values if isinstance(text, str) and "drawn" in text]
    assert len(told_of) == 3
    assert all(0 < gaussians_of(text) < site.scene.count for text in told_of)
    # Fetched data are cached: nothing is requested twice.
    assert len(set(requested.ranges)) == len(requested.ranges)
    assert requested.given < 0.8 * len(city())


def test_the_first_picture_comes_before_a_tenth_of_the_file(site, tmp_path):
    """All data except the coarsest level stall; the camera can move, and loading can be stopped."""
    file = read_file(city())
    starts = [file.table[SectionId.LEVEL, level].position for level in levels_of(file)]
    coarsest = file.table[SectionId.LEVEL, len(starts)]
    end = coarsest.position + coarsest.size

    def stalls(begin: int, _: int) -> bool:
        return begin >= end and begin not in starts

    with serving(site.folder / "site", stalls) as (url, requested):
        job = Job(url, [], panel=True)
        job.steps += [("until", f"{DETAIL}.includes(' drawn') && !{DETAIL}.includes(' 0 ')")]
        job.steps += [("until", f"{MISSING} !== ''"), ("value", "document.body.dataset.state")]
        job.steps += [
            ("key", "n"),
            ("hold", "w", 200),
            ("key", "r"),
            ("key", "p"),
            ("click", "#stop"),
        ]
        job.shot(str(tmp_path / "first.png"))
        job.steps += [("value", DETAIL), ("value", MISSING)]
        [told] = open_pages(job)
    assert (told.state, told.errors) == ("ready", [])
    assert told.status == "Stopped: the page shows what was loaded."
    assert "ready" not in told.values
    assert "of this view missing" in told.values[-1]
    assert requested.given < 0.1 * len(city())
    assert decibels(seen(tmp_path / "first.png"), drawn(site.scene, site.cameras[0])) > 20


@pytest.mark.thorough
def test_stalled_blocks_are_drawn_coarser_and_the_rest_is_sharp(site, tmp_path):
    """Requests for blocks of the scene itself stall; those of past views are cancelled."""
    begins, far = first_block(), choose_part(city(), Part(view=site.cameras[0])).blocks
    table = read_file(city()).table
    # Except those that a distant view also needs.
    needed = {entry.position for (_, block), entry in table.items() if block in far}

    def stalls(begin: int, _: int) -> bool:
        return begin >= begins and begin not in needed

    with serving(site.folder / "site", stalls) as (url, _):
        job = Job(url, [("key", "n"), ("until", f"{MISSING} !== ''")], panel=True)
        for _ in range(4):
            job.steps += [("key", "n"), ("key", "p")]
        job.steps += [("until", f"{DETAIL}.includes(' drawn')")]
        job.steps += [("until", "document.body.dataset.state === 'loading'"), ("key", "p")]
        job.shot(str(tmp_path / "far.png"))
        [told] = open_pages(job)
    assert len(far) < 3
    assert told.errors == []
    assert decibels(seen(tmp_path / "far.png"), drawn(site.scene, site.cameras[0])) > 35


@pytest.mark.thorough
def test_lost_blocks_are_requested_again(site, tmp_path):
    """At first all blocks of the scene itself fail, but not for ever."""
    begins = first_block()
    with serving(site.folder / "site", fails=lambda begin, _: begin >= begins) as (url, requested):
        job = Job(url, [("drawn",), ("key", "n")])
        job.shot(str(tmp_path / "near.png"))
        [told] = open_pages(job)
    assert (told.state, told.status) == ("ready", "")
    assert max(requested.ranges.count(each) for each in requested.ranges) > 1
    assert decibels(seen(tmp_path / "near.png"), drawn(site.scene, site.cameras[1])) > 35


#: Make twenty seconds pass at once.
HASTY = """(() => {
    const { setTimeout } = window;
    window.setTimeout = (work, time) => setTimeout(work, time === 20000 ? 200 : time);
})()"""
STATUS = "document.getElementById('status').textContent"
MAY_RETRY = "!document.getElementById('retry').hidden"


@pytest.mark.thorough
@pytest.mark.parametrize("which", ["first", "blocks", "whole"])
def test_silent_servers_are_retried_and_then_manually(site, tmp_path, which):
    """Stalls are in the first bytes, in blocks of the scene, or in a scene without levels."""
    begins = first_block()

    def stalls(begin: int, _: int) -> bool:
        return which != "whole" and (begin == 0 if which == "first" else begin >= begins)

    folder = site.folder / "site"
    if which == "whole":
        (tmp_path / "plain.egs").write_bytes(without_levels(city()))
        folder = tmp_path / "plain"
        share([tmp_path / "plain.egs"], folder, site.folder / "cameras.json")
    job = Job("", [("key", "n"), ("until", f"{STATUS}.endsWith('retrying')")], before=HASTY)
    job.steps.append(("value", STATUS))
    if which != "whole":
        job.steps += [("until", MAY_RETRY), ("value", STATUS)]
        job.steps.append(("value", f"{DETAIL}.includes('drawn')"))
        job.steps += [("value", "fetch('/mended').then(() => null)"), ("click", "#retry")]
        job.steps.append(("until", f"{STATUS} === ''"))
    job.shot(str(tmp_path / "near.png"))
    with serving(folder, stalls) as (job.url, _):
        [told] = open_pages(job)
    assert (told.state, told.status, told.errors) == ("ready", "", [])
    first, *later = [value for value in told.values if value is not None]
    assert first.startswith(f"{'plain' if which == 'whole' else 'city'}.egs: ")
    assert first.endswith("no data for 20 seconds: retrying")
    assert first.count(".egs") == 1
    if later:
        assert later[0].endswith("no data for 20 seconds")
        assert later[1] == (which == "blocks")  # meanwhile, the available blocks are drawn
    assert decibels(seen(tmp_path / "near.png"), drawn(site.scene, site.cameras[1])) > 35


@pytest.mark.thorough
def test_moving_fast_there_and_back_gives_the_same_picture(site, tmp_path):
    with serving(site.folder / "site") as (url, _):
        job = Job(url, [])
        job.shot(str(tmp_path / "before.png"))
        for _ in range(3):
            job.steps += [
                ("key", "n"),
                ("drag", [[150, 100], [190, 110], [150, 100]], 2),
                ("key", "n"),
            ]
            job.steps += [("key", "p"), ("key", "p")]
        job.shot(str(tmp_path / "after.png"))
        job.steps.append(("key", "n"))
        job.shot(str(tmp_path / "near.png"))
        [told] = open_pages(job)
    assert (told.state, told.status, told.errors) == ("ready", "", [])
    assert decibels(seen(tmp_path / "after.png"), seen(tmp_path / "before.png")) > 45
    assert decibels(seen(tmp_path / "near.png"), drawn(site.scene, site.cameras[1])) > 35


ROWS = """(() => {
    const device = WebGL2RenderingContext.prototype;
    const { texStorage2D } = device;
    window.rows = [];
    device.texStorage2D = function (...given) {
        if (given[3] === 1024) window.rows.push(given[4]);
        return texStorage2D.apply(this, given);
    };
})()"""


BUDGET = """((value) => {
    const input = document.getElementById('budget');
    input.value = value;
    input.dispatchEvent(new Event('change', {bubbles: true}));
})"""


@pytest.mark.thorough
def test_blocks_that_fit_another_budget_are_kept(site, tmp_path):
    """Blocks move when there are fewer of them; they are not requested again."""
    job = Job("", [("drawn",), ("key", "n")])
    job.shot(str(tmp_path / "before.png"))
    for k, value in enumerate((0.05, 1)):
        job.steps.append(("value", f"{BUDGET}({value})"))
        job.shot(str(tmp_path / f"{k}.png"))
    with serving(site.folder / "site") as (job.url, requested):
        [told] = open_pages(job)
    assert (told.state, told.status, told.errors) == ("ready", "", [])
    assert len(set(requested.ranges)) == len(requested.ranges)
    for k in range(2):
        assert decibels(seen(tmp_path / f"{k}.png"), seen(tmp_path / "before.png")) > 50


@pytest.mark.thorough
def test_the_budget_is_respected_and_can_be_changed(site, tmp_path):
    """15 blocks of 511 Gaussians, each in a texture row of 1,024."""
    shown = ("value", "Number(document.getElementById('budget').value)")
    job = Job("", [("drawn",), shown, ("value", f"{BUDGET}(0.0154)")], before=ROWS)
    for k in range(3):
        job.steps += [("key", "n"), ("drawn",), ("value", DETAIL)]
        job.shot(str(tmp_path / f"{k}.png"))
    # Whatever was viewed and evicted before: the same view gives the same picture.
    for _ in range(4):
        job.steps += [("drag", [[150, 100], [250, 120], [20, 80], [150, 100]], 4), ("key", "n")]
        job.steps += [("hold", "Shift+w", 300), ("hold", "ArrowLeft", 300)]
    job.steps += [("key", "r"), ("drawn",)]
    job.shot(str(tmp_path / "back.png"))
    job.steps += [("value", "window.rows.at(-1)"), ("value", f"{BUDGET}(1)"), ("key", "n")]
    job.shot(str(tmp_path / "more.png"))
    with serving(site.folder / "site") as (url, _):
        job.url = url
        [told] = open_pages(job)
    assert (told.state, told.status, told.errors) == ("ready", "", [])
    numbers = [value for value in told.values if isinstance(value, int | float)]
    assert numbers[0] in (1, 1.5, 3)  # million, depending on the device
    assert 15 in numbers
    texts = [value for value in told.values if isinstance(value, str)]
    assert len(texts) == 3
    assert all(511 < gaussians_of(text) <= 15 * 511 for text in texts)
    for k in range(3):  # coarse, but complete
        ours = drawn(site.scene, site.cameras[(k + 1) % 3])
        assert decibels(seen(tmp_path / f"{k}.png"), ours) > 18
    assert decibels(seen(tmp_path / "back.png"), seen(tmp_path / "0.png")) > 45
    assert decibels(seen(tmp_path / "more.png"), drawn(site.scene, site.cameras[2])) > 35


@pytest.mark.thorough
def test_damaged_levels_are_reported_and_the_others_drawn(site, tmp_path):
    """All blocks of a level, or of the coarsest; without a header, the whole scene is drawn."""
    data = city()
    file = read_file(data)
    place = file.table[SectionId.LEVEL, 1].position
    own = open_level(file, 1).table
    damaged = data
    for block in range(open_level(file, 1).header.block_count):
        damaged = bytes(flipped(damaged, 8 * (place + own[SectionId.OPACITY, block].position)))
    header = bytes(flipped(data, 8 * (file.table[SectionId.LEVEL, 2].position + 20)))
    top = max(levels_of(file))
    place = file.table[SectionId.LEVEL, top].position
    place += open_level(file, top).table[SectionId.OPACITY, 0].position
    files = {"block": damaged, "header": header, "top": bytes(flipped(data, 8 * place))}
    jobs = []
    for name, content in files.items():
        shutil.copytree(site.folder / "site", tmp_path / name)
        (tmp_path / name / "city.egs").write_bytes(content)
    with serving(tmp_path) as (url, requested):
        requested.ranges.append((0, len(data)))  # the whole file is sent at once
        for name in files:
            jobs.append(Job(f"{url}{name}/index.html", [("drawn",), ("key", "n")]))
            jobs[-1].shot(str(tmp_path / f"{name}.png"))
        found = dict(zip(files, open_pages(*jobs), strict=True))
    assert [one.state for one in found.values()] == ["error"] * 3
    assert found["block"].status.startswith("city.egs: level 1: section opacity")
    assert found["header"].status == "city.egs: level 2: header: wrong checksum"
    told = f"city.egs: level {top}: section opacity of block 0: wrong checksum"
    assert found["top"].status == told
    ours = drawn(site.scene, site.cameras[1])
    for name, least in {"block": 20, "header": 35, "top": 35}.items():
        assert decibels(seen(tmp_path / f"{name}.png"), ours) > least
    assert max(requested.ranges.count(each) for each in requested.ranges[1:]) <= len(jobs)


@pytest.mark.thorough
def test_without_ranges_and_in_one_file_the_picture_is_the_same(site, tmp_path):
    """A server that ignores ranges; a page that contains the scene; next to one without levels."""
    plain = tmp_path / "plain.egs"
    plain.write_bytes(without_levels(city()))
    share([site.folder / "city.egs"], tmp_path / "one.html", site.folder / "cameras.json")
    sources = [site.folder / "city.egs", plain]
    share(sources, tmp_path / "two", site.folder / "cameras.json")
    one = Job((tmp_path / "one.html").as_uri(), [])
    with serving_without_ranges(tmp_path / "two") as url:
        two = Job(url, [("key", "3")])
        for job, name in ((one, "one"), (two, "wipe")):
            job.steps.append(("key", "n"))
            job.shot(str(tmp_path / f"{name}.png"))
        two.steps.append(("key", "4"))
        two.shot(str(tmp_path / "error.png"))
        found = open_pages(one, two)
    ours = drawn(site.scene, site.cameras[1])
    for told in found:
        assert (told.state, told.status, told.errors) == ("ready", "", [])
    for name in ("one", "wipe"):
        assert decibels(seen(tmp_path / f"{name}.png"), ours) > 35


def without_levels(data: bytes) -> bytes:
    file = read_file(data)
    kept = [
        Section(SectionId(number), block, content)
        for (number, block), content in file.sections.items()
        if number != SectionId.LEVEL
    ]
    return write_file(file.header, kept)

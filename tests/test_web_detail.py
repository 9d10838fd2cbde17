"""The page of scenes with levels of detail, in Chromium: what is fetched, kept and drawn."""

from __future__ import annotations

import http.server
import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from damage import flipped
from test_web_levels import city
from test_web_page import Job, built, decibels, drawn, in_browser, open_pages, seen

from gs_codec.codecs import decode_part
from gs_codec.codecs.part import Part
from gs_codec.egs.file import SectionId, read_file
from gs_codec.egs.levels import levels_of, open_level
from gs_codec.files.sharing import share
from gs_codec.rendering.camera import Camera, facing
from gs_codec.rendering.cameras import write_cameras
from gs_codec.scene import Scene

pytestmark = [built, in_browser]

SIZE = WIDTH, HEIGHT = 300, 200


def camera(name: str, place: tuple, target: tuple, focal: float = 250.0) -> Camera:
    position = np.array(place, np.float64)
    turn = facing(np.array(target) - position, np.array([0.0, -1.0, 0.0]))
    return Camera(name, WIDTH, HEIGHT, focal, focal, WIDTH / 2, HEIGHT / 2, turn, position)


@dataclass
class Site:
    """A page of a scene with levels."""

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
class Asked:
    """What a server was asked for."""

    ranges: list[tuple[int, int]] = field(default_factory=list)
    given: int = 0  # bytes of the scene
    over: threading.Event = field(default_factory=threading.Event)


class serving:  # noqa: N801
    """A server of a folder, with ranges; `stalls(begin, end)` of a scene are not answered."""

    def __init__(self, folder: Path, stalls: Callable[[int, int], bool] | None = None) -> None:
        asked = self.asked = Asked()

        class Handler(http.server.SimpleHTTPRequestHandler):
            def __init__(self, *given: Any) -> None:
                super().__init__(*given, directory=str(folder))

            def log_message(self, *_: Any) -> None:
                pass

            def do_GET(self) -> None:
                found = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
                if found is None:
                    super().do_GET()
                    return
                begin, end = int(found[1]), int(found[2]) + 1
                asked.ranges.append((begin, end))
                if stalls is not None and stalls(begin, end):
                    asked.over.wait(300)
                    return
                data = Path(self.translate_path(self.path)).read_bytes()
                part = data[begin:end]
                asked.given += len(part)
                self.send_response(206)
                self.send_header("Content-Range", f"bytes {begin}-{end - 1}/{len(data)}")
                self.send_header("Content-Length", str(len(part)))
                self.end_headers()
                self.wfile.write(part)

        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)

    def __enter__(self) -> tuple[str, Asked]:
        threading.Thread(target=self.server.serve_forever, daemon=True).start()
        return f"http://127.0.0.1:{self.server.server_port}/", self.asked

    def __exit__(self, *_: object) -> None:
        self.asked.over.set()
        self.server.shutdown()
        self.server.server_close()


def test_it_is_sharp_wherever_one_goes(site, tmp_path):
    job = Job("", [], panel=True)
    for k in range(3):
        job.shot(str(tmp_path / f"{k}.png"))
        job.steps += [("value", "document.querySelector('.detail').textContent"), ("key", "n")]
    job.shot(str(tmp_path / "again.png"))
    with serving(site.folder / "site") as (url, asked):
        job.url = url
        [told] = open_pages(job)
    assert (told.state, told.status, told.errors) == ("ready", "", [])
    print([v for v in told.values if v], asked.given, len(city()), len(asked.ranges))
    for k, one in enumerate(site.cameras):
        ours = drawn(site.scene, one)
        print(k, decibels(seen(tmp_path / f"{k}.png"), ours), np.ptp(ours))
    assert asked.given < 1.05 * len(city())

"""Open pages in Chromium, serve files to them, and compare screenshots."""

from __future__ import annotations

import functools
import http.server
import json
import shutil
import subprocess
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scenes import random_scene

from gs_codec.cameras.camera import Camera
from gs_codec.files.sharing import share
from gs_codec.formats.ply.writer import write_ply
from gs_codec.metrics.image_quality import psnr
from gs_codec.rendering.renderer import render
from gs_codec.scene import Scene

#: Root folder of the project.
ROOT = Path(__file__).parents[1]

#: Scripts that Node runs.
HERE = Path(__file__).parent / "web"

#: Paths of the programs; None if missing. The headless shell is Chromium without its windows, and
#: starts with half the work.
NODE = shutil.which("node")
CHROMIUM = shutil.which("chromium-headless-shell") or shutil.which("chromium")

#: For tests that open pages.
in_browser = pytest.mark.skipif(
    not (NODE and CHROMIUM and (HERE / "node_modules").is_dir()),
    reason="needs Node, Chromium, and npm ci in tests/web",
)

#: Default size of a page, in pixels.
SIZE = WIDTH, HEIGHT = 300, 200


@dataclass
class Job:
    """A page to open, and the actions on it."""

    url: str
    steps: list[tuple]
    size: tuple[int, int] = SIZE
    before: str | None = None
    panel: bool = False  # open the panel, as a user does on a small screen
    mobile: bool = False  # emulate a touch screen
    locale: str = "en-US"

    def shot(self, name: str) -> None:
        self.steps.append(("shot", name))


@dataclass
class Opened:
    """Result of a job."""

    values: list[Any] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)
    state: str = ""
    status: str = ""
    failure: str = ""


def open_pages(*jobs: Job) -> list[Opened]:
    """Open pages one after another, in one browser."""
    assert NODE
    assert CHROMIUM
    done = subprocess.run(
        [NODE, str(HERE / "page.mjs"), CHROMIUM],
        input=json.dumps([vars(job) for job in jobs]),
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    found = [Opened(**json.loads(line)) for line in done.stdout.splitlines()]
    assert len(found) == len(jobs), done.stderr
    for one in found:
        assert not one.failure, one.failure
    return found


#: Size and focal length of the views of `small_page`, pixels.
LENS = {"width": 60, "height": 40, "fx": 50, "fy": 50}

#: Positions of its cameras, which look along z.
POSITIONS = ([0, 0, -5], [1, 0, -4], [0, 1, -6])


def small_page(folder: Path, name: str = "a.ply", **options: Any) -> str:
    """Address of a page of `share` with 500 Gaussians around the origin and three views."""
    write_ply(folder / name, random_scene(500, 0, seed=2))
    turn = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    entries = [
        {"id": k, "img_name": f"{k}", "position": position, "rotation": turn, **LENS}
        for k, position in enumerate(POSITIONS)
    ]
    (folder / "cameras.json").write_text(json.dumps(entries))
    share([folder / name], folder / "page.html", folder / "cameras.json", **options)
    return (folder / "page.html").as_uri()


def seen(path: str | Path) -> np.ndarray:
    """Screenshot of a page, RGB, 0-1."""
    return np.asarray(Image.open(path).convert("RGB"), np.float64) / 255


def drawn(scene: Scene, camera: Camera, background: tuple = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Our renderer's image, quantised like a screenshot."""
    colour = render(scene, camera, background, device="cpu").colour
    return np.round(colour.clip(0, 1) * 255) / 255


def decibels(page: np.ndarray, ours: np.ndarray) -> float:
    assert page.shape == ours.shape
    return psnr(page, ours)


class Handler(http.server.SimpleHTTPRequestHandler):
    """A silent server that sends only half of `stalled.egs`; the project is at `/project`."""

    def translate_path(self, path: str) -> str:
        if path.startswith("/project/"):
            return str(ROOT / path.removeprefix("/project/").partition("?")[0])
        return super().translate_path(path.removeprefix("/files"))

    def log_message(self, *_: Any) -> None:
        pass

    def do_GET(self) -> None:
        if not self.path.endswith("stalled.egs"):
            super().do_GET()
            return
        data = Path(self.translate_path(self.path)).read_bytes()
        self.send_response(200)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data[: 2 * len(data) // 3])
        self.wfile.flush()
        self.server.over.wait(300)  # type: ignore[attr-defined]


class serving:  # noqa: N801
    """A server of a folder, reachable only from this machine."""

    def __init__(self, folder: Path) -> None:
        handler = functools.partial(Handler, directory=str(folder))
        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
        self.server.over = threading.Event()  # type: ignore[attr-defined]

    def __enter__(self) -> str:
        threading.Thread(target=self.server.serve_forever, daemon=True).start()
        return f"http://127.0.0.1:{self.server.server_port}/"

    def __exit__(self, *_: object) -> None:
        self.server.over.set()  # type: ignore[attr-defined]
        self.server.shutdown()
        self.server.server_close()

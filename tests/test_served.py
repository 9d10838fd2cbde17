"""``gs-viewer --web``: a page that only this machine can open."""

from __future__ import annotations

import http.client
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import urlsplit
from urllib.request import url2pathname

import numpy as np
import pytest
from moving_scenes import coded, moving
from scenes import random_scene
from web_pages import LENS, Job, in_browser, open_pages

from gs_codec.codecs import encode_scene
from gs_codec.config import Config
from gs_codec.errors import GsCodecError
from viewer import served
from viewer.main import main
from viewer.scenes.view_request import Request
from viewer.served import Page, serve

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("served") / "a.egs"
    path.write_bytes(encode_scene(random_scene(300, 1, seed=5), Config("m"))[0])
    return path


@pytest.fixture
def page() -> Iterator[Page]:
    page = Page({"a b.egs": b"scene", "index.html": b"page"})
    threading.Thread(target=page.serve_forever, daemon=True).start()
    yield page
    page.shutdown()
    page.server_close()


def answer(page: Page, path: str, method: str = "GET", host: str | None = None) -> tuple:
    """Status and body of the server's response."""
    connection = http.client.HTTPConnection("127.0.0.1", page.server_port, timeout=60)
    name = f"127.0.0.1:{page.server_port}" if host is None else host
    connection.request(method, path, headers={"Host": name})
    response = connection.getresponse()
    return response.status, response.read()


def test_a_slow_connection_gets_the_whole_file(page, monkeypatch):
    """Only silence ends it, as over SSH a file may take minutes."""
    monkeypatch.setattr(served._Handler, "timeout", 0.5)
    page.contents[f"{page.root}large"] = data = bytes(range(256)) * (1 << 16)
    host = f"127.0.0.1:{page.server_port}"
    found = bytearray()
    with socket.create_connection(("127.0.0.1", page.server_port), timeout=60) as connection:
        connection.sendall(f"GET {page.root}large HTTP/1.0\r\nHost: {host}\r\n\r\n".encode())
        while part := connection.recv(1 << 20):
            found += part
            time.sleep(0.1)
    assert found.partition(b"\r\n\r\n")[2] == data


def test_requests_with_the_address_are_answered(page):
    root = urlsplit(page.url).path
    assert urlsplit(page.url).hostname == "127.0.0.1"
    assert len(root) > 20
    assert answer(page, root) == (200, b"page")
    assert answer(page, f"{root}a%20b.egs") == (200, b"scene")
    assert answer(page, root, "HEAD") == (200, b"")
    assert answer(page, root, host="localhost:9000") == (200, b"page")  # through ssh -L


@pytest.mark.parametrize(
    ("asked", "status", "body", "told"),
    [
        ("bytes=0-1", 206, b"sc", "bytes 0-1/5"),
        ("bytes=3-99", 206, b"ne", "bytes 3-4/5"),
        ("bytes=2-", 206, b"ene", "bytes 2-4/5"),
        ("bytes=5-9", 416, None, None),
        ("bytes=3-1", 416, None, None),
        ("bytes=-2", 200, b"scene", None),
        ("bytes=0-1,3-4", 200, b"scene", None),
        ("lines=0-1", 200, b"scene", None),
    ],
)
def test_ranges_are_answered(page, asked, status, body, told):
    connection = http.client.HTTPConnection("127.0.0.1", page.server_port, timeout=60)
    path = urlsplit(page.url).path + "a%20b.egs"
    connection.request("GET", path, headers={"Range": asked})
    response = connection.getresponse()
    content = response.read()
    assert response.status == status
    assert body is None or content == body
    assert response.getheader("Content-Range") == told


@pytest.mark.parametrize("path", ["/", "/index.html", "/a%20b.egs", "/x/", "/../a%20b.egs"])
def test_requests_without_the_address_fail(page, path):
    assert answer(page, path)[0] == 404


def test_trial_encodings_need_the_address_too(page, tmp_path):
    path = tmp_path / "1.egs"
    path.write_bytes(b"trial")
    tried = SimpleNamespace(path=path, name="#1", number=1)
    page.inspector = SimpleNamespace(trial={1: tried}.get)
    assert answer(page, f"{page.root}trial-1.egs") == (200, b"trial")
    for asked in ("trial-1.egs", "?b=1", "/trial-1.egs", "/?b=1"):
        assert answer(page, asked)[0] == 404


def test_nothing_else_is_served(page):
    root = urlsplit(page.url).path
    for path in ("index.html", "b.egs", "../", "%2e%2e/", "a%20b.egs/"):
        assert answer(page, root + path)[0] == 404
    for path in ("", "inspect"):
        assert answer(page, root + path, "POST")[0] == 404


def test_requests_from_other_hosts_are_refused(page):
    root = urlsplit(page.url).path
    for host in ("example.org", f"example.org:{page.server_port}", ""):
        assert answer(page, root, host=host)[0] == 404


def test_addresses_differ():
    pages = [Page({"index.html": b""}) for _ in range(2)]
    for page in pages:
        page.server_close()
    assert len({urlsplit(page.url).path for page in pages}) == 2


def test_silent_connections_are_limited_and_time_out(page, monkeypatch):
    monkeypatch.setattr(served._Handler, "timeout", 0.2)
    before = threading.active_count()
    silent = [
        socket.create_connection((page.server_address[0], page.server_port)) for _ in range(90)
    ]
    for connection in silent:  # closed at once if too many, else after a timeout
        connection.settimeout(60)
        with suppress(ConnectionError):
            assert connection.recv(1) == b""
        connection.close()
        assert threading.active_count() - before <= served._CONNECTIONS
    monkeypatch.undo()
    while threading.active_count() > before:  # their places are free when their threads end
        time.sleep(0.01)
    assert answer(page, urlsplit(page.url).path) == (200, b"page")


def test_the_address_is_not_in_the_browsers_arguments(page, monkeypatch, tmp_path, capsys):
    told: list[tuple[str, int, str]] = []

    def opening(address: str) -> None:
        path = Path(url2pathname(urlsplit(address).path))
        told.append((address, path.stat().st_mode & 0o777, path.read_text()))

    monkeypatch.delenv("SSH_CONNECTION", raising=False)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(served.webbrowser, "open", opening)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(page, "serve_forever", lambda: None)
    page.run()
    [(address, mode, text)] = told
    secret = urlsplit(page.url).path
    assert address.startswith("file:///")
    assert secret not in address
    assert mode == 0o600
    assert f'content="0; url={page.url}"' in text
    assert list(tmp_path.iterdir()) == []
    assert page.url in capsys.readouterr().out


def test_a_browser_is_opened_without_a_home(page, monkeypatch, tmp_path):
    told: list[str] = []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(served.os.path, "expanduser", lambda path: path)
    monkeypatch.delenv("SSH_CONNECTION", raising=False)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(served.webbrowser, "open", told.append)
    monkeypatch.setattr(page, "serve_forever", lambda: None)
    page.run()
    assert told[0].startswith("file:///")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.thorough
@in_browser
def test_a_browser_shows_it(scene):
    page = serve([scene], Request(cameras="auto", view=3))
    threading.Thread(target=page.serve_forever, daemon=True).start()
    [told] = open_pages(
        Job(page.url, [("drawn",), ("value", "document.getElementById('views').value")])
    )
    page.shutdown()
    page.server_close()
    assert (told.state, told.status, told.errors) == ("ready", "", [])
    asked = [url for url in told.requests if not url.startswith(("blob:", "data:"))]
    root = page.url.partition("#")[0]
    assert asked == [root, f"{root}a.egs"]
    assert told.values[1] == "3"


def test_the_page_orbits_about_the_requested_axis(scene):
    page = serve([scene], Request(cameras="auto", up="-x"))
    page.server_close()
    [text] = [data for path, data in page.contents.items() if path.endswith("/")]
    assert b'"up": "-x"' in text


def test_a_page_begins_with_the_requested_view_and_frame(tmp_path):
    coded(tmp_path / "clip.egs", moving(200, 3))
    page = serve([tmp_path / "clip.egs"], Request(cameras="auto", view=1, frame=2))
    page.server_close()
    assert page.url.endswith("/#view=1&frame=2")
    with pytest.raises(GsCodecError, match="frame 3: expected 0 to 2"):
        serve([tmp_path / "clip.egs"], Request(cameras="auto", frame=3))


def test_what_a_page_cannot_begin_with_is_refused_before_it_is_made(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(served, "page_of", None)
    camera = {"img_name": "a", "position": [0, 0, -5], "rotation": np.eye(3).tolist(), **LENS}
    (tmp_path / "cameras.json").write_text(json.dumps([camera]))
    coded(tmp_path / "clip.egs", moving(200, 3))
    for source, wanted, message in (
        (scene, {"view": 24}, "view 24: expected 0 to 23"),
        (scene, {"view": 1, "cameras": tmp_path / "cameras.json"}, "view 1: expected 0 to 0"),
        (scene, {"frame": 0}, "frame: expected a sequence"),
        (tmp_path / "clip.egs", {"frame": 3}, "frame 3: expected 0 to 2"),
    ):
        with pytest.raises(GsCodecError, match=message):
            serve([source], Request(**{"cameras": "auto"} | wanted))


def test_the_server_runs_until_interrupted(scene):
    unset = ("DISPLAY", "WAYLAND_DISPLAY", "PYTHONUNBUFFERED")
    environment = {k: v for k, v in os.environ.items() if k not in unset}
    process = subprocess.Popen(
        [sys.executable, "-c", "from viewer.main import main; main()", scene, "--web"],
        env=environment | {"PYTHONPATH": str(ROOT), "SSH_CONNECTION": "a 1 b 2"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    url = process.stdout.readline().split()[0]
    elsewhere = process.stdout.readline()
    parts = urlsplit(url)
    assert f"ssh -L {parts.port}:127.0.0.1:{parts.port} HOST" in elsewhere
    connection = http.client.HTTPConnection("127.0.0.1", parts.port or 0, timeout=60)
    connection.request("GET", parts.path)
    assert b"scene-list" in connection.getresponse().read()
    connection.close()
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (0, "", "")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["a.egs", "--web", "--mode", "wipe"], "--mode: has no effect on --web"),
        (["a.egs", "--web", "--screenshot", "a.png"], "--screenshot: has no effect on --web"),
        (["a.egs", "--web", "--layers", "error"], "layers error: expected two scenes"),
        (["a.egs", "--web", "--layers", "pruned"], "layers pruned: needs a report"),
        (["a.egs", "--web", "--gt-images", "."], "gt-images: need cameras from a file"),
        (["a.egs", "--web", "--watch"], "--watch: has no effect on --web"),
        (["a.egs", "--web", "--overwrite"], "--overwrite: has no effect on --web"),
        (["a.egs", "--web", "--up", "w"], "up 'w': expected -y, y, -z"),
        (["--web"], "web: needs a scene"),
        (["a.egs", "--port", "8000"], "port: needs --web"),
        (["a.egs", "--web", "--port", "0"], "port 0: expected 1 to 65535"),
        (["none.egs", "--web"], "none.egs: No such file"),
        (["a.egs", "--web", "--max-bytes", "99"], "the limit is 99"),
        (["a.egs", "--web", "--view", "-1"], "view -1: expected 0 to "),
        (["a.egs", "--web", "--view", "999"], "view 999: expected 0 to "),
        (["a.egs", "--web", "--frame", "0"], "frame: expected a sequence"),
    ],
)
def test_refusals_are_one_line(scene, tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    shutil.copy(scene, "a.egs")
    monkeypatch.setattr("sys.argv", ["gs-viewer", *arguments])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_a_port_in_use_is_one_line(scene, monkeypatch, capsys):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        monkeypatch.setattr("sys.argv", ["gs-viewer", str(scene), "--web", "--port", port])
        with pytest.raises(SystemExit) as stop:
            main()
    assert stop.value.code == 2
    assert f"port {port}: Address already in use" in capsys.readouterr().err

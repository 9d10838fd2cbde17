"""Pages with levels of detail on web servers as people run them: http-server and nginx."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from level_files import city
from web_pages import HERE, NODE, Job, in_browser, open_pages

from gs_codec.cameras.camera import Camera, facing
from gs_codec.cameras.camera_files import write_cameras
from gs_codec.files.sharing import share

SERVER = HERE / "node_modules" / "http-server" / "bin" / "http-server"

#: It may be where only administrators look.
NGINX = shutil.which("nginx") or shutil.which("nginx", path="/usr/sbin:/usr/local/sbin")

#: As Debian configures it, but for one folder, and without files elsewhere.
SETTINGS = """daemon off; pid {at}/pid; error_log stderr;
events {{ }}
http {{
    types {{ text/html html; text/javascript js; image/jpeg jpg; }}
    default_type application/octet-stream;
    access_log off; sendfile on; gzip on;
    client_body_temp_path {at}/body; proxy_temp_path {at}/proxy;
    fastcgi_temp_path {at}/fastcgi; uwsgi_temp_path {at}/uwsgi; scgi_temp_path {at}/scgi;
    server {{ listen 127.0.0.1:{port}; root {folder}; }}
}}
"""


@contextmanager
def running(kind: str, folder: Path, at: Path) -> Iterator[str]:
    """Address of a server of a folder."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    if kind == "nginx":
        at.mkdir()
        text = SETTINGS.format(at=at, port=port, folder=folder)
        # Started by root, its workers would belong to a user who cannot read the tests' folders.
        (at / "conf").write_text(("user root; " if os.geteuid() == 0 else "") + text)
        command = [str(NGINX), "-e", "stderr", "-p", str(at), "-c", str(at / "conf")]
    else:
        command = [str(NODE), str(SERVER), str(folder), "-a", "127.0.0.1", "-p", str(port), "-s"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE)
    try:
        for _ in range(600):
            with socket.socket() as tried:
                if tried.connect_ex(("127.0.0.1", port)) == 0:
                    break
            assert process.poll() is None, process.stderr and process.stderr.read()
            time.sleep(0.1)
        yield f"http://127.0.0.1:{port}/"
    finally:
        process.terminate()
        process.communicate(timeout=60)


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """A folder with a scene with levels, seen from near, and one without."""
    folder = tmp_path_factory.mktemp("servers")
    (folder / "city.egs").write_bytes(city(2))
    turn = facing(np.array([0.0, 0.2, 1.0]), np.array([0.0, -1.0, 0.0]))
    near = Camera("near", 300, 200, 250.0, 250.0, 150.0, 100.0, turn, np.array([0.0, -1.0, -2.0]))
    write_cameras(folder / "cameras.json", [near])
    share([folder / "city.egs"], folder / "site", folder / "cameras.json")
    return folder / "site"


#: Status and size of each response with bytes of the scene.
FETCHED = """performance.getEntriesByType('resource').filter(({ name }) => name.endsWith('.egs'))
    .map(({ responseStatus, encodedBodySize }) => [responseStatus, encodedBodySize])"""

SERVERS = [
    pytest.param(
        "http-server",
        marks=pytest.mark.skipif(not SERVER.is_file(), reason="needs npm ci in tests/web"),
    ),
    pytest.param("nginx", marks=pytest.mark.skipif(NGINX is None, reason="needs nginx")),
]


@in_browser
@pytest.mark.parametrize("kind", SERVERS)
def test_a_page_fetches_what_a_view_needs(site, tmp_path, kind):
    with running(kind, site, tmp_path / kind) as url:
        job = Job(url, [("until", "document.body.dataset.state === 'ready'"), ("value", FETCHED)])
        [told] = open_pages(job)
    assert (told.state, told.status, told.errors) == ("ready", "", [])
    fetched = told.values[-1]
    assert len(fetched) > 3
    assert {status for status, _ in fetched} == {206}
    assert sum(size for _, size in fetched) < 0.8 * (site / "city.egs").stat().st_size

"""Web servers: secrets of URLs are never printed, and hostile servers are abandoned quickly."""

from __future__ import annotations

import base64
import logging
import os
import random
import socket
import string
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote, quote_plus, urlsplit

import pytest
from scenes import random_scene

from gs_codec.batch import remote
from gs_codec.batch.local import Location
from gs_codec.batch.remote import storage_of
from gs_codec.batch.run import Batch, run_batch
from gs_codec.batch.scene_tasks import Options
from gs_codec.config import Config
from gs_codec.errors import InvalidInput
from gs_codec.formats.ply.writer import write_ply
from gs_codec.runtime.redaction import redact_process, redacted, without_secrets

pytestmark = pytest.mark.slow

LIMIT = 600

PASSWORD, SIGNATURE, TOKEN = "pAss/w rd!", "sIg+n/a==tUre", "tOkEnOfRedirect"

#: Strings that would reveal a secret, in various encodings.
TRACES = (
    *("pAss", "w%20rd", "sIg", "tUre", TOKEN, "cDn"),
    base64.b64encode(f"user:{PASSWORD}".encode()).decode(),
)


class Handler(BaseHTTPRequestHandler):
    """A password-protected folder with links to scenes elsewhere."""

    def do_GET(self) -> None:
        path = urlsplit(self.path).path
        content = self.server.files.get(path)  # type: ignore[attr-defined]
        if path == "/moved/":
            place = f"{self.server.url}/gone?tOkEn=x&token={TOKEN}"  # type: ignore[attr-defined]
            self.answer(302, b"", Location=place.replace("http://", "http://user:cDn@"))
        elif path in ("/endless.ply", "/more.ply"):
            said = (
                {"Content-Length": "100"} if path == "/more.ply" and self.command == "HEAD" else {}
            )
            self.answer(200, None, **said)
        elif path == "/slow.ply" and self.command == "GET":
            time.sleep(1)
        elif path.endswith("loop/"):
            self.answer(200, b'<a href="a.ply">a</a> <a href="loop/">b</a> <a href="x.loop/">c</a>')
        elif path == "/in/" and "Authorization" not in self.headers:
            self.answer(401, f"{self.path} is not for you".encode())
        elif content is None:
            self.answer(500 if "gone" in path else 404, self.path.encode())
        else:
            self.answer(200, content, **self.server.headers)  # type: ignore[attr-defined]

    def do_HEAD(self) -> None:
        self.do_GET()

    def answer(self, status: int, content: bytes | None, **headers: str) -> None:
        """Send a response; without content, it never ends."""
        self.send_response(status, f"no {self.path}" if status == 500 else None)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("Content-Type", "text/html")
        if content is not None:
            self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        with suppress(ConnectionError):
            while self.command == "GET":
                self.wfile.write(bytes(10_000) if content is None else content)
                if content is not None:
                    break

    def log_message(self, *arguments: object) -> None:
        """Keep tests quiet."""


@pytest.fixture
def server(tmp_path) -> Iterator[ThreadingHTTPServer]:
    pytest.importorskip("aiohttp", reason="no client for the web")
    write_ply(tmp_path / "a.ply", random_scene(200, 0))
    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    scene = (tmp_path / "a.ply").read_bytes()
    links = b'<a href="a.ply">a</a> <a href="gone.ply">gone</a>'
    server.files = {"/in/": links, "/none/": b"", "/in/a.ply": scene, "/a%20b.ply": scene[:-1]}
    server.files["/slow.ply"] = b""
    server.headers = {}
    server.url = f"http://127.0.0.1:{server.server_port}"
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server
    server.shutdown()
    server.server_close()


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess:
    root = str(Path(__file__).parent.parent)
    return subprocess.run(
        [sys.executable, "-m", "gs_codec", "batch", *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": root},
        capture_output=True,
        text=True,
        check=False,
        timeout=LIMIT,
    )


def assert_no_secret(folder: Path, done: subprocess.CompletedProcess) -> None:
    report = folder / "out/report.jsonl"
    written = report.read_text() if report.exists() else ""
    for place, text in (("stdout", done.stdout), ("stderr", done.stderr), ("report", written)):
        assert [trace for trace in TRACES if trace in text] == [], f"{place}: {text}"
    assert "Traceback" not in done.stderr


SIGNED = "http://user:pAss%2Fw%20rd!@{host}/{name}?sig=sIg%2Bn%2fa%3D%3DtUre&b=1"


@pytest.mark.one_in(8)
@pytest.mark.parametrize(
    ("url", "status", "said"),
    [
        ("http://user:pAss%2Fw%20rd!@{host}/in/", 1, "http://{host}/in/gone.ply: No such file"),
        ("http://user:pAss%2Fw%20rd!@{host}/none/", 2, "http://{host}/none/: no scenes found"),
        ("http://user:pAss@{host}/none/*.ply", 2, "http://{host}/none/*.ply: no scenes found"),
        (SIGNED.replace("{name}", "a%20b.ply"), 1, "http://{host}/a%20b.ply: "),
        (SIGNED.replace("{name}", "missing.ply"), 2, "http://{host}/missing.ply: No such file"),
        (SIGNED.replace("{name}", "gone/*.ply"), 2, "http://{host}/gone/*.ply: 500, message='no /"),
        (SIGNED.replace("{name}", "moved/*.ply"), 2, "http://{host}/moved/*.ply: 500, message="),
        ("simplecache::" + SIGNED.replace("{name}", "gone/*.ply"), 2, "http://{host}/gone/*.ply: "),
        ("http://pAss:sIg/tUre@{host}/in/", 2, "http://{host}/in/: "),
        ("ftp://user:pAss/sIg@{host}/in", 2, "ftp://user@{host}/in: "),
        ("nonsense://user:pAss@{host}/in?sig=sIg", 2, "nonsense://user@{host}/in: Protocol"),
    ],
)
def test_secrets_of_a_source_are_never_printed(server, tmp_path, url, status, said):
    host = server.url.removeprefix("http://")
    done = run(tmp_path, url.replace("{host}", host), "out", "--jobs", "2", "--json")
    assert_no_secret(tmp_path, done)
    assert said.replace("{host}", host) in done.stderr
    assert done.returncode == status, done.stderr


@pytest.mark.thorough
def test_dask_workers_print_no_secrets(server, tmp_path):
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    host = server.url.removeprefix("http://")
    done = run(tmp_path, f"http://user:pAss%2Fw%20rd!@{host}/in/", "out", "--dask", "local")
    assert_no_secret(tmp_path, done)
    assert "1 scene encoded, 1 failed" in done.stdout, done.stderr


@pytest.mark.parametrize("pattern", ["tree/", "tree/**/*.ply"])
def test_folders_of_a_server_are_read_completely(server, pattern):
    own = "".join(f'<a href="{name}">x</a>' for name in ("a.ply", "sub/", "./", "../", "?C=N"))
    server.files |= {"/tree/": own.encode(), "/tree/sub/": own.encode(), "/tree/sub/sub/": b""}
    url = f"{server.url}/{pattern}"
    assert [name for name, _ in storage_of(url).find()] == ["a.ply", "sub/a.ply"]


@pytest.mark.parametrize("pattern", ["loop/", "loop/**/*.ply"])
def test_endless_folders_of_a_server_are_abandoned(server, pattern):
    url = f"{server.url}/{pattern}"
    with pytest.raises(InvalidInput, match="loop/: 33 folders deep; links may"):
        storage_of(url).find()


@pytest.mark.parametrize("headers", [{}, {"Last-Modified": "Sun, 29 Nov 2026 15:00:00 GMT"}])
def test_files_of_a_server_without_times_are_compared_by_content(server, tmp_path, headers):
    server.headers = headers
    batch = Batch(f"{server.url}/in/a.ply", str(tmp_path / "out"), Options(Config()), resume=True)
    assert (run_batch(batch).done, run_batch(batch).skipped) == (1, 1)
    data = bytearray(server.files["/in/a.ply"])
    data[-4:] = b"\0\0\0\0"
    server.files["/in/a.ply"] = bytes(data)
    if headers:
        assert run_batch(batch).skipped == 1
        server.headers = {"Last-Modified": "Sun, 29 Nov 2026 16:00:00 GMT"}
    assert run_batch(batch).done == 1


def test_servers_that_refuse_or_do_not_answer_are_reported(server, tmp_path, monkeypatch):
    for name, text in (("gone.ply", "500, message='no /gone.ply'"), ("x.ply", "No such file or d")):
        with pytest.raises(InvalidInput, match=f"/{name}: {text}"):
            storage_of(f"{server.url}/{name}").find()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        with pytest.raises(InvalidInput, match=r"/a\.ply: Connect call failed"):
            storage_of(f"http://127.0.0.1:{free.getsockname()[1]}/a.ply").find()
    monkeypatch.setattr(remote, "_PATIENCE", 0.2)
    place = storage_of(f"{server.url}/slow.ply")
    assert place._fs.client_kwargs["timeout"].total is None  # a download may take hours
    ((_, file),) = place.find()
    with pytest.raises(InvalidInput, match=r"/slow\.ply: .*imeout"):
        place.fetch(file, tmp_path)


@pytest.mark.parametrize(("name", "most"), [("endless.ply", 9000), ("more.ply", 100)])
def test_endless_files_are_abandoned(server, tmp_path, monkeypatch, name, most):
    monkeypatch.setattr("shutil.disk_usage", lambda path: type("", (), {"free": 10_000}))
    place = storage_of(f"{server.url}/{name}")
    ((_, file),) = place.find()
    with pytest.raises(InvalidInput, match=f"/{name}: more than {most:,} bytes received"):
        place.fetch(file, tmp_path)


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("sftp://me:secret@host:22/a", "sftp://me@host:22/a"),
        ("sftp://me:se@cret@host/a@b", "sftp://me@host/a@b"),
        ("sftp://host:22/a@b?c=d", "sftp://host:22/a@b?c=d"),
        ("ftp://me:sec/ret@host/a", "ftp://me@host/a"),
        ("ftp://me:12@host/a", "ftp://me@host/a"),
        ("https://host/a.ply?signature=secret", "https://host/a.ply"),
        ("https://host/a.ply#token=secret", "https://host/a.ply"),
        ("HTTPS://secret@Host/a", "HTTPS://Host/a"),
        ("https://me%3Asecret@host/a", "https://host/a"),
        ("https://me:sec?ret@host/a", "https://host/a"),
        ("http://me:secret@[::1]:80/a?b", "http://[::1]:80/a"),
        ("s3://key:sec/ret@bucket/a?b", "s3://key@bucket/a?b"),
        ("az://box/a.ply?sv=1&sig=secret", "az://box/a.ply"),
        ("simplecache::https://host/a?s=a::b", "simplecache::https://host/a"),
        ("zip://*.ply::https://me:secret@host/a.zip?b", "zip://*.ply::https://host/a.zip"),
        ("zip://*.ply::/a/b.zip", "zip://*.ply::/a/b.zip"),
        ("s3://bucket/a?b", "s3://bucket/a?b"),
        ("/a/b:c@d?e=f", "/a/b:c@d?e=f"),
    ],
)
def test_display_names_of_urls(url, shown):
    assert without_secrets(url) == shown
    assert without_secrets(shown) == shown
    assert redacted(f"no '{url}', or so", url) == f"no '{shown}', or so"


@pytest.mark.parametrize(
    "text",
    [
        "url='https://host/a%20b.ply?sig=sIg%2Bn/a%3D%3DtUre'",
        "url='HTTPS://HOST/a b.ply?b=1&sig=sIg+n%2Fa==tUre'",
        "next=https%3A%2F%2Fhost%2Fa%3Fsig%3DsIg%252bn%252fa%253D%253DtUre",
        "sIg+n/a==tUre",
        "no user:pAss/w rd! known",
        "no pAss%2fw+rd! known",
        "no pAss%252Fw%2520rd%2521 known",
        f"{{'Authorization': 'Basic {TRACES[-1]}'}}",
        "see https://elsewhere/a?token='tOkEnOfRedirect'b (twice https://tOkEnOfRedirect@h).",
        "GET /a.ply?sig=tOkEnOfRedirect",
        "{'authorization': 'Bearer tOkEnOfRedirect'}",
    ],
)
def test_spellings_of_a_secret_are_hidden(text):
    found = redacted(text, SIGNED.format(host="host", name="a%20b.ply"))
    assert [trace for trace in TRACES if trace in found] == []


@pytest.mark.parametrize("seed", range(20))
def test_any_secret_is_hidden_in_any_spelling(seed):
    rng = random.Random(seed)
    signs = string.ascii_letters + string.digits + string.punctuation + " éß"
    ways = (str, quote, quote_plus, lambda text: quote(quote(text, safe=""), safe=""))
    for scheme in ("http", "sftp", "simplecache::https"):
        secret = "".join(rng.choices(signs, k=rng.randrange(8, 20)))
        query = "/a.ply?x=1&sig=" if "http" in scheme else ""
        for put in (quote_plus, lambda text: quote(text, safe="")):
            for url in (f"{scheme}://me:{put(secret)}@h/a", f"{scheme}://h{query}{put(secret)}"):
                found = [redacted(f"of {way(secret)} in '{url}'", url) for way in ways]
                shown = without_secrets(url)
                if "@" in url or query:
                    assert found == [f"of *** in '{shown}'"] * len(ways)


def test_hostile_text_is_redacted_quickly():
    url = SIGNED.format(host="host", name="a")
    for piece in ("a", "http://", "'", "\\", "%25", "::", "@", "?a=", "sIg"):
        assert isinstance(redacted(piece * 100_000, url), str)


def test_logs_and_library_output_contain_no_secrets(monkeypatch, capsys):
    url = SIGNED.format(host="host", name="a")
    assert str(Location(url, url)) == "Location('http://host/a', 'http://host/a')"
    handler = logging.StreamHandler(sys.stderr)
    monkeypatch.setattr(logging.root, "handlers", [handler])
    monkeypatch.setattr(logging, "lastResort", None)
    monkeypatch.setattr(sys, "excepthook", None)
    redact_process()
    try:
        raise RuntimeError(url)
    except RuntimeError as error:
        logging.getLogger("asyncio").exception("%s was never read", url)
        sys.excepthook(type(error), error, error.__traceback__)
    err = capsys.readouterr().err
    assert err.count("RuntimeError: http://host/a") == 2
    assert [trace for trace in TRACES if trace in err] == []

"""Batches from and to a real SSH server on this machine."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

import batch_work
import pytest
from scenes import random_scene

from gs_codec.batch.run import batch_mark
from gs_codec.files.encode_file import encode_file
from gs_codec.formats.ply.writer import write_ply

TESTS = Path(__file__).parent
LIMIT = 600

CONFIG = """
ListenAddress 127.0.0.1
HostKey {folder}/host_key
AuthorizedKeysFile {folder}/home/.ssh/id_ed25519.pub
PasswordAuthentication no
PermitRootLogin yes
PidFile none
StrictModes no
UsePAM no
Subsystem sftp internal-sftp
"""


class Server:
    """A server, and a home folder with an authorised key."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.home = folder, folder / "home"
        (self.home / ".ssh").mkdir(parents=True)
        for key in (folder / "host_key", self.home / ".ssh/id_ed25519"):
            command = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(key)]
            subprocess.run(command, check=True, stdin=subprocess.DEVNULL)
        (folder / "config").write_text(CONFIG.format(folder=folder))
        # Another process may take the port first.
        for _ in range(10):
            if self._listens():
                break
        else:
            pytest.fail((folder / "log").read_text())
        key = (folder / "host_key.pub").read_text()
        (self.home / ".ssh/known_hosts").write_text(f"[127.0.0.1]:{self.port} {key}")

    def _listens(self) -> bool:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        command = [shutil.which("sshd", path=PATH) or "", "-D", "-f", str(self.folder / "config")]
        with open(self.folder / "log", "wb") as log:
            self.process = subprocess.Popen([*command, "-e", "-p", str(self.port)], stderr=log)
        end = time.monotonic() + LIMIT
        while self.process.poll() is None and time.monotonic() < end:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", self.port)) == 0:
                    return True
            time.sleep(0.05)
        return False

    def url(self, path: Path | str) -> str:
        return f"sftp://127.0.0.1:{self.port}{path}"

    def run(self, *arguments: str, **environment: str) -> subprocess.CompletedProcess:
        """Run the command in the folder of the server."""
        done = self.start(*arguments, **environment)
        out, err = done.communicate(timeout=LIMIT)
        return subprocess.CompletedProcess(arguments, done.returncode, out, err)

    def start(self, *arguments: str, **environment: str) -> subprocess.Popen:
        return subprocess.Popen(
            [sys.executable, str(TESTS / "batch_work.py"), "batch", *arguments],
            cwd=self.folder,
            env=os.environ
            | {"PYTHONPATH": f"{TESTS.parent}{os.pathsep}{TESTS}", "HOME": str(self.home)}
            | environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )


#: Debian installs the server there, which is not on every user's PATH.
PATH = os.environ.get("PATH", "") + ":/usr/sbin:/usr/local/sbin"


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    if shutil.which("sshd", path=PATH) is None:
        pytest.skip("no sshd on this machine")
    pytest.importorskip("fsspec", reason="the extra 'cluster' is not installed")
    if os.geteuid() == 0:
        Path("/run/sshd").mkdir(mode=0o755, exist_ok=True)  # required by sshd
    server = Server(tmp_path_factory.mktemp("server"))
    for seed, name in enumerate(("a", "sub/b #1", "sub/c?")):
        path = server.folder / f"in/{name}.ply"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_ply(path, random_scene(300, seed, seed=seed))
    yield server
    server.process.terminate()
    server.process.wait()


def records(folder: Path) -> list[dict]:
    return [json.loads(line) for line in (folder / "report.jsonl").read_text().splitlines()]


@pytest.mark.thorough
def test_batch_from_server_to_server(server):
    source, target = server.url(server.folder / "in"), server.url(server.folder / "out")
    arguments = (f"{source}/**/*.ply", target, "--jobs", "2", "--resume")
    done = server.run(*arguments)
    assert done.returncode == 0, done.stderr
    one = server.folder / "one.egs"
    for name in ("a", "sub/b #1", "sub/c?"):
        encode_file(server.folder / f"in/{name}.ply", one, overwrite=True)
        assert (server.folder / f"out/{name}.egs").read_bytes() == one.read_bytes()
    # The report on remote scenes is local.
    found = sorted(record["input"] for record in records(server.folder))
    assert found == [f"{source}/{name}.ply" for name in ("a", "sub/b #1", "sub/c?")]
    again = server.run(*arguments, "--json")
    assert json.loads(again.stdout)["skipped"] == 3, again.stderr
    (server.folder / "out/a.egs").write_bytes(b"other")
    again = server.run(*arguments, "--json")
    assert (json.loads(again.stdout)["done"], again.returncode) == (1, 0)
    assert len(list((server.folder / "out").rglob("*.egs"))) == 3
    assert list((server.folder / "out").rglob(".*")) == []


@pytest.mark.thorough
def test_unwritable_output_is_an_error_of_its_scene(server):
    (server.folder / "half").mkdir()
    (server.folder / "half/sub").write_text("not a folder")
    report = str(server.folder / "half.jsonl")
    other = f".a.egs.{batch_mark('another report')}01234567"
    for name in (f".a.egs.{batch_mark(report)}01234567", other):
        (server.folder / "half" / name).write_text("half of a file")
    target = server.url(server.folder / "half")
    done = server.run("in", target, "--report", report)
    assert done.returncode == 1, done.stderr
    lines = (server.folder / "half.jsonl").read_text().splitlines()
    errors = {r["output"]: r["error"] for r in map(json.loads, lines) if r["error"]}
    assert errors.keys() == {f"{target}/sub/b #1.egs", f"{target}/sub/c?.egs"}
    for output, error in errors.items():
        assert error["text"].startswith(f"{output}: ")
        assert "\n" not in error["text"]
    assert sorted(path.name for path in (server.folder / "half").iterdir()) == [
        *(other, "a.egs", "sub")
    ]


@pytest.mark.thorough
def test_server_that_stops_is_an_error_of_each_scene_that_needs_it(server, tmp_path):
    """Its processes for open connections stop too."""
    own = Server(tmp_path)
    report = tmp_path / "report.jsonl"
    arguments = (str(server.folder / "in"), own.url(tmp_path / "out"), "--report", str(report))
    held = {"WORK": "waiting", "GO": str(tmp_path / "go"), "HELD": str(tmp_path / "held")}
    process = own.start(*arguments, "--jobs", "1", **held)
    end = time.monotonic() + LIMIT
    while not (tmp_path / "held").exists():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.02)
    own.process.terminate()
    own.process.wait()
    (tmp_path / "go").touch()
    _, err = process.communicate(timeout=LIMIT)
    assert process.returncode == 1, err
    assert batch_work.lines(report) == 3
    for record in map(json.loads, report.read_text().splitlines()):
        assert record["error"]["text"].startswith(own.url(tmp_path / "out"))


@pytest.mark.thorough
@pytest.mark.parametrize("chain", ["", "simplecache::"])
@pytest.mark.parametrize("known", ["", "[127.0.0.1]:{port} ssh-ed25519 {other}\n"])
def test_unknown_host_is_not_trusted(server, tmp_path, known, chain):
    shutil.copytree(server.home / ".ssh", tmp_path / ".ssh")
    other = (server.home / ".ssh/id_ed25519.pub").read_text().split()[1]
    known = known.format(port=server.port, other=other)
    (tmp_path / ".ssh/known_hosts").write_text(known)
    url = chain + server.url(server.folder / "in")
    done = server.run(url, str(tmp_path / "out"), HOME=str(tmp_path))
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"gs-codec: error: {url}: Host key is not trusted for host 127.0.0.1\n"


@pytest.mark.thorough
def test_missing_server_is_one_line(server, tmp_path):
    with socket.socket() as taken:  # a port without a listener
        taken.bind(("127.0.0.1", 0))
        url = f"sftp://me:secret@127.0.0.1:{taken.getsockname()[1]}/in"
        done = server.run(url, str(tmp_path / "out"))
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"gs-codec: error: {url.replace(':secret', '')}: ")
    assert len(done.stderr.splitlines()) == 1
    assert "secret" not in done.stderr

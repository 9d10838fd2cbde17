"""One scene on a cluster whose processes are killed at any moment: the same command resumes it."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from processes import PATIENT, finish, wait_for
from scenes import random_scene

from gs_codec.config import Config
from gs_codec.files.decode_file import decode_file
from gs_codec.files.encode_file import encode_file
from gs_codec.formats.ply.writer import write_ply

COUNT = 60_000

#: Timeout of a client whose scheduler is gone.
SOON = {"DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "10s"}


class Machines:
    """A scheduler, two workers, and their clients."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.running = folder, dict[str, subprocess.Popen]()
        self.logs = folder / "log"

    def start(self, name: str, *command: str) -> subprocess.Popen:
        """Start a Python module in a separate process group, replacing a previous one."""
        self.kill(name)
        with open(self.logs, "ab") as log:
            self.running[name] = subprocess.Popen(
                [sys.executable, "-m", *command],
                cwd=self.folder,
                env=os.environ | PATIENT | SOON | {"TMPDIR": str(self.folder)},
                stdout=subprocess.PIPE if name == "client" else log,
                stderr=subprocess.PIPE if name == "client" else log,
                text=True,
                start_new_session=True,
            )
        return self.running[name]

    def kill(self, name: str) -> None:
        """Kill a program with all its descendants, if it runs."""
        process = self.running.pop(name, None)
        if process is not None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()

    def complete(self) -> str:
        """Start what is not running; return the address of the scheduler."""
        file = self.folder / "scheduler.json"
        alive = "scheduler" in self.running and self.running["scheduler"].poll() is None
        if not alive:
            file.unlink(missing_ok=True)
            options = ("--host", "127.0.0.1", "--port", "0", "--no-dashboard")
            process = self.start(
                "scheduler", "dask", "scheduler", *options, "--scheduler-file", str(file)
            )
            wait_for(lambda: file.exists() and file.read_bytes().rstrip().endswith(b"}"), process)
        address = json.loads(file.read_text())["address"]
        for name in ("first", "second"):
            if not alive or name not in self.running or self.running[name].poll() is not None:
                options = ("--no-nanny", "--nthreads", "1", "--no-dashboard")
                self.start(name, "dask", "worker", address, *options)
        return address


@pytest.fixture
def machines(tmp_path):
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    folder = tmp_path / "machines"
    folder.mkdir()
    made = Machines(folder)
    yield made
    for name in list(made.running):
        made.kill(name)


@pytest.fixture(scope="module")
def wanted(tmp_path_factory) -> Path:
    """A folder with a scene, its `encode` result, and the `decode` result of that."""
    folder = tmp_path_factory.mktemp("whole")
    write_ply(folder / "scene.ply", random_scene(COUNT, 2, seed=8))
    encode_file(folder / "scene.ply", folder / "scene.egs", Config("m", block_size=1024))
    decode_file(folder / "scene.egs", folder / "decoded.ply")
    return folder


@pytest.mark.thorough
@pytest.mark.rounds(1)
def test_the_same_command_resumes_after_any_kill(tmp_path, machines, wanted, seed):
    rng = random.Random(seed)
    out = tmp_path / "out"
    out.mkdir()
    small = ("--max-memory", "345MB")  # tasks of some thousand Gaussians
    commands = [
        ("encode", str(wanted / "scene.ply"), str(out / "scene.egs"), "--block-size", "1024"),
        ("decode", str(wanted / "scene.egs"), str(out / "decoded.ply")),
    ]
    kills = ["client", "scheduler", "first", "second"]
    rng.shuffle(kills)
    for command in commands:
        target = Path(command[2])
        while not target.exists():
            address = machines.complete()
            client = machines.start("client", "gs_codec", *command, *small, "--dask", address)
            if kills:
                try:
                    client.wait(rng.uniform(2, 8))
                except subprocess.TimeoutExpired:
                    machines.kill(kills.pop())
            if "client" in machines.running:
                status, _, err = finish(machines.running.pop("client"))
                assert (status == 0) == target.exists(), err
                assert "Traceback" not in err
        assert target.read_bytes() == (wanted / target.name).read_bytes()
    assert sorted(path.name for path in out.iterdir()) == ["decoded.ply", "scene.egs"]

"""Batches with killed or interrupted processes, and on a cluster: nothing is lost."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import batch_work
import pytest
from batch_work import lines
from processes import LIMIT, PATIENT, finish, wait_for
from scenes import random_scene

from gs_codec.batch import run
from gs_codec.batch.run import Batch, run_batch
from gs_codec.batch.scene_tasks import Options
from gs_codec.config import Config
from gs_codec.errors import InvalidInput
from gs_codec.files.encode_file import encode_file
from gs_codec.formats.ply.writer import write_ply
from gs_codec.plan import Plan, Steps

pytestmark = pytest.mark.slow

TESTS = Path(__file__).parent

ASCII = b"ply\nformat ascii 1.0\nelement vertex %d\nproperty float x\nend_header\n1\n"

BROKEN = {
    "empty.ply": b"",
    "text.ply": b"not a scene\n",
    "header.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 9\n",
    "deep/short.ply": ASCII % 2,
    "deep/points.ply": ASCII % 1,
}


@pytest.fixture(scope="module")
def scenes(tmp_path_factory) -> tuple[Path, dict[str, bytes]]:
    """A folder of 16 scenes and 5 damaged files, and the results of `encode` for the scenes."""
    folder, wanted = tmp_path_factory.mktemp("batch"), {}
    source, output = folder / "in", folder / "one.egs"
    for index in range(16):
        name = f"{'deep/er/' if index % 3 else ''}scene {index}"
        path = source / f"{name}.ply"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_ply(path, random_scene(200 + 120 * index, index % 4, seed=index))
        encode_file(path, output, overwrite=True)
        wanted[f"{name}.egs"] = output.read_bytes()
    for name, content in BROKEN.items():
        (source / name).parent.mkdir(exist_ok=True)
        (source / name).write_bytes(content)
    return source, wanted


class Place:
    """Folders of the target and of temporary files, and the report."""

    def __init__(self, path: Path) -> None:
        self.target, self.report, self.temporary = path / "out", path / "report.jsonl", path / "tmp"
        self.held = path / "held"
        self.temporary.mkdir()

    def start(self, source: str | Path, *options: str, **environment: str) -> subprocess.Popen:
        """Start the command in a separate process group."""
        command = [sys.executable, str(TESTS / "batch_work.py"), "batch"]
        arguments = [str(source), str(self.target), "--report", str(self.report), *options]
        return subprocess.Popen(
            command + arguments,
            env=os.environ
            | {"PYTHONPATH": f"{TESTS.parent}{os.pathsep}{TESTS}", "TMPDIR": str(self.temporary)}
            | {"REPORT": str(self.report), "HELD": str(self.held)}
            | environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def outputs(self) -> dict[str, bytes]:
        """All files of the target, by name."""
        found = (path for path in self.target.rglob("*") if path.is_file())
        return {str(path.relative_to(self.target)): path.read_bytes() for path in found}

    def begun(self) -> list[str]:
        """Names of temporary files in the folders of the target."""
        return [path.name for path in self.target.rglob(".*")]

    def records(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.report.read_text().splitlines()]


@pytest.fixture
def place(tmp_path) -> Place:
    return Place(tmp_path)


def check_whole(place: Place, wanted: dict[str, bytes]) -> None:
    """All scenes are encoded exactly once; damaged files are failures."""
    assert place.outputs() == wanted
    records = place.records()
    done = [record["output"] for record in records if record["error"] is None]
    assert sorted(done) == sorted(str(place.target / name) for name in wanted)
    failed = {record["input"].rpartition("/")[2] for record in records if record["error"]}
    assert failed == {name.rpartition("/")[2] for name in BROKEN}
    assert list(place.temporary.iterdir()) == []


@pytest.mark.thorough
def test_batch_killed_twice_is_resumed(scenes, place):
    source, wanted = scenes
    pattern = f"{source}/**/*.ply"
    for hold in (4, 9):
        process = place.start(
            pattern, "--jobs", "2", "--resume", WORK="stuck_in_fsync", HOLD=str(hold)
        )
        wait_for(place.held.exists, process)
        os.kill(process.pid, signal.SIGKILL)
        # The pipes close when the workers have also ended.
        assert finish(process)[0] == -signal.SIGKILL
        place.held.unlink()
        assert lines(place.report) >= hold
        assert place.begun()
    with open(place.report, "ab") as file:
        file.write(b'{"source": "torn')
    status, out, err = finish(place.start(pattern, "--jobs", "2", "--resume"))
    assert status == 1, err
    assert "5 failed" in out
    check_whole(place, wanted)


@pytest.mark.thorough
def test_interrupt_ends_all_processes_and_can_be_resumed(scenes, place):
    source = scenes[0] / "deep/er"
    process = place.start(source, "--jobs", "2", WORK="stuck_in_fsync", HOLD="3")
    wait_for(place.held.exists, process)
    assert place.begun()
    os.killpg(process.pid, signal.SIGINT)
    status, out, err = finish(process)
    assert (status, out) == (130, "")
    assert err.splitlines()[-1] == "gs-codec: interrupted"
    assert "Traceback" not in err
    assert place.begun() == []
    assert list(place.temporary.iterdir()) == []
    before = len(place.records())
    status, out, err = finish(place.start(source, "--jobs", "2", "--resume"))
    assert (status, len(place.outputs())) == (0, 10)
    assert f"{before} already done" in out


def test_scene_of_a_killed_process_is_retried_alone(tmp_path, monkeypatch):
    source = tmp_path / "in"
    source.mkdir()
    for seed, name in enumerate(("a", "once", "twice", "z")):
        write_ply(source / f"{name}.ply", random_scene(200, 0, seed=seed))
    monkeypatch.setattr(run, "record_scene", batch_work.killed)
    batch = Batch(str(source), str(tmp_path / "out"), Options(Config()), jobs=2)
    summary = run_batch(batch)
    assert (summary.done, summary.failed) == (3, 1)
    records = [json.loads(line) for line in Path(summary.report).read_text().splitlines()]
    assert [record["error"]["kind"] for record in records if record["error"]] == ["WorkerLost"]
    assert "was stopped by SIGKILL, twice" in records[-1]["error"]["text"]
    assert sorted(p.name for p in (tmp_path / "out").glob("*.egs")) == [
        "a.egs",
        "once.egs",
        "z.egs",
    ]


@pytest.mark.thorough
@pytest.mark.parametrize("plan", [None, Plan(Steps(), width=48, views=4)], ids=["plain", "views"])
def test_single_threaded_scenes_start_no_threads(tmp_path, monkeypatch, plan):
    for seed in range(2):
        write_ply(tmp_path / f"{seed}.ply", random_scene(1000, 1, seed=seed))
    monkeypatch.setattr(run, "record_scene", batch_work.alone)
    options = Options(Config(threads=1), plan)
    summary = run_batch(Batch(str(tmp_path), str(tmp_path / "out"), options, jobs=2))
    assert (summary.done, summary.failed) == (2, 0), Path(summary.report).read_text()


SMALL_DISK = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
from gs_codec.cli.main import main
main()
"""


@pytest.mark.thorough
def test_full_disk_is_an_error_of_the_scene_that_has_no_room(scenes, tmp_path):
    source = tmp_path / "in"
    source.mkdir()
    for name in ("scene 3", "scene 15"):  # a small one, and one larger than the disk
        (source / f"{name}.ply").write_bytes((scenes[0] / f"{name}.ply").read_bytes())
    done = subprocess.run(
        [sys.executable, "-c", SMALL_DISK, "batch", "in", "out", "--jobs", "1"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(TESTS.parent)},
        capture_output=True,
        text=True,
        check=False,
        timeout=LIMIT,
    )
    assert done.returncode == 1, done.stderr
    assert "scene 15.egs: File too large" in done.stderr
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["report.jsonl", "scene 3.egs"]


# On a cluster

WAIT = f"""
import sys
from distributed import Client
with Client(sys.argv[1], timeout={LIMIT}) as client:
    client.wait_for_workers(2, timeout={LIMIT})
"""


@pytest.fixture
def cluster(tmp_path, place):
    """A function that starts a scheduler and two workers, and returns their address and processes.

    The second worker holds its first task.
    """
    processes = []

    def start_one(name: str, *arguments: str, **environment: str) -> subprocess.Popen:
        with open(tmp_path / f"{name}.log", "wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", "dask", *arguments],
                cwd=tmp_path,
                env=os.environ
                | PATIENT
                | {"PYTHONPATH": f"{TESTS.parent}{os.pathsep}{TESTS}"}
                | environment,
                stdout=log,
                stderr=log,
            )
        processes.append(process)
        return process

    def start(**environment: str) -> tuple[str, subprocess.Popen]:
        file = tmp_path / "scheduler.json"
        options = ("--scheduler-file", str(file), "--no-dashboard")
        scheduler = start_one(
            "scheduler", "scheduler", "--host", "127.0.0.1", "--port", "0", *options
        )
        wait_for(lambda: file.exists() and file.stat().st_size, scheduler)
        wait_for(lambda: file.read_bytes().rstrip().endswith(b"}"), scheduler)
        address = json.loads(file.read_text())["address"]
        worker = ("worker", address, "--no-nanny", "--nthreads", "1", "--no-dashboard")
        worker += ("--local-directory", str(place.temporary))
        start_one("first", *worker)
        second = start_one("second", *worker, "--preload", "batch_work", **environment)
        waited = subprocess.run(
            [sys.executable, "-c", WAIT, address], env=os.environ | PATIENT, check=False
        )
        assert waited.returncode == 0
        return address, second

    yield start
    for process in processes:
        process.kill()
        process.wait()


@pytest.mark.thorough
def test_cluster_completes_although_a_worker_is_killed(scenes, place, cluster):
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    source, wanted = scenes
    address, second = cluster(HOLD="10", REPORT=str(place.report), HELD=str(place.held))
    process = place.start(f"{source}/**/*.ply", "--dask", address, **PATIENT)
    wait_for(place.held.exists, process)
    second.kill()
    second.wait()
    status, out, err = finish(process)
    assert status == 1, err
    assert "16 scenes encoded, 5 failed" in out
    assert place.outputs() == wanted
    assert len(place.records()) == len(wanted) + len(BROKEN)


@pytest.mark.thorough
def test_missing_scheduler_is_one_line(scenes, place):
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    environment = {"DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "1s"}
    process = place.start(scenes[0], "--dask", "tcp://127.0.0.1:1", **environment)
    status, out, err = finish(process)
    assert (status, out) == (2, "")
    assert err.splitlines()[-1].startswith("gs-codec: error: dask tcp://127.0.0.1:1: no scheduler")


#: Probe ports like another user: in plain text, and with a different key.
STRANGER = """
import socket, ssl, sys, tempfile
from pathlib import Path
from types import SimpleNamespace
from distributed import Security

def said(port, context=None):
    with socket.create_connection(("127.0.0.1", port)) as plain:
        connection = plain if context is None else context.wrap_socket(plain)
        connection.sendall(b"GET /info HTTP/1.0\\r\\n\\r\\n")
        return connection.recv(64)

own = Security.temporary()
context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
with tempfile.TemporaryDirectory() as folder:
    (Path(folder) / "own").write_text(own.tls_client_cert + own.tls_client_key)
    context.load_cert_chain(Path(folder) / "own")
for port in map(int, sys.argv[1:]):
    try:
        plain = said(port)
    except ConnectionError:
        plain = b""
    try:
        secret = said(port, context)
    except (ConnectionError, ssl.SSLError):
        secret = b""
    # An alert of TLS begins with 21.
    print("refused" if plain[:1] in (b"", b"\\x15") and not secret else f"{plain!r} {secret!r}")
"""


@pytest.mark.thorough
def test_local_cluster_rejects_other_clients(scenes, place):
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    psutil = pytest.importorskip("psutil", reason="comes with the extra 'cluster'")
    environment = PATIENT | {"DASK_DISTRIBUTED__WORKER__PRELOAD": "batch_work", "HOLD": "0"}
    process = place.start(scenes[0], "--dask", "local", "--jobs", "2", **environment)
    try:
        wait_for(place.held.exists, process)
        own = psutil.Process(process.pid)
        connections = [
            each for one in (own, *own.children(True)) for each in one.net_connections("inet")
        ]
        listening = [each.laddr for each in connections if each.status == psutil.CONN_LISTEN]
        # A scheduler, and two workers with their supervisors.
        assert [address.ip for address in listening] == ["127.0.0.1"] * 5
        ports = [str(address.port) for address in listening]
        knocked = subprocess.run(
            [sys.executable, "-c", STRANGER, *ports], capture_output=True, text=True, check=False
        )
        assert knocked.stdout.split("\n")[:-1] == ["refused"] * 5, knocked.stderr
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        finish(process)


@pytest.mark.thorough
def test_local_cluster_gives_the_same_files(scenes, place, tmp_path):
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    source, wanted = scenes
    names = [f"scene {index}" for index in (0, 3, 6)]
    (tmp_path / "in").mkdir()
    for name in names:
        (tmp_path / f"in/{name}.ply").write_bytes((source / f"{name}.ply").read_bytes())
    (tmp_path / "in/broken.ply").write_bytes(BROKEN["text.ply"])
    status, out, err = finish(place.start(tmp_path / "in", "--dask", "local", **PATIENT))
    assert status == 1, err
    assert "3 scenes encoded, 1 failed" in out
    assert place.outputs() == {f"{name}.egs": wanted[f"{name}.egs"] for name in names}
    assert list(place.temporary.iterdir()) == []


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError("Stream is closed"), "tls://a:1: the worker ended or is unreachable"),
        (ModuleNotFoundError("No module named 'gs_codec'"), "no gs_codec (No module named"),
        (RuntimeError("other"), "tls://a:1: the worker failed (other)"),
        (("0.1", "host", 1), "tls://a:1: gs_codec 0.1, expected gs_codec"),
    ],
    ids=["killed", "missing", "failed", "version"],
)
def test_loss_of_a_worker_is_reported(error, said):
    client = pytest.importorskip("gs_codec.workers.dask", exc_type=ImportError)
    answers = SimpleNamespace(run=lambda *a, **b: {"tls://a:1": error})
    with pytest.raises(InvalidInput) as caught:
        client.threads_of_workers(answers)
    assert said in str(caught.value)

"""After a kill, interrupt or full disk: the old file remains, or the new file is complete."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import random_scene

from gs_codec import __main__ as entry
from gs_codec.cli import main as cli
from gs_codec.config import Config
from gs_codec.files.encode_file import encode_file
from gs_codec.files.writing import write_scene
from gs_codec.formats.ply.writer import write_ply
from gs_codec.runtime import atomic
from gs_codec.runtime.atomic import atomic_writer

ROOT = Path(__file__).parents[1]


@pytest.fixture
def folder(tmp_path) -> Path:
    """A folder with a scene, as PLY and encoded."""
    inside = tmp_path / "files"
    inside.mkdir()
    write_ply(inside / "scene.ply", random_scene(200, 1, seed=70))
    encode_file(inside / "scene.ply", inside / "scene.egs", Config("paper-m"))
    return inside


def in_child(*arguments: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess:
    """Run Python in a separate process that can import gs_codec."""
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd,
        env=os.environ | {"PYTHONPATH": str(ROOT)} | environment,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.thorough
@pytest.mark.skipif(not hasattr(os, "O_TMPFILE"), reason="files without a name are Linux's")
@pytest.mark.parametrize("existing", [False, True], ids=["new", "existing"])
@pytest.mark.parametrize(
    "command",
    ["encode scene.ply out.egs", "decode scene.egs out.ply", "convert scene.egs out.splat"],
)
def test_killed_at_any_moment_leaves_the_old_file_or_the_new_one(
    folder, command, existing, pytestconfig
):
    """Nothing else is left, except for one moment when a file is replaced."""
    target = command.split()[-1]
    if existing:
        (folder / target).write_bytes(b"precious")
    rounds = pytestconfig.getoption("rounds")
    script = str(ROOT / "tests" / "crash_trials.py")
    options = [str(folder), str(rounds), str(8 * rounds), str(4 * rounds)]
    done = in_child(script, *options, *command.split(), cwd=folder)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert len(found["left"]) > 12 * rounds
    new, hidden = found["whole"].pop(target), 0
    states = set()
    for left in found["left"]:
        states.add(left.pop(target, None))
        copies = [left.pop(name) for name in list(left) if name.startswith(f".{target}.")]
        hidden += len(copies)
        assert set(copies) <= {new}
        assert left == {k: v for k, v in found["whole"].items() if not k.startswith(".")}
    old = hashlib.sha256(b"precious").hexdigest() if existing else None
    assert old in states
    assert states <= {old, new}
    assert hidden <= 2 * existing * rounds


@pytest.mark.parametrize("nameless", [True, False])
@pytest.mark.parametrize("existing", [True, False])
def test_files_are_written_with_and_without_names(tmp_path, monkeypatch, nameless, existing):
    if not nameless:
        monkeypatch.delattr(os, "O_TMPFILE", raising=False)
    target = tmp_path / "out"
    if existing:
        target.write_bytes(b"old")
    with atomic_writer(target) as file:
        file.write(b"new")
        assert target.exists() == existing
    assert target.read_bytes() == b"new"

    def interrupted() -> None:
        with atomic_writer(target) as file:
            file.write(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert target.read_bytes() == b"new"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.skipif(sys.platform == "win32", reason="no such permissions")
@pytest.mark.parametrize("nameless", [True, False])
def test_permissions_of_a_replaced_file_remain(tmp_path, monkeypatch, nameless):
    if not nameless:
        monkeypatch.delattr(os, "O_TMPFILE", raising=False)
    before = os.umask(0o022)
    try:
        for mode in (0o644, 0o600):  # of a new file, then as the user changed it
            with atomic_writer(tmp_path / "out") as file:
                file.write(b"data")
            assert (tmp_path / "out").stat().st_mode & 0o777 == mode
            (tmp_path / "out").chmod(0o600)
    finally:
        os.umask(before)


def test_a_link_is_replaced_and_not_followed(tmp_path):
    (tmp_path / "old").write_bytes(b"old")
    for name, pointed in (("link", "old"), ("broken", "nowhere")):
        (tmp_path / name).symlink_to(pointed)
        with atomic_writer(tmp_path / name) as file:
            file.write(b"new")
        assert (tmp_path / name).read_bytes() == b"new"
        assert not (tmp_path / name).is_symlink()
    assert (tmp_path / "old").read_bytes() == b"old"


def test_folders_that_cannot_be_synced_do_not_matter(tmp_path, monkeypatch):
    synced: list[bool] = []
    original = os.fsync

    def fsync(descriptor: int) -> None:
        synced.append(os.path.isdir(f"/proc/self/fd/{descriptor}"))
        if synced[-1]:
            raise OSError(22, "Invalid argument")
        original(descriptor)

    monkeypatch.setattr(atomic.os, "fsync", fsync)
    with atomic_writer(tmp_path / "out") as file:
        file.write(b"new")
    assert (tmp_path / "out").read_bytes() == b"new"
    assert synced == [False, True]


@pytest.fixture
def small_disk(tmp_path) -> Iterator[Path]:
    """A disk with 8 kB free."""
    disk = tmp_path / "disk"
    disk.mkdir()
    options = ["-t", "tmpfs", "-o", "size=8k", "none", str(disk)]
    if not shutil.which("mount") or os.geteuid() != 0:
        pytest.skip("only root mounts a disk of its own")
    if subprocess.run(["mount", *options], capture_output=True, check=False).returncode:
        pytest.skip("this machine mounts no disk")
    yield disk
    subprocess.run(["umount", "--lazy", str(disk)], check=True)


#: Commands that write, and their outputs; `{}` is a folder.
WRITING = {
    "encode": "encode scene.ply {}/out.egs -p lossless",
    "decode": "decode scene.egs {}/out.ply",
    "convert": "convert scene.egs {}/out.splat",
    "prepare": "prepare scene.ply {}/out.ply --prune-geometry 0.01 --width 30 --views 2",
    "prepare --report": "prepare scene.ply out.ply --prune-importance 1 --width 30"
    " --views 2 --report {} --overwrite",
    "compare --images": "compare scene.ply scene.egs --cameras auto --width 100 --images {}"
    " --overwrite",
    "render": "render scene.ply --cameras auto --width 100 --out {} --overwrite",
}


def refused(command: str, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch) -> str:
    """Run a command that must fail; return its one line."""
    monkeypatch.setattr(sys, "argv", ["gs-codec", *command.split()])
    capsys.readouterr()
    with pytest.raises(SystemExit) as stop:
        cli.main()
    error = capsys.readouterr().err
    assert stop.value.code == 2
    assert error.startswith("gs-codec: error: ")
    assert error.count("\n") == 1
    return error


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", WRITING)
def test_a_full_disk_is_one_line(folder, small_disk, name, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    (small_disk / "full").write_bytes(bytes(8 << 10))
    before = sorted(path.name for path in small_disk.iterdir())
    line = refused(WRITING[name].format(small_disk), capsys, monkeypatch)
    assert str(small_disk) in line
    assert "No space left on device" in line
    assert sorted(path.name for path in small_disk.iterdir()) == before


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", WRITING)
def test_a_folder_that_is_a_file_is_one_line(folder, name, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    Path("taken").write_bytes(b"")
    line = refused(WRITING[name].format("taken"), capsys, monkeypatch)
    assert "taken" in line


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", WRITING)
def test_a_folder_without_permission_is_one_line(folder, name, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    allowed = os.access

    def access(path: str | Path, mode: int, **named: bool) -> bool:
        return allowed(path, mode) and not (Path(path).name == "locked" and mode & os.W_OK)

    # Like a user other than root.
    monkeypatch.setattr(os, "access", access)
    Path("locked").mkdir()
    line = refused(WRITING[name].format("locked"), capsys, monkeypatch)
    assert "no permission to write in 'locked'" in line or "'locked' is not writable" in line


@pytest.mark.parametrize(
    "command",
    [
        "encode scene.ply out.egs",
        "encode scene.ply out.egs --max-memory 1GB",
        "convert scene.ply out.spz",
        "decode scene.egs out.ply",
        "convert scene.egs out.ply --max-memory 1GB",
        "convert scene.splat out.ply",
    ],
)
@pytest.mark.parametrize("reads", [1, 2])
def test_a_file_that_is_truncated_while_it_is_read_is_one_line(
    folder, command, reads, capsys, monkeypatch
):
    """A memory-mapped file would end the process with SIGBUS."""
    monkeypatch.chdir(folder)
    if "splat" in command:
        write_scene("scene.splat", random_scene(200, 0, seed=70), Config())
    source, size = command.split()[1], 100 * reads
    done: list[int] = []

    def truncating(*arguments: Any) -> int:
        done.append(reading(*arguments))
        if len(done) == reads:
            os.truncate(source, size)
        return done[-1]

    reading = os.preadv
    monkeypatch.setattr(os, "preadv", truncating)
    line = refused(command, capsys, monkeypatch)
    said = (
        f"truncated while it was read: {size} bytes, expected",
        "was changed while it was read",
        "not a readable PLY file",  # opened again by plyfile
    )
    assert any(f"{source}: {each}" in line for each in said)
    assert line.count(source) == 1
    assert not list(Path().glob("out.*"))


def test_closed_output_pipe_is_one_line(folder):
    if not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full on this system")
    done = subprocess.run(
        f"{sys.executable} -m gs_codec inspect scene.egs > /dev/full",
        shell=True,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.startswith("gs-codec: error: ")
    assert done.stderr.count("\n") == 1
    assert "No space left on device" in done.stderr


INTERRUPTED = """
import builtins, os, signal, sys
original = builtins.__import__
def interrupt(name, *arguments, **named):
    if name == {module!r}:
        builtins.__import__ = original
        os.kill(os.getpid(), signal.SIGINT)
    return original(name, *arguments, **named)
builtins.__import__ = interrupt
sys.argv = {arguments!r}
from {package}.__main__ import main
main()
"""


@pytest.mark.parametrize(
    ("program", "module"),
    [
        *(("gs-codec", name) for name in ("typer", "gs_codec.files.encode_file", "numba")),
        *(("gs-viewer", name) for name in ("typer", "gs_codec.cli.output", "numba")),
    ],
)
def test_interrupt_while_modules_are_imported_is_one_line(folder, program, module):
    package, *arguments = {
        "gs-codec": ("gs_codec", program, "encode", "scene.ply", "out.egs"),
        "gs-viewer": ("viewer", program, "scene.ply", "--screenshot", "out.png"),
    }[program]
    code = INTERRUPTED.format(module=module, package=package, arguments=arguments)
    done = in_child("-c", code, cwd=folder)
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == f"{program}: interrupted\n"
    assert not list(folder.glob("out.*"))


@pytest.mark.parametrize("package", ["gs_codec", "viewer"])
def test_little_is_loaded_before_interrupts_are_caught(package):
    code = f"import sys as s; old = {{*s.modules}}; import {package}.__main__"
    code += "; print(*{*s.modules} - old)"
    loaded = in_child("-c", code, cwd=ROOT).stdout.split()
    assert f"{package}.__main__" in loaded
    quick = {"gs_codec", "viewer", "gc", "importlib", "warnings", "_warnings", "__future__"}
    assert {name.partition(".")[0] for name in loaded} <= quick
    assert len(loaded) < 16


@pytest.mark.parametrize("cause", [KeyboardInterrupt, ValueError])
def test_an_error_that_an_interrupt_caused_is_one_line(cause, monkeypatch, capsys):
    def load(_: str) -> None:
        raise ImportError("initialization failed") from cause()

    monkeypatch.setattr(entry, "import_module", load)
    with pytest.raises(SystemExit if cause is KeyboardInterrupt else ImportError) as stop:
        entry.start("gs-viewer", "viewer.main")
    assert capsys.readouterr().err == "gs-viewer: interrupted\n" * (cause is KeyboardInterrupt)
    assert getattr(stop.value, "code", 130) == 130


def test_the_console_script_is_the_module():
    project = (ROOT / "pyproject.toml").read_text()
    assert 'gs-codec = "gs_codec.__main__:main"' in project
    assert 'gs-viewer = "viewer.__main__:main"' in project


CACHE = """
import os, sys
from pathlib import Path
import numba.core.caching as caching
fail = {fail!r}
def refuse(*arguments, **named):
    raise OSError(28, "No space left on device")
if fail == "save":
    caching.IndexDataCacheFile.save = refuse
elif fail == "load":
    caching.IndexDataCacheFile.load = lambda *a: (_ for _ in ()).throw(EOFError("cut short"))
else:
    from gs_codec.runtime import kernel_cache
    kernel_cache._is_private = lambda folder: False
import numpy as np
from gs_codec.runtime.kernels import kernel
from gs_codec.coding.quantise import fit_range
print(fit_range(np.array([1, 3], np.float32), 2).step)
"""


@pytest.mark.thorough
@pytest.mark.parametrize("fail", ["save", "load", "no folder"])
def test_kernels_work_without_their_cache(tmp_path, fail):
    cache = tmp_path / "cache"
    cache.mkdir()
    script = CACHE.format(fail=fail)
    place = {"NUMBA_CACHE_DIR": "" if fail == "no folder" else str(cache)}
    done = in_child("-c", script, cwd=tmp_path, **place)
    # The notice comes after some seconds, which a slow machine takes.
    told = [line for line in done.stderr.splitlines() if not line.startswith("compiling kernels")]
    assert not told
    assert done.stdout.split()[:1] == ["0.6666666666666666"]
    assert np.all([not list(path.glob("*.nbc")) for path in cache.iterdir()]) or fail == "load"

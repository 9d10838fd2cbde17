"""Kernels compiled as by `make boundscheck`."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numba
import numpy as np
import pytest

from gs_codec.runtime import kernel_cache
from gs_codec.runtime.kernels import kernel

ROOT = Path(__file__).parents[1]

BEYOND = """
import numpy as np
from gs_codec.runtime.kernels import inlined, kernel
@inlined
def read(values, i):
    return values[i]
@kernel
def beyond(values, i):
    return read(values, i)
print(beyond(np.zeros(3), 2))
try:
    beyond(np.zeros(3), 3)
except IndexError:
    print("IndexError")
"""


@pytest.mark.thorough
def test_bounds_are_checked_on_request(tmp_path):
    script = tmp_path / "beyond.py"
    script.write_text(BEYOND)
    environment = {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    done = subprocess.run(
        [sys.executable, str(script)],
        env=os.environ | {"PYTHONPATH": str(ROOT)} | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stderr == ""
    assert done.stdout == "0.0\nIndexError\n"


STARTED = """
import sys
import numba
import numpy as np
from gs_codec.runtime.kernels import inlined, kernel
@inlined
def square(value):
    return value * value
@kernel
def squares(values):
    total = np.zeros(1, values.dtype)
    for value in values:
        total[0] += square(value)
    return total
print(squares(np.arange(4.0)), squares.stats.cache_hits, "scipy.linalg" in sys.modules)
print(squares(np.arange(4)), numba.njit(lambda a, b: a @ b)(np.eye(2), np.ones(2)))
"""


def _started(folder):
    """The output of `STARTED`, run in a new process that keeps kernels in a folder."""
    script = folder / "started.py"
    if not script.exists():  # its time is part of the key of kernels
        script.write_text(STARTED)
    done = subprocess.run(
        [sys.executable, str(script)],
        env=os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(folder / "cache")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stderr == ""
    return done.stdout


@pytest.mark.thorough
def test_cached_kernels_start_without_the_compiler(tmp_path):
    compiled, loaded = (_started(tmp_path).splitlines() for _ in range(2))
    assert compiled[0].startswith("[14.] Counter()")
    assert loaded[0].startswith("[14.] Counter({")
    assert loaded[0].endswith("False"), "the compiler was made ready for nothing"
    assert compiled[1] == loaded[1] == "[14] [1. 1.]", "what is not cached has to compile"


@pytest.mark.thorough
@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", [b"", b"\0" * 4000, b"\x80\x04\x8c\x04\xff\xfe\xfd\xfc"])
def test_damaged_kernels_are_compiled_and_kept_again(tmp_path, suffix, damage):
    hits = []
    for number in range(3):
        hits.append("Counter({" in _started(tmp_path))
        for path in (tmp_path / "cache").rglob(f"*.{suffix}") if number == 0 else ():
            path.write_bytes(damage)
    assert hits == [False, False, True]


USES = """
from gs_codec.runtime.kernels import kernel
from helpers import OFFSET, change
@kernel
def changed(value):
    return change(value) + OFFSET
print(changed(1), len(changed.stats.cache_hits))
"""

HELPERS = """
from gs_codec.runtime.kernels import inlined
from deeper import FACTOR
OFFSET = {offset}
@inlined
def change(value):
    return value {sign} FACTOR
"""


@pytest.mark.thorough
def test_kernels_are_recompiled_when_their_sources_change(tmp_path):
    """Including other modules, which numba does not check: a decoder would read files wrongly."""
    (tmp_path / "uses.py").write_text(USES)
    environment = {
        "PYTHONPATH": str(ROOT),
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        # Python accepts a .pyc for a source of the same size and second.
        "PYTHONDONTWRITEBYTECODE": "1",
    }

    def run() -> str:
        return subprocess.run(
            [sys.executable, str(tmp_path / "uses.py")],
            env=os.environ | environment,
            capture_output=True,
            text=True,
            check=True,
        ).stdout

    def change(offset: int, sign: str, factor: int) -> str:
        (tmp_path / "helpers.py").write_text(HELPERS.format(offset=offset, sign=sign))
        (tmp_path / "deeper.py").write_text(f"FACTOR = {factor}\n")
        return run()

    assert change(10, "+", 5) == "16 0\n"
    assert run() == "16 1\n"
    assert change(20, "+", 5) == "26 0\n"
    assert change(20, "-", 5) == "16 0\n"
    assert change(20, "-", 4) == "17 0\n"


@pytest.mark.thorough
def test_processes_that_start_together_compile_once(tmp_path):
    script = tmp_path / "started.py"
    script.write_text(STARTED)
    command = [sys.executable, str(script)]
    environment = {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    together = [
        subprocess.Popen(command, env=os.environ | environment, stdout=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    lines = [process.communicate()[0].splitlines()[0] for process in together]
    assert sorted(line.startswith("[14.] Counter({") for line in lines) == [False, True, True]


@pytest.fixture
def places(tmp_path, monkeypatch):
    """A home folder and one for temporary files; returns a function that gives the cache folder."""
    (tmp_path / "home").mkdir()
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)

    def found() -> str | None:
        folder = kernel_cache.cache_folder.__wrapped__()
        return folder and folder.relative_to(tmp_path).as_posix()

    return found


TEMPORARY = f"tmp/gs-codec-{os.geteuid()}"


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have other folders")
def test_compiled_kernels_are_kept_in_the_cache_folder_of_the_user(places, tmp_path, monkeypatch):
    assert places() == "home/.cache/gs-codec"
    assert (tmp_path / "home/.cache/gs-codec").stat().st_mode & 0o777 == 0o700
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert places() == "cache/gs-codec"
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "chosen"))
    assert places() == "chosen"


@pytest.mark.parametrize("named", ["", "cache"])
def test_a_relative_cache_folder_is_not_used(places, tmp_path, monkeypatch, named):
    """Otherwise code would be loaded from the current folder, such as a download."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", named)
    assert places() == "home/.cache/gs-codec"


def test_without_a_home_compiled_kernels_are_kept_among_temporary_files(
    places, tmp_path, monkeypatch
):
    monkeypatch.setenv("HOME", str(tmp_path / "missing"))
    assert places() == TEMPORARY
    assert not (tmp_path / "missing").exists()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing/tmp"))
    assert places() is None


@pytest.mark.parametrize("mode", [0o720, 0o702])
def test_no_code_is_loaded_from_folders_writable_by_others(places, tmp_path, mode):
    (tmp_path / "home/.cache/gs-codec").mkdir(parents=True)
    (tmp_path / "home/.cache/gs-codec").chmod(mode)
    assert places() == TEMPORARY
    (tmp_path / TEMPORARY).chmod(mode)
    assert places() is None


def test_no_code_is_loaded_from_folders_of_others(places, tmp_path, monkeypatch):
    assert places() == "home/.cache/gs-codec"
    (tmp_path / TEMPORARY).symlink_to(tmp_path / "home/.cache/gs-codec")
    user = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: user + 1)
    (tmp_path / "tmp" / f"gs-codec-{user + 1}").mkdir()
    (tmp_path / "tmp").chmod(0o1777)
    assert places() is None


def test_no_code_is_loaded_from_paths_others_can_move_or_link(places, tmp_path):
    (tmp_path / "home/.cache").mkdir()
    (tmp_path / "home/.cache").chmod(0o777)
    (tmp_path / "tmp/elsewhere").mkdir()
    (tmp_path / TEMPORARY).symlink_to(tmp_path / "tmp/elsewhere")
    assert places() is None
    (tmp_path / "home/.cache").chmod(0o1777)
    assert places() == "home/.cache/gs-codec"


def test_make_requests_bounds_checks():
    rule = (ROOT / "Makefile").read_text().split("boundscheck: ")[1]
    assert "NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR=" in rule


@pytest.mark.skipif(not numba.config.BOUNDSCHECK, reason="bounds are checked by make boundscheck")
def test_bounds_are_checked_in_this_process():
    @kernel
    def beyond(values, i):
        return values[i]

    with pytest.raises(IndexError):
        beyond(np.zeros(3), 3)

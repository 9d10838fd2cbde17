"""Precompiled kernels, and the cases in which they cannot be used."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from scenes import thorough

from gs_codec.runtime import kernel_archive, kernel_build
from gs_codec.runtime.kernel_archive import Archive, target_of
from gs_codec.runtime.kernel_list import LIST, entry_of, read_list

ROOT = Path(__file__).parents[1]
LISTED = read_list()

#: Kernels that call no others, and one that does.
MODULES = "gs_codec.coding.quantise", "gs_codec.codecs.adaptive.contexts"
FEW = [entry for entry in LISTED if entry.module in MODULES and entry.name != "_quantise"]

BUILD = """
import sys
from contextlib import suppress
from pathlib import Path
from gs_codec.runtime import kernel_build
from gs_codec.runtime.kernel_list import Entry
kernel_build.read_list = lambda: [Entry(*each) for each in {few}]
kernel_build.build("x86-64-v3", Path(sys.argv[1]))
"""

USE = """
import logging, sys
from pathlib import Path
import numba, numpy as np
import numba.core.event as event
from gs_codec.runtime import compiling, kernel_archive
{before}
compiling._MOMENT = 0.0
logging.basicConfig(format="%(message)s", level=logging.INFO)
kernel_archive.FOLDER = Path(sys.argv[1])
from gs_codec.coding import quantise
with event.install_recorder("numba:compile") as recorder:
    print(quantise.fit_range(np.array([1, 3], np.float32), 2).step)
print(len(recorder.buffer) > 0)
"""

pytestmark = pytest.mark.skipif(
    not all(kernel_archive.llvm.get_host_cpu_features().get(each) for each in kernel_archive._V3),
    reason="needs a processor with x86-64-v3",
)


def run(code: str, *arguments: str | Path, **environment: str) -> tuple[list[str], str]:
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        env=os.environ | {"PYTHONPATH": str(ROOT)} | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines(), done.stderr


@pytest.fixture(scope="module")
def archive(tmp_path_factory) -> Path:
    """An archive of few kernels."""
    folder = tmp_path_factory.mktemp("compiled")
    name, features = target_of("x86-64-v3")
    target = {"NUMBA_CPU_NAME": name, "NUMBA_CPU_FEATURES": features}
    path = folder / "x86-64-v3.kernels"
    run(BUILD.format(few=[tuple(each) for each in FEW]), path, **target)
    return path


def test_listed_kernels_exist_with_matching_arguments():
    for entry in LISTED:
        function, types = entry.kernel().py_func, entry.signature()
        assert len(types) == function.__code__.co_argcount, entry
        assert entry_of(function, types) == entry


def test_the_list_has_every_kernel_once_for_its_types():
    found = {
        (".".join(path.relative_to(ROOT).with_suffix("").parts), name)
        for path in (ROOT / "gs_codec").rglob("*.py")
        for name in re.findall(r"^@kernel\ndef (\w+)", path.read_text(), re.MULTILINE)
    }
    assert {entry[:2] for entry in LISTED} == found, "see .ci/record_kernels.py"
    assert sorted(set(LISTED)) == LISTED
    assert found >= kernel_build._WIDE, "compiled for AVX-512, too"
    assert LIST.read_text().endswith("\n")


def test_kernels_of_the_archive_are_not_compiled(archive, tmp_path):
    """And no cache is needed."""
    out, messages = run(USE.format(before=""), archive.parent, NUMBA_CACHE_DIR=str(tmp_path / "a"))
    assert out == ["0.6666666666666666", "False"]
    assert messages == ""
    assert not (tmp_path / "a").exists()


def damaged(content: bytes, how: str) -> bytes:
    if how == "truncated":
        return content[: len(content) // 3]
    if how == "code changed":  # after it was indexed
        begin = content.index(b"}}") + 2
        return content[:begin] + bytes(each ^ 1 for each in content[begin:])
    return {"empty": b"", "foreign": b"\x7fELF" + content}[how]


@pytest.mark.parametrize(
    "how", ["truncated", "code changed", thorough("foreign"), thorough("empty")]
)
def test_a_damaged_archive_changes_nothing_but_time(archive, tmp_path, how):
    (tmp_path / archive.name).write_bytes(damaged(archive.read_bytes(), how))
    cache = str(tmp_path / "cache")
    out, messages = run(USE.format(before=""), tmp_path, NUMBA_CACHE_DIR=cache)
    assert out == ["0.6666666666666666", "True"]
    fault = "truncated" if how == "truncated" else "damaged"
    why = "" if how == "code changed" else f" (those that come with it are {fault})"
    assert messages.startswith(
        f"compiling kernels{why}: 10 to 60 s, once; they are kept in {cache}"
    )
    out, messages = run(USE.format(before=""), tmp_path, NUMBA_CACHE_DIR=cache)
    assert (out, messages) == (["0.6666666666666666", "False"], "")


def test_a_truncated_archive_is_refused(archive):
    content = archive.read_bytes()[len(kernel_archive._MAGIC) :]
    names = [*(" ".join(entry) for entry in FEW), "numba runtime"]
    assert all(Archive(content).part(name) for name in names)
    for size in range(0, len(content), 997):
        with pytest.raises(ValueError, match=r"are (damaged|truncated)"):
            Archive(content[:size])


def test_a_flipped_bit_anywhere_is_detected(archive):
    content = archive.read_bytes()[len(kernel_archive._MAGIC) :]
    names = [*(" ".join(entry) for entry in FEW), "numba runtime"]
    for place in range(0, len(content), 997):
        changed = bytearray(content)
        changed[place] ^= 1 << place % 8
        with suppress(ValueError):
            found = Archive(changed)
            assert [name for name in names if found.part(name) is None], place


@pytest.mark.thorough
def test_a_warning_reports_a_missing_cache(tmp_path):
    (tmp_path / "file").touch()
    file = str(tmp_path / "file")
    out, messages = run(USE.format(before=""), tmp_path, NUMBA_CACHE_DIR=file)
    assert out == ["0.6666666666666666", "True"]
    assert messages.splitlines()[0] == (
        f"compiling kernels: 10 to 60 s, at every run, because {file} cannot be written to; set "
        "NUMBA_CACHE_DIR to a folder that 'gs-codec warm' has filled"
    )


@pytest.mark.parametrize(
    ("before", "environment", "why"),
    [
        ("numba.__version__ = '0.1'", {}, "those that come with it are made for numba"),
        thorough("", {"NUMBA_BOUNDSCHECK": "1"}, "those that come with it are made for settings"),
        ("", {"NUMBA_OPT": "1"}, "those that come with it are made for settings"),
        thorough("", {"NUMBA_CPU_NAME": "generic"}, "are not for NUMBA_CPU_NAME"),
        thorough(
            "kernel_archive.TIERS['x86-64-v3'] = 'x86-64-v5', ['avx1024']", {},
            "need a processor with x86-64-v3",
        ),
        thorough("sys.argv[1] += '/missing'", {}, "compiling kernels: 10 to 60 s, once; "),
        (
            "kernel_archive.stamp.__globals__['source_digest'] = lambda path: (path, 'edited')", {},
            "compiling kernels: 10 to 60 s, once; ",
        ),
    ],
    ids=["numba", "boundscheck", "opt", "processor named", "processor", "missing", "edited"],
)  # fmt: skip
def test_kernels_are_compiled_if_the_archive_does_not_apply(
    archive, tmp_path, before, environment, why
):
    cache = {"NUMBA_CACHE_DIR": str(tmp_path)}
    out, messages = run(USE.format(before=before), archive.parent, **environment | cache)
    assert out == ["0.6666666666666666", "True"]
    assert why in messages

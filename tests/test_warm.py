"""Kernels compiled in advance."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from gs_codec.runtime.kernel_list import read_list

ROOT = Path(__file__).parents[1]

#: Runs `gs-codec warm --json` with a list of three kernels.
WARM = """
import sys
from gs_codec.runtime import kernel_build
from gs_codec.runtime.kernel_list import Entry
kernel_build.read_list = lambda: [Entry(*each) for each in {few}]
sys.argv = ["gs-codec", "warm", "--json", "--threads", "2"]
from gs_codec.__main__ import main
main()
"""


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, *arguments],
        env=os.environ | {"PYTHONPATH": str(ROOT)} | environment,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.thorough
def test_missing_kernels_are_compiled_once(tmp_path):
    modules = "gs_codec.coding.quantise", "gs_codec.codecs.adaptive.section"
    few = [tuple(entry) for entry in read_list() if entry.module in modules]
    assert len({module for module, *_ in few}) == 2
    told = []
    for _ in range(2):
        done = run("-c", WARM.format(few=few), NUMBA_CACHE_DIR=str(tmp_path / "kept"))
        # A slow machine shows progress.
        lines = [line for line in done.stderr.splitlines() if not line.startswith("compile: ")]
        assert (done.returncode, lines) == (0, [])
        told.append(json.loads(done.stdout))
    assert [each["compiled"] for each in told] == [len(few), 0]
    assert told[0]["kernels"] == len(few)
    assert told[0]["folder"] == str(tmp_path / "kept")
    assert {path.name.split(".")[0] for path in (tmp_path / "kept").glob("*/*.nbi")} == {
        "quantise", "section"
    }  # fmt: skip


def test_an_unusable_cache_folder_is_an_error(tmp_path):
    (tmp_path / "file").touch()
    done = run("-m", "gs_codec", "warm", NUMBA_CACHE_DIR=str(tmp_path / "file"))
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        f"gs-codec: error: {tmp_path / 'file'}: cannot be written to, expected a folder for "
        "compiled kernels; set NUMBA_CACHE_DIR to a writable one\n"
    )

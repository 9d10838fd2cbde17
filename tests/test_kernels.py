"""Kernels as `make boundscheck` compiles them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

from gs_codec.kernels import kernel

ROOT = Path(__file__).parents[1]

BEYOND = """
import numpy as np
from gs_codec.kernels import inlined, kernel
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


def test_bounds_are_checked_where_that_is_asked(tmp_path):
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


def test_make_asks_for_it():
    rule = (ROOT / "Makefile").read_text().split("boundscheck: ")[1]
    assert "NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR=" in rule


@pytest.mark.skipif(not numba.config.BOUNDSCHECK, reason="bounds are checked by make boundscheck")
def test_bounds_are_checked_here():
    @kernel
    def beyond(values, i):
        return values[i]

    with pytest.raises(IndexError):
        beyond(np.zeros(3), 3)

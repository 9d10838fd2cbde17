"""Fixtures that several test files use."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import NamedTuple

import hypothesis
import pytest
from scenes import random_scene

from gs_codec.config import Config
from gs_codec.files import decode_file, encode_file
from gs_codec.io.ply import write_ply

# A shell that starts tests in the background lets them, and so what they start, ignore Ctrl-C.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# The same examples on every run, on however slow a machine.
hypothesis.settings.register_profile(
    "same", derandomize=True, deadline=None, database=None, print_blob=True
)
hypothesis.settings.load_profile("same")


class Trio(NamedTuple):
    """A scene as PLY, encoded, and decoded again."""

    ply: Path
    egs: Path
    decoded: Path


@pytest.fixture(scope="session")
def trio(tmp_path_factory: pytest.TempPathFactory) -> Trio:
    """Files of ``random_scene(1500, 3, seed=100)``; tests only read them."""
    folder = tmp_path_factory.mktemp("trio")
    paths = Trio(folder / "scene.ply", folder / "scene.egs", folder / "decoded.ply")
    write_ply(paths.ply, random_scene(1500, 3, seed=100))
    encode_file(paths.ply, paths.egs, Config("paper-m"))
    decode_file(paths.egs, paths.decoded)
    return paths

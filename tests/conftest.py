"""Fixtures that several test files use."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import pytest
from scenes import random_scene

from gs_codec.config import Config
from gs_codec.files import decode_file, encode_file
from gs_codec.io.ply import write_ply


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

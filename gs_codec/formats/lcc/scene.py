"""Read the finest level of `.lcc` and `.lcc2` scenes, which a file of JSON describes."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from gs_codec.format_table import LCC
from gs_codec.formats.lcc.cell_tables import Grid
from gs_codec.formats.lcc.node_scenes import Octree
from gs_codec.formats.limits import check_count, refusing
from gs_codec.formats.registry import scene_files
from gs_codec.runtime.json_text import parse_json
from gs_codec.runtime.mapped import FileBytes, located, total_bytes
from gs_codec.scene import Scene

#: Commas before the end of a list or an object, which some programs write into a `.lcc2`.
_SURPLUS = re.compile(rb",(?=\s*[]}])")


def is_lcc(path: Path, data: FileBytes) -> bool:
    """Whether a file of JSON has a suffix of these formats."""
    return path.suffix.lower() in LCC.read


def _described(path: Path, data: memoryview | FileBytes) -> Grid | Octree:
    with refusing("description", AttributeError):
        about = _parsed(bytes(data))
        return Octree(path, about) if "root" in about else Grid(path, about)


def _parsed(text: bytes) -> Any:
    try:
        return parse_json(text)
    except ValueError:
        return parse_json(_SURPLUS.sub(b"", text))


def stated_size(path: Path, data: memoryview) -> tuple[int, int]:
    """Number of Gaussians of the finest level and of the environment, and SH degree."""
    with located(path):
        return _described(path, data).stated_size()


def files_beside(path: Path, data: FileBytes) -> list[Path]:
    """The files that are read."""
    with located(path):
        files = _described(path, data).files
    texts = [file for file in files if file.suffix.lower() == ".json"]
    return files + [beside for file in texts for beside in scene_files(file)[1:]]


def coarser_files(path: Path, data: FileBytes) -> list[Path]:
    """The files of coarser levels of a `.lcc2`, which are not read."""
    with located(path):
        described = _described(path, data)
    return described.coarser_files() if isinstance(described, Octree) else []


def read_lcc(path: Path, data: memoryview, max_bytes: int | None) -> Scene:
    """Read the files that a `.lcc` or `.lcc2` describes; see `SceneFile.scene`."""
    with located(path):
        described = _described(path, data)
        file_bytes = len(data) + total_bytes(described.files)
        check_count(*described.stated_size(), file_bytes, max_bytes)
        return described.read(max_bytes)

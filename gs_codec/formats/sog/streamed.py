"""Streamed SOG: the tree of levels of detail in `lod-meta.json`; reading the finest level.

Each leaf of the tree has a run of Gaussians at each level, in SOG scenes next to `lod-meta.json`. A
viewer draws each leaf at one level, chosen by the distance of the leaf's box. A zip of all files is
an `.ssog`.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping, Sequence, Sized
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gs_codec.egs.header import FANOUT
from gs_codec.errors import InvalidInput
from gs_codec.format_table import STREAMED, ZIP
from gs_codec.formats.limits import check_count, refusing
from gs_codec.formats.relative_name import relative_name
from gs_codec.formats.sog.files import Files, Unit, opened_files, opened_unit, unit_of
from gs_codec.formats.sog.scene import SPARE, say_unread, scene_of_unit
from gs_codec.formats.zip_file import opened_zip
from gs_codec.runtime.json_text import parse_json
from gs_codec.runtime.mapped import FileBytes, located
from gs_codec.scene import Scene, join_scenes

log = logging.getLogger(__name__)

#: Runs of Gaussians by the name of their SOG scene; None for all of its Gaussians.
Wanted = Mapping[str, list[range] | None]

_VERSION = 1

#: Maximum bytes of a `lod-meta.json`, unless the file itself or its zip is larger.
_LOD_META_BYTES = 1 << 22

#: `SPARE` of all files in total.
_SPARE = 1 << 22

#: Minimum of `SPARE` of each file.
_LEAST_SPARE = 1 << 10


@dataclass(frozen=True)
class Run:
    """Location of a leaf's Gaussians at a level: file, first index, and number."""

    file: int
    offset: int
    count: int


@dataclass(frozen=True)
class Leaf:
    """A leaf of the tree.

    Attributes
    ----------
    low, high : sequence of float
        The corners of its box.
    runs : sequence of Run
        The run of each level, the finest first.
    """

    low: Sequence[float]
    high: Sequence[float]
    runs: Sequence[Run]


def describe_levels(leaves: Sequence[Leaf], names: Sequence[str]) -> bytes:
    """The `lod-meta.json` of at least one leaf, whose Gaussians are in the files `names`."""
    levels = range(len(leaves[0].runs))
    counts = [sum(leaf.runs[level].count for leaf in leaves) for level in levels]
    described = {
        "version": _VERSION,
        "asset": {"generator": "gs_codec"},
        "count": sum(counts),
        "counts": counts,
        "lodLevels": len(counts),
        "filenames": list(names),
        "tree": _tree([_node(leaf) for leaf in leaves]),
    }
    return json.dumps(described, separators=(",", ":")).encode()


def _node(leaf: Leaf) -> dict[str, Any]:
    runs = {str(level): vars(run) for level, run in enumerate(leaf.runs)}
    return {"bound": {"min": list(leaf.low), "max": list(leaf.high)}, "lods": runs}


def _tree(nodes: list[dict[str, Any]]) -> dict[str, Any]:
    """The root above nodes, with four children per node like blocks of levels in an `.egs`."""
    while len(nodes) > 1:
        groups = (nodes[i : i + FANOUT] for i in range(0, len(nodes), FANOUT))
        nodes = [{"bound": _around(group), "children": group} for group in groups]
    return nodes[0]


def _around(nodes: Sequence[dict[str, Any]]) -> dict[str, list[float]]:
    bounds = [node["bound"] for node in nodes]
    return {
        end: [of(values) for values in zip(*(bound[end] for bound in bounds), strict=True)]
        for end, of in (("min", min), ("max", max))
    }


def is_streamed(path: Path, data: FileBytes) -> bool:
    """Whether a file is named `lod-meta.json`, or is a zip with one.

    Raises InvalidInput if it is a zip that is not valid.
    """
    if data[: len(ZIP)] != ZIP:
        return path.name.lower() == STREAMED
    with located(path), opened_zip(path) as archive:
        return bool(archive.named(STREAMED))


@contextmanager
def _opened(
    path: Path, data: memoryview | FileBytes, finest: bool
) -> Iterator[tuple[Files, Wanted]]:
    """The files of a `lod-meta.json`, and what is wanted of them: the finest level, or all."""
    with located(path), opened_files(path, data) as (files, name):
        # It is much smaller than the files that it describes.
        text = files.read(name, max(len(data), _LOD_META_BYTES))
        yield files.in_folder_of(name), _wanted(text, finest)


def read_streamed(path: Path, data: memoryview, max_bytes: int | None) -> Scene:
    """Read the finest level of a `lod-meta.json`, and its environment; see `SceneFile.scene`."""
    with _opened(path, data, finest=True) as (files, names):
        sizes = [_size(files, name) for name in names]
        file_bytes = len(data) + sum(stored for _, stored in sizes)
        check_count(*_whole([stated for stated, _ in sizes]), file_bytes, max_bytes)
        scenes: list[Scene] = []
        seen: set[str] = set()
        models: set[str] = set()
        untold = 0
        for name, runs in names.items():
            with located(name), opened_unit(files, name) as unit:
                _check_unseen(seen, files, unit)
                where, spare = f"{path}: {name}", _spare(names)
                scene, count = scene_of_unit(where, unit, file_bytes, max_bytes, spare)
                scenes.append(_in_runs(scene, runs))
                models.add(unit.meta.model)
                untold += count
    if len({scene.antialiased for scene in scenes}) > 1:
        log.warning("%s: only some parts are antialiased; all are read like the first", path)
    say_unread(path, models, untold)
    return join_scenes(scenes)


def _in_runs(scene: Scene, runs: Sequence[range] | None) -> Scene:
    """The Gaussians of runs; the same file may have coarser levels, too."""
    if runs is None:
        return scene
    kept = np.zeros(scene.count, bool)
    for run in runs:
        if not 0 <= run.start <= run.stop <= scene.count:
            raise InvalidInput(
                f"Gaussians {run.start:,} to {run.stop:,} of {scene.count:,} (in {STREAMED})"
            )
        kept[run.start : run.stop] = True
    return scene if kept.all() else scene.take(kept)


def check_coarser(path: Path, data: memoryview, max_bytes: int | None) -> None:
    """Also read the files that have only coarser levels; raises like `read_streamed`."""
    with _opened(path, data, finest=True) as (_, finest):
        pass
    with _opened(path, data, finest=False) as (files, names):
        for name in names:
            if name not in finest:
                with located(name), opened_unit(files, name) as unit:
                    where, size = f"{path}: {name}", len(data) + unit.stored_bytes
                    scene_of_unit(where, unit, size, max_bytes, _spare(names))


def _spare(names: Sized) -> int:
    """`SPARE` of each file; bounds the time to decode small files with many large images."""
    return min(SPARE, max(_SPARE // len(names), _LEAST_SPARE))


def _check_unseen(seen: set[str], files: Files, unit: Unit) -> None:
    """Reject images of an earlier unit, because thousands of units could share them."""
    if unit.files.archive is files.archive:
        images = {str(unit.files.folder / image) for image in unit.images}
        if seen & images:
            shared = Path(min(seen & images)).name
            raise InvalidInput(f"image {shared!a:.60} also belongs to another scene")
        seen |= images


def files_beside(path: Path, data: FileBytes) -> list[Path]:
    """The files of all levels of a `lod-meta.json`; a zip has none."""
    with _opened(path, data, finest=False) as (files, names):
        units = [unit_of(files, name) for name in names if name.lower().endswith(".json")]
        images = [image for unit in units for image in unit.files.paths(unit.images)]
        return files.paths(names) + images


def stated_size(path: Path, data: memoryview) -> tuple[int, int]:
    """Number of Gaussians of the finest level, and SH degree."""
    with _opened(path, data, finest=True) as (files, names):
        return _whole([_size(files, name)[0] for name in names])


def _whole(stated: Sequence[tuple[int, int]]) -> tuple[int, int]:
    counts, degrees = zip(*stated, strict=True)
    return sum(counts), max(degrees)


def _size(files: Files, name: str) -> tuple[tuple[int, int], int]:
    """Number of Gaussians and SH degree of a SOG scene, and the size of its files; 0 in a zip."""
    with located(name), opened_unit(files, name) as unit:
        return unit.meta.stated_size, unit.stored_bytes


def _wanted(text: bytes, finest: bool) -> Wanted:
    with refusing(STREAMED, AttributeError):
        meta = parse_json(text)
        if not isinstance(meta, dict) or meta.get("version", _VERSION) != _VERSION:
            raise InvalidInput(f"{STREAMED}: expected version {_VERSION} of streamed SOG")
        names = list(meta["filenames"])
        wanted: list[tuple[Any, list[range] | None]] = [(name, None) for name in names]
        if finest:
            wanted = [(names[k], runs) for k, runs in sorted(_finest_runs(meta["tree"]).items())]
        wanted += [(meta["environment"], None)] if meta.get("environment") else []
        found = {relative_name(name, STREAMED): runs for name, runs in wanted}
    if not found or len(found) != len(wanted):
        raise InvalidInput(f"{STREAMED}: no files of the level, or one twice")
    return found


def _finest_runs(tree: dict[str, Any]) -> dict[int, list[range]]:
    """Runs of Gaussians of the finest level, by the number of their file."""
    left, runs = [tree], dict[int, list[range]]()
    while left:
        node = left.pop()
        left += node.get("children", ())
        if "0" in node.get("lods", ()):
            run = node["lods"]["0"]
            rows = range(run["offset"], run["offset"] + run["count"])
            runs.setdefault(run["file"], []).append(rows)
    return runs

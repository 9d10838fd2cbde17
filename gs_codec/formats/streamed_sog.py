"""Streamed SOG: the tree of levels of detail of a `lod-meta.json`, and its finest level read.

Each leaf of the tree has a run of Gaussians at each level, in SOG scenes beside `lod-meta.json`. A
viewer draws each leaf at one level, which it chooses by how far away the leaf's box is.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gs_codec.config import STREAMED
from gs_codec.egs.header import FANOUT
from gs_codec.errors import InvalidInput
from gs_codec.formats import sog
from gs_codec.formats.limits import check_count, refusing
from gs_codec.runtime.json_text import parse_json
from gs_codec.runtime.mapped import located, opened
from gs_codec.scene import Scene, join_scenes

_VERSION = 1


@dataclass(frozen=True)
class Run:
    """Where the Gaussians of a leaf at a level are: in which file, from which, how many."""

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
        Of each level, the finest first.
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
    """The root above nodes: four become one, as blocks of the levels of an `.egs` do."""
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


def is_streamed(path: Path) -> bool:
    """Whether a file has the name of a `lod-meta.json`."""
    return path.name.lower() == STREAMED


def read_streamed(path: Path, data: memoryview, max_bytes: int | None) -> Scene:
    """Read the finest level of a `lod-meta.json`, and its environment; see `SceneFile.scene`."""
    sizes = [(stated, _size(file)) for file, stated in _units(path, data, finest=True)]
    (count, degree), stored = _whole([stated for stated, _ in sizes]), sum(s for _, s in sizes)
    with located(path):
        check_count(count, degree, stored, max_bytes)
    scenes = []
    for file, _ in _units(path, data, finest=True):
        with opened(file) as content:
            scenes.append(sog.read_sog(file, content[:], max_bytes))
    return join_scenes(scenes)


def streamed_bytes(path: Path, data: memoryview) -> int:
    """Size of `lod-meta.json` and of all files of all levels."""
    return len(data) + sum(_size(file) for file, _ in _units(path, data, finest=False))


def stated_size(path: Path, data: memoryview) -> tuple[int, int]:
    """Number of Gaussians of the finest level, and SH degree."""
    return _whole([stated for _, stated in _units(path, data, finest=True)])


def _whole(stated: Sequence[tuple[int, int]]) -> tuple[int, int]:
    counts, degrees = zip(*stated, strict=True)
    return sum(counts), max(degrees)


def _size(path: Path) -> int:
    with opened(path) as data:
        return sog.sog_bytes(path, data[:])


def _units(path: Path, data: memoryview, finest: bool) -> Iterator[tuple[Path, tuple[int, int]]]:
    """Paths of the SOG scenes of a level or of all, and the sizes that they state."""
    with located(path):
        names = _names(data, finest)
    for name in names:
        file = path.parent / name
        with opened(file) as content:
            yield file, sog.stated_size(file, content[:])


def _names(data: memoryview, finest: bool) -> list[str]:
    with refusing(STREAMED, AttributeError):
        meta = parse_json(bytes(data))
        if not isinstance(meta, dict) or meta.get("version", _VERSION) != _VERSION:
            raise InvalidInput(f"{STREAMED}: expected version {_VERSION} of streamed SOG")
        wanted = list(meta["filenames"])
        if finest:
            used = {run["file"] for run in _finest_runs(meta["tree"])}
            wanted = [wanted[index] for index in sorted(used)]
        wanted += [meta["environment"]] if meta.get("environment") else []
        wanted = list(_checked(wanted))
    if not wanted or len(set(wanted)) != len(wanted):
        raise InvalidInput(f"{STREAMED}: no files of the level, or one twice")
    return wanted


def _finest_runs(tree: dict[str, Any]) -> Iterator[dict[str, Any]]:
    left = [tree]
    while left:
        node = left.pop()
        left += node.get("children", ())
        if "0" in node.get("lods", ()):
            yield node["lods"]["0"]


def _checked(names: Iterable[Any]) -> Iterator[str]:
    """Refuse names of files that do not lie below the folder of `lod-meta.json`."""
    for name in names:
        plain = isinstance(name, str) and name.isprintable() and not set(name) & set("\\:")
        if not plain or any(part.strip(".") == "" for part in name.split("/")):
            raise InvalidInput(f"{STREAMED}: file {name!a:.60}, expected one beside it")
        yield name

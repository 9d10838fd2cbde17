"""The octree of a `.lcc2`: SOG or `.spz` scenes at its nodes.

The level of a node is the number of levels minus its depth; several nodes may share a file.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from gs_codec.errors import InvalidInput
from gs_codec.format_table import LCC, SOG, SPZ
from gs_codec.formats.coordinates import state_system
from gs_codec.formats.lcc.cell_tables import level_count
from gs_codec.formats.registry import SceneFile, open_scene
from gs_codec.formats.relative_name import relative_name
from gs_codec.scene import Scene, join_scenes


class Octree:
    """The scene of a `.lcc2`; raises `InvalidInput`, or exceptions of `refusing`."""

    def __init__(self, path: Path, about: dict[str, Any]) -> None:
        root = about["root"]
        nodes, names = [root], root.get("splatFiles")
        if names is None:  # of earlier programs
            names = [f"{name.strip('/').removesuffix('.sog')}.sog" for name in root["files"]]
        for _ in range(level_count(about.get("totalLevels", about.get("lod_level")))):
            nodes = [child for node in nodes for child in _children(node)]
        used = {node["data"]["3dgs"]["name"] for node in nodes if "3dgs" in node.get("data", ())}
        if not used:
            raise InvalidInput("no files of the finest level")
        if environment := root.get("data", {}).get("env"):
            used.add(environment["name"])
        if not used <= {*range(len(names))}:
            raise InvalidInput(f"a file beyond the {len(names)} of splatFiles")
        found = (relative_name(names[index], path.name) for index in sorted(used))
        self.files = [path.parent / name for name in found]
        self._path, self._unread = path, [names[index] for index in {*range(len(names))} - used]

    def coarser_files(self) -> list[Path]:
        """Files of coarser levels, which are not read; names that lead elsewhere are skipped."""
        found = []
        for name in self._unread:
            with suppress(InvalidInput):
                found.append(self._path.parent / relative_name(name, self._path.name))
        return found

    def _opened(self) -> Iterator[SceneFile]:
        """The scenes of all files, each open until the next."""
        for file in self.files:
            with open_scene(file) as scene:
                if scene.format not in (SOG.name, SPZ.name):
                    raise InvalidInput(f"{file.name}: {scene.format}, expected .sog or .spz")
                yield scene

    def stated_size(self) -> tuple[int, int]:
        """Number of Gaussians, and SH degree."""
        counts, degrees = zip(*(scene.stated_size() for scene in self._opened()), strict=True)
        return sum(counts), max(degrees)

    def read(self, max_bytes: int | None) -> Scene:
        """Read all Gaussians of the finest level, and of the environment."""
        scenes = [scene.scene("drop", max_bytes, exact=True) for scene in self._opened()]
        return join_scenes([state_system(scene, LCC.system) for scene in scenes])


def _children(node: dict[str, Any]) -> list[dict[str, Any]]:
    children = node.get("child") or []
    return [*children.values()] if isinstance(children, dict) else children

"""Scenes to measure, and what results call them."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from gs_codec.bench.tile import tile_scene
from gs_codec.io.ply import read_ply
from gs_codec.scene import Scene


def scene_name(path: Path) -> str:
    """What a scene is called: its file, or the folder of one that trainers name alike."""
    return path.stem if path.stem != "point_cloud" else path.absolute().parent.name


def load_scene(
    path: Path, extra: Literal["error", "keep", "drop"], tile: int | None = None
) -> tuple[str, Scene]:
    """Name and scene of a PLY file, tiled to so many Gaussians if asked."""
    scene = read_ply(path, extra)
    return scene_name(path), tile_scene(scene, tile) if tile else scene

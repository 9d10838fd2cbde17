"""Scenes to measure: read, named, tiled to any size, and their views split in two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from gs_codec.formats.ply import read_ply
from gs_codec.preparation.steps import Plan, Steps
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.cameras import find_cameras
from gs_codec.scene import GROUPS, Scene

_JITTER = 1e-3

#: How many `auto` views are measured in, and how many others the encoder sees.
_MEASURED, _ENCODED_BY = 24, 64


def scene_name(path: Path) -> str:
    """Name of a scene: its file's, or its folder's if the file is a trainer's point_cloud.ply."""
    return path.stem if path.stem != "point_cloud" else path.absolute().parent.name


def load_scene(
    path: Path, extra: Literal["error", "keep", "drop"], tile: int | None = None
) -> tuple[str, Scene]:
    """Name and scene of a PLY file, tiled to `tile` Gaussians if given."""
    scene = read_ply(path, extra)
    return scene_name(path), tile_scene(scene, tile) if tile else scene


def tile_scene(scene: Scene, count: int, seed: int = 0) -> Scene:
    """`count` Gaussians: copies of `scene` on a square grid.

    Each float moves by a normal deviate of 1/1000 of its channel's standard deviation, so that
    copies are alike in distribution but in no value. Exact zeros of f_rest stay.
    """
    copies = -(-count // scene.count)
    side = int(np.ceil(np.sqrt(copies)))
    extent = np.ptp(scene.positions, axis=1)
    rng = np.random.default_rng(seed)
    planes: dict[str, Any] = {}
    for group in GROUPS:
        source = getattr(scene, group)
        tiled = np.tile(source, (1, copies))[:, :count]
        spread = source.std(axis=1, dtype=np.float64) * _JITTER
        for row, sigma in zip(tiled, spread, strict=True):
            jitter = rng.standard_normal(count, dtype=np.float32) * np.float32(sigma)
            row += np.where(row == 0, np.float32(0), jitter)
        planes[group] = tiled
    copy = np.arange(count) // scene.count
    planes["positions"][0] += extent[0] * (copy % side)
    planes["positions"][1] += extent[1] * (copy // side)
    return replace(scene, extra={}, **planes)


def held_out_views(
    source: str | Sequence[Camera], scene: Scene, width: int | None
) -> tuple[list[Camera], Plan]:
    """Cameras to measure in, and a plan without steps whose views are the others.

    Of a file's cameras, or given ones, those marked ``test`` are measured in; of ``auto`` views,
    24 of 88.
    """
    both = _MEASURED + _ENCODED_BY
    cameras = find_cameras(source, scene, "all", width, both)
    if source == "auto":
        marked = [i * _MEASURED // both for i in range(len(cameras) + 1)]
        cameras = [
            replace(camera, split="test" if marked[i] < marked[i + 1] else "train")
            for i, camera in enumerate(cameras)
        ]
    return find_cameras(cameras, scene, "held-out"), Plan(Steps(), cameras, views=_ENCODED_BY)

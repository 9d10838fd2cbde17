"""Scenes to measure: read, named, tiled to a size, with views split in two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gs_codec.cameras.camera import Camera
from gs_codec.config import Extra
from gs_codec.errors import InvalidInput
from gs_codec.formats.ply.file import read_ply
from gs_codec.plan import Plan, Steps
from gs_codec.preparation.reference_views import photographed
from gs_codec.runtime.mapped import located
from gs_codec.scene import GROUPS, Scene
from gs_codec.views.find import find_cameras
from gs_codec.views.photographs import read_photograph

_JITTER = 1e-3

#: Number of `auto` views for measuring results.
_MEASURED = 24

#: Number of other `auto` views, for the encoder.
_ENCODED_BY = 64

#: If a file marks no held-out cameras, every n-th is held out.
_HELD_OUT = 3


@dataclass(frozen=True)
class MeasuredScene:
    """A scene and its views.

    Attributes
    ----------
    path : Path
        The file that it was read from.
    name : str
    scene : Scene
    cameras : list of Camera
        Views for measuring; empty if rendered quality is not measured.
    guides : list of Camera
        Other views, for the encoder.
    truth : Path or None
        Folder of the cameras' photographs.
    """

    path: Path
    name: str
    scene: Scene
    cameras: list[Camera]
    guides: list[Camera]
    truth: Path | None

    @property
    def masks(self) -> Path | None:
        """Folder ``masks`` beside that of the photographs, if it exists."""
        folder = None if self.truth is None else self.truth.with_name("masks")
        return folder if folder is not None and folder.is_dir() else None

    @property
    def plan(self) -> Plan:
        """A plan without steps, with the views for the encoder."""
        return Plan(Steps(), self.guides, views=_ENCODED_BY)

    @property
    def refining(self) -> list[Plan]:
        """Plans with the views to refine to: renders, and photographs if there are any.

        The views for measuring are marked as held out. Empty without given cameras.
        """
        measured, guides = (
            {(camera.name, *camera.position) for camera in cameras}
            for cameras in (self.cameras, self.guides)
        )
        if cameras_of(self.path) == "auto" or measured & guides:
            return []
        cameras = [replace(camera, split="train") for camera in self.guides]
        cameras += [replace(camera, split="test") for camera in self.cameras]
        plan = replace(self.plan, cameras=cameras)
        return [plan] if self.truth is None else [plan, replace(plan, gt_images=self.truth)]


def scene_folder(path: Path) -> Path:
    """Folder of a scene's cameras and photographs: the PLY's own, or that of the INRIA trainer.

    The trainer writes ``SCENE/point_cloud/iteration_30000/point_cloud.ply``.
    """
    folder = path.parent
    by_trainer = folder.parent.name == "point_cloud" and folder.name.startswith("iteration_")
    return folder.parents[1] if by_trainer else folder


def scene_name(path: Path) -> str:
    """Name of a scene: its file's, or its folder's if the file is a trainer's point_cloud.ply."""
    return path.stem if path.stem != "point_cloud" else scene_folder(path).absolute().name


def check_names(paths: Sequence[Path]) -> None:
    """Reject scenes if two have the same name."""
    names: dict[str, Path] = {}
    for path in paths:
        other = names.setdefault(scene_name(path), path)
        if other is not path:
            raise InvalidInput(f"{path}: has the same name '{scene_name(path)}' as {other}")


def open_scene(
    path: Path,
    cameras: str | Sequence[Camera] | None,
    truth: Path | None,
    width: int | None,
    extra: Extra = "drop",
    tile: int | None = None,
) -> MeasuredScene:
    """Read a PLY, tiled to `tile` Gaussians if given, and split the views of `cameras`.

    With a folder `truth`, cameras with a photograph there are used for measuring, resized to it.
    Raises InvalidInput if a file cannot be used, or no view for measuring has a photograph.
    """
    scene = read_ply(path, extra)
    scene = tile_scene(scene, tile) if tile else scene
    if cameras is None:
        return MeasuredScene(path, scene_name(path), scene, [], [], None)
    with located(path):
        measured, guides = held_out_views(cameras, scene, width)
    if truth is not None:
        pairs = photographed(measured, truth)
        measured = [read_photograph(camera, image)[0] for camera, image in pairs]
    return MeasuredScene(path, scene_name(path), scene, measured, guides, truth)


def open_with_cameras(path: Path, width: int | None) -> MeasuredScene:
    """A scene with the cameras and photographs in its folder; raises like `open_scene`."""
    cameras, images = cameras_of(path), scene_folder(path) / "images"
    truth = images if cameras != "auto" and images.is_dir() else None
    return open_scene(path, cameras, truth, width)


def cameras_of(path: Path) -> str:
    """The cameras in the folder of a scene, or ``auto``."""
    file = scene_folder(path) / "cameras.json"
    return str(file) if file.is_file() else "auto"


def held_out_views(
    source: str | Sequence[Camera], scene: Scene, width: int | None
) -> tuple[list[Camera], list[Camera]]:
    """Cameras for measuring, and others for encoding; the same if one list would be empty.

    Cameras for measuring are those marked ``test``, or every third if none is; with ``auto``, 24 of
    88 views.
    """
    both = _MEASURED + _ENCODED_BY
    cameras = find_cameras(source, scene, "all", width, both)
    if source == "auto":
        held_out = [i * _MEASURED % both >= _ENCODED_BY for i in range(len(cameras))]
    elif any(camera.split == "test" for camera in cameras):
        held_out = [camera.split == "test" for camera in cameras]
    else:
        held_out = [i % _HELD_OUT == 0 for i in range(len(cameras))]
    measured = [camera for camera, held in zip(cameras, held_out, strict=True) if held]
    others = [camera for camera, held in zip(cameras, held_out, strict=True) if not held]
    return measured or others, others or measured


def tile_scene(scene: Scene, count: int) -> Scene:
    """`count` Gaussians: copies of `scene` on a square grid.

    Each float moves by a normal deviate of 1/1000 of its channel's standard deviation, so that
    copies have the same distribution but no equal values. Exact zeros of f_rest are kept.
    """
    copies = -(-count // scene.count)
    side = int(np.ceil(np.sqrt(copies)))
    extent = np.ptp(scene.positions, axis=1)
    rng = np.random.default_rng(0)
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

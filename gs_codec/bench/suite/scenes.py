"""The scenes of the suite: files, and the views they are measured in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gs_codec.bench.sources import held_out_views, load_scene, scene_name
from gs_codec.errors import InvalidInput
from gs_codec.metrics.views import fitted
from gs_codec.preparation.reference_views import evenly, photographed
from gs_codec.preparation.steps import Plan
from gs_codec.rendering.camera import Camera
from gs_codec.rendering.cameras import find_cameras
from gs_codec.rendering.images import read_image
from gs_codec.runtime.mapped import located
from gs_codec.scene import Scene

#: If a file does not mark held-out cameras, every third is held out.
_HELD_OUT = 3


@dataclass(frozen=True)
class MeasuredScene:
    """A scene and its views.

    Attributes
    ----------
    path : Path
    name : str
    scene : Scene
    source : str
        Where cameras come from: ``cameras.json`` or ``auto``.
    cameras : list of Camera
        To measure in.
    plan : Plan
        Without steps, of the others.
    truth : Path or None
        Folder of the cameras' photographs.
    """

    path: Path
    name: str
    scene: Scene
    source: str
    cameras: list[Camera]
    plan: Plan
    truth: Path | None

    @property
    def line(self) -> dict[str, Any]:
        """The result line of the scene itself."""
        views: Sequence[Camera] = self.plan.cameras  # type: ignore[assignment]
        others = [camera for camera in views if camera.split != "test"] or views
        first = self.cameras[0]
        return {
            "kind": "scene",
            "scene": self.name,
            "gaussians": self.scene.count,
            "sh_degree": self.scene.sh_degree,
            "ply_bytes": self.path.stat().st_size,
            "cameras": self.source,
            "measured_views": len(self.cameras),
            "encoded_by_views": len(evenly(others, self.plan.views)),
            "width": first.width,
            "height": first.height,
            "photographs": self.truth is not None,
        }


def open_scene(path: Path, width: int | None) -> MeasuredScene:
    """Read a scene, with the cameras and photographs beside it.

    Raises
    ------
    InvalidInput
        If a file cannot be used, or none of the views to measure in has a photograph.
    """
    name, scene = load_scene(path, "error")
    beside, images = path.with_name("cameras.json"), path.with_name("images")
    source = "cameras.json" if beside.is_file() else "auto"
    truth = images if source != "auto" and images.is_dir() else None
    found = "auto" if source == "auto" else _marked(find_cameras(beside, scene, "all", width))
    with located(path):
        cameras, plan = held_out_views(found, scene, width if source == "auto" else None)
    if truth is not None:
        pairs = photographed(cameras, truth)
        cameras = [fitted(camera, read_image(image), image) for camera, image in pairs]
    return MeasuredScene(path, name, scene, source, cameras, plan, truth)


def _marked(cameras: list[Camera]) -> Sequence[Camera]:
    """Cameras marked by use; if they are not, every third is held out."""
    if any(camera.split == "test" for camera in cameras):
        return cameras
    marks = ("test", *["train"] * (_HELD_OUT - 1))
    return [
        replace(camera, split=marks[i % _HELD_OUT])  # type: ignore[arg-type]
        for i, camera in enumerate(cameras)
    ]


def open_scenes(paths: Sequence[Path], width: int | None) -> list[MeasuredScene]:
    """Scenes, each with a name of its own.

    Raises
    ------
    InvalidInput
        As `open_scene` does, and if two scenes have the same name.
    """
    names: dict[str, Path] = {}
    for path in paths:
        other = names.setdefault(scene_name(path), path)
        if other is not path:
            raise InvalidInput(f"{path}: named '{scene_name(path)}', as {other} is")
    return [open_scene(path, width) for path in paths]

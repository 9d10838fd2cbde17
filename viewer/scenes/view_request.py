"""A request to the viewer: scenes, cameras, and display settings."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import gs_codec
from gs_codec.cameras.image_files import seek_images
from gs_codec.cameras.up import UNSURE, up_axis
from gs_codec.views.estimate import COUNT
from gs_codec.views.find import find_cameras
from viewer.scenes.choice import (
    CELL_COLOURINGS,
    COLOURINGS,
    DEPTHS,
    LAYERS,
    MODES,
    SCALED,
    SCALES,
    OctreeChoice,
)
from viewer.scenes.frame_scenes import at_moment, first_moment
from viewer.scenes.opened import Opened, Progress, Pruned, read_pruned
from viewer.scenes.saving import open_file
from viewer.scenes.viewpoints import Views, choose_views, given_views

if TYPE_CHECKING:
    from open3d.pybind.t.geometry import PointCloud

log = logging.getLogger(__name__)

#: Maximum side of a picture, pixels.
_MAX_SIDE = 1 << 14


@dataclass(frozen=True)
class Request:
    """Scenes and display settings.

    Attributes
    ----------
    a, b : path, cloud or None
    cameras : path, "auto", sequence of cameras, or None
    images : path or None
        Folder of the cameras' photographs.
    pruned : path or None
        Folder of a report of ``prepare``.
    layers : tuple of str
    colouring, mode : str
    view : int or None
        Index of the first camera to show.
    size : tuple of two int
        Width and height, pixels.
    max_bytes : int or None
        As in `gs_codec.read`.
    up : str or None
        Up axis of the scene, one of `gs_codec.cameras.up.UPS`.
    octree : OctreeChoice
    scale : str or None
        One of `SCALES`, for the colours of centres; None is the quantity's default.
    watch : bool
        Whether to reload files that change.
    frame : int or None
        Number, from 0, of the first frame of a sequence to show; of A, if both are sequences.
    """

    a: PointCloud | str | Path | None = None
    b: PointCloud | str | Path | None = None
    cameras: str | Path | Sequence[gs_codec.Camera | Mapping[str, object]] | None = None
    images: Path | None = None
    pruned: Path | None = None
    layers: tuple[str, ...] = ("splats",)
    colouring: str = "colour"
    mode: str = "side"
    view: int | None = None
    size: tuple[int, int] = (1280, 800)
    max_bytes: int | None = None
    up: str | None = None
    octree: OctreeChoice = field(default_factory=OctreeChoice)
    scale: str | None = None
    watch: bool = False
    frame: int | None = None

    def check(self) -> None:
        """Run all checks that do not need a file opened.

        Raises
        ------
        gs_codec.GsCodecError
        """
        _check_among("layers", self.layers, LAYERS)
        _check_among("colour", [self.colouring], COLOURINGS)
        _check_among("colour-scale", [self.scale or SCALES[0]], SCALES)
        if self.scale is not None and self.colouring not in SCALED:
            known = ", ".join(SCALED)
            raise gs_codec.GsCodecError(f"colour-scale: expected colour {known}")
        if self.colouring == "error" and self.a is not None and self.b is None:
            raise gs_codec.GsCodecError("colour error: expected two scenes")
        _check_among("mode", [self.mode], MODES)
        if self.up is not None:
            up_axis(self.up)
        _check_among("octree-colour", [self.octree.colouring], CELL_COLOURINGS)
        if self.octree.depth not in DEPTHS:
            raise gs_codec.GsCodecError(
                f"octree-depth {self.octree.depth}: expected {DEPTHS[0]} to {DEPTHS[-1]}"
            )
        if not all(64 <= side <= _MAX_SIDE for side in self.size):
            raise gs_codec.GsCodecError(
                f"size {self.size[0]}x{self.size[1]}: expected 64 to {_MAX_SIDE} pixels each way"
            )
        if self.view is not None and self.cameras is None:
            raise gs_codec.GsCodecError("view: needs cameras")
        if self.images is not None and self.chosen:
            raise gs_codec.GsCodecError("gt-images: need cameras from a file")
        if self.images is not None and not self.images.is_dir():
            raise gs_codec.GsCodecError(f"{self.images}: no such folder, expected images")
        of_scene = self.pruned, self.cameras, self.frame
        if self.a is None and any(each is not None for each in of_scene):
            raise gs_codec.GsCodecError("no scene to show")

    def check_picture(self, name: str) -> None:
        """Also reject options that have no effect in a picture, and a missing scene.

        `name` is the name of the picture.

        Raises
        ------
        gs_codec.GsCodecError
        """
        self.check()
        if self.a is None:
            raise gs_codec.GsCodecError(f"{name}: no scene to draw")
        if self.watch:
            raise gs_codec.GsCodecError(f"watch: has no effect on a {name}")
        if self.b is None:
            if self.mode != MODES[0]:
                raise gs_codec.GsCodecError(f"mode {self.mode}: expected two scenes")
            if "error" in self.layers:
                raise gs_codec.GsCodecError("layers error: expected two scenes")
        if "pruned" in self.layers and self.pruned is None:
            raise gs_codec.GsCodecError("layers pruned: needs a report")
        if name == "page":  # its panel adds layers
            return
        if self.colouring != Request.colouring and "centres" not in self.layers:
            raise gs_codec.GsCodecError(f"colour {self.colouring}: needs the layer centres")
        if self.octree != OctreeChoice() and "octree" not in self.layers:
            raise gs_codec.GsCodecError("octree-depth and octree-colour: need the layer octree")

    @property
    def chosen(self) -> bool:
        """Whether cameras are chosen from the scene, because none were given."""
        return self.cameras is None or (isinstance(self.cameras, str) and self.cameras == "auto")

    def scenes(self, progress: Progress | None = None) -> list[Opened]:
        """Open the scenes."""
        sources = [source for source in (self.a, self.b) if source is not None]

        def part(k: int) -> Progress | None:
            if progress is None:
                return None
            return lambda stage, done, total: progress(
                stage, k * total + done, len(sources) * total
            )

        scenes = [open_file(source, part(k), self.max_bytes) for k, source in enumerate(sources)]
        scenes = self._at_moment(scenes)
        if self.watch and scenes and not any(scene.can_reload for scene in scenes):
            raise gs_codec.GsCodecError("watch: has no effect on clouds and projects")
        wanted = {"octree-colour": self.octree.colouring, "colour": self.colouring}
        for option, colouring in wanted.items():
            reasons = [scene.unknown(colouring) for scene in scenes]
            if reasons and all(reasons):
                message = f"{option} {colouring}: {scenes[-1].name} is {reasons[-1]}"
                raise gs_codec.GsCodecError(message)
        return scenes

    def _at_moment(self, scenes: list[Opened]) -> list[Opened]:
        """Go to the frame wanted; see `scenes`."""
        if first_moment(scenes) is None:
            if self.frame is not None:
                raise gs_codec.GsCodecError("frame: expected a sequence")
        elif self.watch:
            raise gs_codec.GsCodecError("watch: has no effect on a sequence")
        return scenes if self.frame is None else at_moment(scenes, self.frame)


def parse_layers(text: str | None, pruned: Path | None) -> tuple[str, ...]:
    """Layers from a comma-separated list; default: splats, and pruned with a report."""
    if text is None:
        return ("splats",) if pruned is None else ("splats", "pruned")
    return tuple(part.strip() for part in text.split(",") if part.strip())


def _check_among(name: str, wanted: Iterable[str], known: tuple[str, ...]) -> None:
    for each in wanted:
        if each not in known:
            raise gs_codec.GsCodecError(f"{name} '{each}': expected {', '.join(known)}")


def find_views(request: Request, scene: Opened, count: int = 1) -> Views:
    """The cameras to look from; `count` if they are chosen from the scene, all if `view` is set.

    Logs a warning if the up axis is uncertain.

    Raises
    ------
    gs_codec.GsCodecError
        If cameras cannot be read, two share a photograph, or the requested view does not exist.
    """
    if request.cameras is None or request.chosen:
        views = choose_views(scene, request.up, count if request.view is None else COUNT)
    else:
        views = given_views(find_cameras(request.cameras, scene.gaussians))
        if request.images is not None:
            seek_images(request.images, views.cameras)
    if not views.up_certain:
        log.warning(UNSURE)
    number = len(views.cameras)
    if request.view is not None and not 0 <= request.view < number:
        raise gs_codec.GsCodecError(f"view {request.view}: expected 0 to {number - 1}")
    return views


def first_view(request: Request, views: Views) -> int:
    """Index in `find_viewpoints` of the requested camera; otherwise of the first camera, if any."""
    return views.first + (request.view or 0) if views.cameras else 0


def find_pruned(request: Request, scene: Opened) -> Pruned | None:
    """The pruning report; None if none was given.

    Raises
    ------
    gs_codec.GsCodecError
        If the report cannot be read, or is for another scene.
    """
    return None if request.pruned is None else read_pruned(request.pruned, scene)

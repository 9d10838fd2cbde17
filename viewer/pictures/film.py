"""Films of the window's contents, without a window."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import gs_codec
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.wording import counted
from viewer.pictures.drawer import Drawer
from viewer.pictures.reels import check_reel, is_folder, open_reel
from viewer.pictures.screenshot import compose, shown_of
from viewer.scenes.flight import flythrough
from viewer.scenes.opened import Opened
from viewer.scenes.pose import Pose
from viewer.scenes.turntable import turntable
from viewer.scenes.view_request import Request, find_views, first_view
from viewer.scenes.viewpoints import COUNT, find_viewpoints

#: Default number of frames of a film.
FRAMES = 180

#: Default frames per second.
FPS = 24

#: Range of the number of frames.
_FRAMES = range(2, 100_000)

#: Range of frames per second.
_FPS = range(1, 121)


@dataclass(frozen=True)
class Film:
    """A film, and where to write it.

    Attributes
    ----------
    kind : {"turntable", "flythrough"}
        Once around the scene, or through the given cameras in order.
    path : Path
        An .mp4 file, or a folder for PNG frames.
    frames : int
        2-99,999.
    fps : int or None
        Frames per second, 1-120; 24 if None. Must be None for a folder.
    overwrite : bool
        Whether to replace an existing film.
    """

    kind: Literal["turntable", "flythrough"]
    path: Path
    frames: int = FRAMES
    fps: int | None = None
    overwrite: bool = False

    def check(self, request: Request) -> None:
        """Run all checks that do not need the scene opened.

        Raises
        ------
        gs_codec.GsCodecError
        """
        request.check_picture(self.kind)
        if request.images is not None:
            raise gs_codec.GsCodecError(f"gt-images: has no effect on a {self.kind}")
        if self.kind == "flythrough":
            if request.chosen:
                raise gs_codec.GsCodecError("flythrough: needs cameras from a file")
            for name, value in (("view", request.view), ("up", request.up)):
                if value is not None:
                    raise gs_codec.GsCodecError(f"{name}: has no effect on a flythrough")
        if self.fps is not None and is_folder(self.path):
            raise gs_codec.GsCodecError("fps: has no effect on a folder of frames")
        for name, number, known in (("frames", self.frames, _FRAMES), ("fps", self.fps, _FPS)):
            if number is not None and number not in known:
                raise gs_codec.GsCodecError(f"{name} {number}: expected {known[0]} to {known[-1]}")
        check_reel(self.path, request.size, self.overwrite)


def write_film(request: Request, film: Film, progress: Progress | None = None) -> str:
    """Draw and write a film; return a description of the camera path.

    Raises
    ------
    gs_codec.GsCodecError
    """
    film.check(request)
    scenes = request.scenes()
    poses, described = _find_path(request, film, scenes[0])
    shown = shown_of(request, scenes)
    advance = step_counter(progress, "frames", len(poses))
    views: dict[Opened, Drawer] = {}
    with open_reel(film.path, request.size, film.fps or FPS) as add:
        for pose in poses:
            add(compose(pose, shown, request.mode, 0.5, request.size, views=views))
            advance()
    return described


def _find_path(request: Request, film: Film, scene: Opened) -> tuple[list[Pose], str]:
    """Pose of each frame, and a description of the camera path."""
    views = find_views(request, scene, COUNT)
    up = request.up or views.ups[0]
    points = find_viewpoints(scene, views, up)
    if film.kind == "flythrough":
        poses = [point.pose for point in points[views.first :]]
        if len(poses) < 2:
            raise gs_codec.GsCodecError("flythrough: one camera, expected at least two")
        return flythrough(poses, film.frames), f"past {counted(len(poses), 'camera')}"
    from_camera = request.view is None and not request.chosen
    first = None if from_camera else points[first_view(request, views)].pose
    return turntable(scene, views, views.up_axis(up), first, film.frames)

"""Films of the window's contents, without a window."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from PIL import Image

import gs_codec
from gs_codec.report import Progress, step_counter
from gs_codec.runtime.wording import counted
from viewer.pictures.drawer import Drawer
from viewer.pictures.reels import check_reel, is_folder, open_reel
from viewer.pictures.screenshot import compose, shown_of
from viewer.scenes.flight import FPS, MOST, read_path
from viewer.scenes.opened import Opened
from viewer.scenes.pose import Pose
from viewer.scenes.turntable import turntable
from viewer.scenes.view_request import Request, find_views, first_view
from viewer.scenes.viewpoints import COUNT, find_viewpoints

#: Default number of frames of a film whose camera path has no times.
FRAMES = 180

#: Range of the number of frames.
_FRAMES = range(2, MOST + 1)

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
    frames : int or None
        2-99,999; by default 180, or those of the camera path in its time.
    fps : int or None
        Frames per second, 1-120; by default those of the camera path, or 24. Must be None for a
        folder.
    overwrite : bool
        Whether to replace an existing film.
    """

    kind: Literal["turntable", "flythrough"]
    path: Path
    frames: int | None = None
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


def write_film(request: Request, film: Film, progress: Progress | None = None) -> tuple[int, str]:
    """Draw and write a film; return the number of frames and a description of the camera path.

    Raises
    ------
    gs_codec.GsCodecError
    """
    film.check(request)
    scenes = request.scenes()
    poses, fps, described = _find_path(request, film, scenes[0])
    shown = shown_of(request, scenes)
    draw = partial(compose, shown=shown, mode=request.mode, wipe=0.5, size=request.size)
    write_frames(film.path, poses, fps, request.size, draw, progress)
    return len(poses), described


def write_frames(
    path: Path,
    poses: Sequence[Pose],
    fps: int,
    size: tuple[int, int],
    draw: Callable[..., Image.Image],
    progress: Progress | None,
) -> None:
    """Write the pictures that `draw` makes of poses as a film; raises like `open_reel`."""
    advance = step_counter(progress, "frames", len(poses))
    views: dict[Opened, Drawer] = {}
    with open_reel(path, size, fps) as add:
        for pose in poses:
            add(draw(pose, views=views))
            advance()


def _find_path(request: Request, film: Film, scene: Opened) -> tuple[list[Pose], int, str]:
    """Pose of each frame, frames per second, and a description of the camera path."""
    if film.kind == "flythrough":
        path = read_path(Path(str(request.cameras)), (FRAMES - 1) / FPS)
        count = len(path.poses)
        if count < 2:
            raise gs_codec.GsCodecError("flythrough: one camera, expected at least two")
        return path.frames(film.frames), film.fps or path.fps, f"past {counted(count, 'camera')}"
    views = find_views(request, scene, COUNT)
    up = request.up or views.ups[0]
    points = find_viewpoints(scene, views, up)
    from_camera = request.view is None and not request.chosen
    first = None if from_camera else points[first_view(request, views)].pose
    poses, told = turntable(scene, views, views.up_axis(up), first, film.frames or FRAMES)
    return poses, film.fps or FPS, told

"""Save an edited scene in any writable format, or all scenes and edits as a project."""

from __future__ import annotations

import os
import shlex
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import gs_codec
from gs_codec.edit.actions import Action
from gs_codec.edit.project_file import SUFFIX, Project, project_text, read_project
from gs_codec.errors import printable
from gs_codec.files.conversion import convert_file
from gs_codec.files.suffixes import WRITTEN, check_target
from gs_codec.files.writing import write_scene
from gs_codec.formats.coordinates import CONVENTION
from gs_codec.runtime.atomic import atomic_writer
from gs_codec.runtime.mapped import located
from gs_codec.runtime.wording import counted, size_text
from viewer.scenes.edits import Edits
from viewer.scenes.frame_scenes import open_clip, open_frame
from viewer.scenes.opened import Opened, Progress, joined, keep, open_scene

if TYPE_CHECKING:
    from open3d.pybind.t.geometry import PointCloud

#: Default encoding of ``gs-codec convert``.
_CONFIG = gs_codec.Config(extra="keep")


def save_scene(
    scene: Opened, path: Path, progress: Progress | None = None, project: Project | None = None
) -> list[str]:
    """Write an edited scene like ``gs-codec convert``, atomically.

    The Gaussians of a file are read again, to include comments and properties that the viewer does
    not keep. Those of a cloud are written by `gs_codec.write`.

    Parameters
    ----------
    scene : Opened
    path : Path
        Its suffix selects the format, as in `gs_codec.convert_file`.
    progress : callable, optional
    project : Project, optional
        Its files and edits, if the files are in another order.

    Returns
    -------
    list of str
        A line on what was written, and one for each loss.

    Raises
    ------
    gs_codec.GsCodecError
        If it cannot be written, or the file of the scene has changed since it was opened.
    """
    if not scene.is_file:
        check_target(scene.paths, path)
        lost, _ = write_scene(path, scene.gaussians_with_extra, _CONFIG)
        return [_written(path, scene.count, os.path.getsize(path)), *lost]
    scene.check_unchanged()
    system = f"{scene.system}:{CONVENTION}" if scene.system_given else CONVENTION
    nothing = np.zeros(scene.file_count, bool)
    removed = nothing if scene.left is None else ~scene.left
    project = project or Project(scene.parts, scene.moves, removed, nothing)
    sources = [part.path for part in project.sources]
    with tempfile.TemporaryDirectory() as folder:
        actions = []
        if project.moves or project.removed.any():
            edits = Path(folder) / f"edits{SUFFIX}"
            edits.write_text(project_text(project, Path(folder)))
            actions = [Action("edits", str(edits))]
        done = convert_file(
            sources, path, _CONFIG, system, actions=actions, progress=progress, overwrite=True
        )
    return [_written(path, done.count, done.file_bytes), *done.lost]


def _written(path: Path, count: int, size: int) -> str:
    return f"{path.name} saved: {counted(count, 'Gaussian')}, {size_text(size)}"


def save_project(edits: Edits, path: Path) -> None:
    """Write the scenes and edits as a project.

    Raises
    ------
    OSError
        If it cannot be written.
    gs_codec.GsCodecError
        If a scene is not a file, was turned, or has changed since it was opened.
    """
    _check_files(edits)
    edits.whole.check_unchanged()
    if edits.whole.system_given:
        raise gs_codec.GsCodecError(
            "a project does not keep that axes were reversed; save the scene instead"
        )
    with atomic_writer(path) as file:
        file.write(project_text(edits.project, path.absolute().parent).encode())


def command_of(edits: Edits, project: Path) -> str:
    """The command ``gs-codec convert`` with the same result; `project` is needed for some edits.

    Raises
    ------
    gs_codec.GsCodecError
        If a scene is not a file.
    """
    whole = edits.whole
    _check_files(edits)
    paths = [_short(part.path) for part in edits.project.sources]
    first = Path(paths[0])
    suffix = first.suffix if first.suffix in WRITTEN else ".ply"
    options = (f"--edits={_short(project)}",) if edits.options is None else edits.options
    if whole.system_given:
        options = (f"--coordinates={whole.system}:{CONVENTION}", *options)
    target = first.with_name(f"{first.stem}-edited{suffix}")
    return shlex.join(["gs-codec", "convert", *paths, str(target), *options])


def _check_files(edits: Edits) -> None:
    if not edits.whole.is_file:
        raise gs_codec.GsCodecError(
            "a cloud or a frame of a sequence, expected files; save the scene instead"
        )


def _short(path: Path) -> str:
    """A path as text, relative to the working directory if it is inside."""
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)


def open_file(
    source: Path | str | PointCloud,
    progress: Progress | None = None,
    max_bytes: int | None = None,
) -> Opened:
    """Open a scene, the first frame of a sequence, or a project as one edited scene.

    Raises
    ------
    gs_codec.GsCodecError
        Also if a scene of a project has changed.
    """
    if not isinstance(source, str | Path) or Path(source).suffix != SUFFIX:
        clip = open_clip(source, max_bytes)
        if clip is not None:
            return open_frame(clip, 0, progress)
        return open_scene(source, progress=progress, max_bytes=max_bytes)
    with located(source):
        project = read_project(source)
    scenes = []
    for part in project.sources:
        scene = open_scene(part.path, progress=progress, max_bytes=max_bytes)
        part.check(scene.positions.T)
        scenes.append(scene)
    whole = joined(scenes) if len(scenes) > 1 else scenes[0]
    name = printable(Path(source).name)
    whole = replace(whole, name=name, sources=project.sources, hidden=project.hidden)
    return keep(whole, ~project.removed, project.moves)

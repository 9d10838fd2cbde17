"""Save an edited scene in any format that is written."""

from __future__ import annotations

import os
from pathlib import Path

import gs_codec
from gs_codec.files.conversion import convert_file
from gs_codec.files.scenes import write_scene
from gs_codec.files.suffixes import check_target
from gs_codec.formats.cloud import from_cloud
from gs_codec.formats.coordinates import CONVENTION
from gs_codec.runtime.wording import counted, size_text
from viewer.scenes.opened import Opened, Progress

#: How ``gs-codec convert`` encodes by default.
_CONFIG = gs_codec.Config(extra="keep")


def save_scene(scene: Opened, path: Path, progress: Progress | None = None) -> list[str]:
    """Write what is left of a scene, as ``gs-codec convert`` writes it; whole or not at all.

    The Gaussians of a file are read from it again, so that what the viewer leaves out (comments,
    further properties) is written too. Those of a cloud are written as `gs_codec.write` does.

    Parameters
    ----------
    scene : Opened
    path : Path
        Its suffix selects the format, as for `gs_codec.convert_file`.
    progress : callable, optional

    Returns
    -------
    list of str
        What was written, and a line for each thing that the format cannot hold.

    Raises
    ------
    gs_codec.GsCodecError
        If it cannot be written, or the file of the scene has changed since it was opened.
    """
    if scene.path == Path():
        check_target([], path)
        lost, _ = write_scene(path, from_cloud(scene.cloud, "keep"), _CONFIG)
        return [_written(path, scene.count, os.path.getsize(path)), *lost]
    scene.check_unchanged()
    system = f"{scene.system}:{CONVENTION}" if scene.system_given else CONVENTION
    done = convert_file(
        scene.path, path, _CONFIG, system, chosen=scene.left, progress=progress, overwrite=True
    )
    return [_written(path, done.count, done.file_bytes), *done.lost]


def _written(path: Path, count: int, size: int) -> str:
    return f"{path.name} saved: {counted(count, 'Gaussian')}, {size_text(size)}"

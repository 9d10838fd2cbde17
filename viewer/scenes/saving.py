"""Save an edited scene in any writable format."""

from __future__ import annotations

import os
from pathlib import Path

import gs_codec
from gs_codec.files.conversion import convert_file
from gs_codec.files.suffixes import check_target
from gs_codec.files.writing import write_scene
from gs_codec.formats.cloud import from_cloud
from gs_codec.formats.coordinates import CONVENTION
from gs_codec.runtime.wording import counted, size_text
from viewer.scenes.opened import Opened, Progress

#: Default encoding of ``gs-codec convert``.
_CONFIG = gs_codec.Config(extra="keep")


def save_scene(scene: Opened, path: Path, progress: Progress | None = None) -> list[str]:
    """Write an edited scene like ``gs-codec convert``, atomically.

    The Gaussians of a file are read again, to include comments and properties that the viewer does
    not keep. Those of a cloud are written by `gs_codec.write`.

    Parameters
    ----------
    scene : Opened
    path : Path
        Its suffix selects the format, as in `gs_codec.convert_file`.
    progress : callable, optional

    Returns
    -------
    list of str
        A line on what was written, and one for each loss.

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

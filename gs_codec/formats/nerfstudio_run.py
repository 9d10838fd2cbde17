"""The ``config.yml`` of a run of nerfstudio, which stands for the run's newest checkpoint."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sized
from contextlib import contextmanager
from pathlib import Path

from gs_codec.errors import InvalidInput
from gs_codec.formats.checkpoint import read_checkpoint
from gs_codec.formats.checkpoint import stated_size as size_of_checkpoint
from gs_codec.runtime.mapped import FileBytes, opened, other_files
from gs_codec.scene import Scene

#: Folder of checkpoints beside the file, nerfstudio's ``relative_model_dir``.
_FOLDER = "nerfstudio_models"


@contextmanager
def _newest(path: Path) -> Iterator[tuple[Path, FileBytes]]:
    """Open the run's last checkpoint; its errors name it instead of the configuration."""
    steps = {
        int(found[1]): each
        for each in path.parent.glob(f"{_FOLDER}/step-*.ckpt")
        if (found := re.fullmatch(r"step-(\d+)", each.stem))
    }
    if not steps:
        expected = f"expected {_FOLDER}/step-000029999.ckpt beside it"
        raise InvalidInput(f"{path}: a run of nerfstudio without checkpoint, {expected}")
    checkpoint = steps[max(steps)]
    with other_files(), opened(checkpoint) as data:
        yield checkpoint, data


def stated_size(path: Path, data: Sized) -> tuple[int, int]:
    """Number of Gaussians and SH degree, from the header of the checkpoint."""
    with _newest(path) as (checkpoint, found):
        return size_of_checkpoint(checkpoint, found)


def files_beside(path: Path, data: Sized) -> list[Path]:
    """The checkpoint."""
    with _newest(path) as (checkpoint, _):
        return [checkpoint]


def read_run(path: Path, data: Sized, max_bytes: int | None) -> Scene:
    """Read the newest checkpoint; see `SceneFile.scene`."""
    with _newest(path) as (checkpoint, found):
        scene = read_checkpoint(checkpoint, found, max_bytes)
        found.check_unchanged()
        return scene
